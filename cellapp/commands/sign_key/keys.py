"""Keys of certificates: Ed25519 in a PEM file that only its owner can read."""

from __future__ import annotations

import os
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.commands.sign_key.minisign import FormatError, PublicKey
from cellapp.ground.errors import InputError

_ENCRYPTED = b"ENCRYPTED PRIVATE KEY"
_MOST_BYTES = 100_000
"""Most bytes of a key file; real ones have some hundred bytes."""


def is_encrypted(path: Path) -> bool:
    """Return whether a private key needs a passphrase. Raises ``InputError`` if the file cannot be read."""
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
    """Read a public key from its file, or parse its line in base64. Raises ``InputError`` if it is none."""
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
