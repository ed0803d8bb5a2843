"""The verb ``sign-key``: make a key pair whose private key only its owner can read."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.commands.record import Work
from cellapp.commands.sign_key.minisign import PublicKey
from cellapp.commands.sign_key.request import SignKeyRequest
from cellapp.commands.sign_key.result import SignKeyResult
from cellapp.ground.errors import InputError

_OWNER_ONLY = 0o600
_PUBLIC = 0o644


def run(request: SignKeyRequest, work: Work) -> SignKeyResult:
    """Make a key pair."""
    given = request.passphrase
    secret = work.secret("Passphrase (empty for none)", True) if given is None else given.get_secret_value()
    return new_sign_key(request.path, secret or "")


def new_sign_key(path: Path, passphrase: str = "") -> SignKeyResult:
    """Make a key pair: the private key (PKCS8 PEM, encrypted with a passphrase if one is given) and ``path`` .pub.

    Raises
    ------
    InputError
        If one of the files exists already, or cannot be written; no file is left behind then.
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


def _write_new(path: Path, content: bytes, mode: int) -> None:
    """Write a new file, with its mode set from the beginning."""
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
    except OSError as error:
        missing = "" if path.parent.is_dir() else f": there is no folder {path.parent}; make it first"
        raise InputError(f"sign-key: {path}: cannot be made ({error.strerror}){missing}") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink()
        raise InputError(f"sign-key: {path}: cannot be written ({error.strerror})") from None
