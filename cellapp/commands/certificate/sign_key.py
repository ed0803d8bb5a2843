"""The verb ``sign-key``, and reading its keys: Ed25519 in a PEM file that only its owner can read."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.commands.certificate.minisign import FormatError, PublicKey
from cellapp.commands.certificate.result import SignKeyResult
from cellapp.ground.errors import InputError

_OWNER_ONLY = 0o600
_PUBLIC = 0o644
_ENCRYPTED = b"ENCRYPTED PRIVATE KEY"
_MOST_BYTES = 100_000
"""Key files have some hundred bytes."""


def new_sign_key(path: Path, passphrase: str = "") -> SignKeyResult:
    """Make a key pair: the private key (PKCS8 PEM, encrypted with a passphrase if one is given) and ``path`` .pub.

    Raises
    ------
    InputError
        If one of the files exists already, or cannot be written; then neither is left behind.
    """
    public_path = path.with_suffix(".pub")
    if public_path == path:
        raise InputError(f"sign-key: {path}: a private key must not end in .pub; give another name")
    for one in (path, public_path):
        if os.path.lexists(one):
            raise InputError(f"sign-key: {one} exists already; keys are never overwritten, give another name")
    private = Ed25519PrivateKey.generate()
    secret = passphrase.encode()
    encryption = serialization.BestAvailableEncryption(secret) if secret else serialization.NoEncryption()
    pem = private.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)
    public = PublicKey.of(private)
    _write_new(path, pem, _OWNER_ONLY)
    try:
        _write_new(public_path, public.text().encode(), _PUBLIC)
    except InputError:
        path.unlink()
        raise
    return SignKeyResult(
        private_file=str(path),
        public_file=str(public_path),
        key_id=public.id_text,
        public_key=public.line,
        encrypted=bool(secret),
    )


def is_encrypted(path: Path) -> bool:
    """Whether a private key needs a passphrase. Raises ``InputError`` if the file cannot be read."""
    return _ENCRYPTED in _content(path)


def load_sign_key(path: Path, passphrase: str = "") -> Ed25519PrivateKey:
    """Read a private key.

    Raises
    ------
    InputError
        If the file cannot be read, others may read it, it is no Ed25519 key in PEM, or the passphrase is wrong.
    """
    content = _content(path)
    if os.name == "posix" and path.stat().st_mode & 0o077:
        raise InputError(f"{path}: others can read this private key; run 'chmod 600 {path}'")
    encrypted = _ENCRYPTED in content
    if encrypted and not passphrase:
        raise InputError(f"{path}: the key is encrypted; its passphrase is needed")
    try:
        key = serialization.load_pem_private_key(content, passphrase.encode() if encrypted else None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        why = "wrong passphrase, or a damaged file" if encrypted else "not a private key in PEM"
        raise InputError(f"{path}: {why}; 'cellapp sign-key' makes keys") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{path}: not an Ed25519 key; 'cellapp sign-key' makes one")
    return key


def load_public_key(given: str) -> PublicKey:
    """A public key from its file, or from its line in base64 itself. Raises ``InputError`` if it is none."""
    try:
        return PublicKey.parse(given)
    except FormatError:
        path = Path(given)
    try:
        return PublicKey.parse(_content(path).decode("utf-8"))
    except (FormatError, UnicodeDecodeError) as error:
        why = str(error) if isinstance(error, FormatError) else "not a text"
        raise InputError(f"{path}: not a public key of minisign: {why}") from None


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_MOST_BYTES)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not a path"
        raise InputError(f"{path}: the key cannot be read ({why})") from None


def _write_new(path: Path, content: bytes, mode: int) -> None:
    """Write a file that does not exist yet, with its mode from the first moment on."""
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
    except OSError as error:
        raise InputError(f"sign-key: {path}: cannot be made ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink()
        raise InputError(f"sign-key: {path}: cannot be written ({error.strerror})") from None
