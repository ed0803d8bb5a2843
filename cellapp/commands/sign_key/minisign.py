"""Detached signatures in the format of minisign: Ed25519 over the BLAKE2b-512 hash of a file ("ED").

Format: https://jedisct1.github.io/minisign/, sections "Signature format" and "Public key format".

    untrusted comment: <text>
    base64("ED" || key id (8) || Ed25519 of BLAKE2b-512 of the file (64))
    trusted comment: <text>
    base64(Ed25519 of signature || trusted comment (64))

and a public key is ``base64("Ed" || key id (8) || key (32))`` below an untrusted comment. minisign draws a key's id at
random; here it is derived from the public key, so that the private key (PEM) is enough. No I/O here.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
from dataclasses import dataclass

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

_KEY_ALGORITHM = b"Ed"
_HASHED = b"ED"
_ID_BYTES, _KEY_BYTES, _SIGNATURE_BYTES = 8, 32, 64
_UNTRUSTED, _TRUSTED = "untrusted comment: ", "trusted comment: "


class FormatError(ValueError):
    """Error: a text is no key or signature of this format; the message says why."""


@dataclass(frozen=True)
class PublicKey:
    """A public key and its id."""

    key_id: bytes
    key: bytes

    @classmethod
    def of(cls, private: Ed25519PrivateKey) -> PublicKey:
        """Derive the public key of a private one; its id is a hash of the public key."""
        key = private.public_key().public_bytes_raw()
        return cls(hashlib.blake2b(key, digest_size=_ID_BYTES).digest(), key)

    @classmethod
    def parse(cls, text: str) -> PublicKey:
        """Parse a public key file, or its second line. Raises ``FormatError``."""
        lines = [line for line in text.strip().splitlines() if not line.startswith(_UNTRUSTED)]
        if len(lines) != 1:
            raise FormatError("expected a comment and one line with the key")
        algorithm, key_id, key = _split(lines[0], _KEY_BYTES)
        if algorithm != _KEY_ALGORITHM:
            raise FormatError("it is no Ed25519 key of minisign")
        return cls(key_id, key)

    @property
    def id_text(self) -> str:
        """The id as minisign prints it: hexadecimal, last byte first."""
        return id_text(self.key_id)

    @property
    def line(self) -> str:
        """The key in base64."""
        return base64.b64encode(_KEY_ALGORITHM + self.key_id + self.key).decode()

    def text(self) -> str:
        """Return the content of a public key file."""
        return f"{_UNTRUSTED}minisign public key {self.id_text}\n{self.line}\n"


@dataclass(frozen=True)
class Signature:
    """A detached signature."""

    key_id: bytes
    signature: bytes
    trusted_comment: str
    global_signature: bytes

    @classmethod
    def parse(cls, text: str) -> Signature:
        """Parse a signature file. Raises ``FormatError``."""
        lines = text.rstrip("\r\n").splitlines()
        if len(lines) != 4 or not lines[0].startswith(_UNTRUSTED) or not lines[2].startswith(_TRUSTED):
            raise FormatError("expected four lines: untrusted comment, signature, trusted comment, global signature")
        algorithm, key_id, signature = _split(lines[1], _SIGNATURE_BYTES)
        if algorithm != _HASHED:
            raise FormatError("expected a signature of the hashed file ('ED')")
        return cls(key_id, signature, lines[2].removeprefix(_TRUSTED), _decoded(lines[3], _SIGNATURE_BYTES))

    @property
    def id_text(self) -> str:
        """Id of the signing key, as minisign prints it."""
        return id_text(self.key_id)

    def text(self) -> str:
        """Return the content of a signature file."""
        signed = base64.b64encode(_HASHED + self.key_id + self.signature).decode()
        whole = base64.b64encode(self.global_signature).decode()
        return (
            f"{_UNTRUSTED}signature by key {self.id_text}, Ed25519 (minisign)\n{signed}\n"
            f"{_TRUSTED}{self.trusted_comment}\n{whole}\n"
        )

    def is_by(self, key: PublicKey) -> bool:
        """Return whether the signature states the id of ``key``."""
        return hmac.compare_digest(self.key_id, key.key_id)

    def holds(self, content: bytes, key: PublicKey) -> bool:
        """Return whether ``key`` signed both the file's content and the trusted comment."""
        public = Ed25519PublicKey.from_public_bytes(key.key)
        try:
            public.verify(self.signature, _hash(content))
            public.verify(self.global_signature, self.signature + self.trusted_comment.encode())
        except InvalidSignature:
            return False
        return True


def sign(content: bytes, private: Ed25519PrivateKey, trusted_comment: str) -> Signature:
    """Sign a file's content and a one-line comment. Raises ``FormatError`` if the comment has more lines."""
    if len(trusted_comment.splitlines()) > 1:
        raise FormatError("a trusted comment has one line")
    signature = private.sign(_hash(content))
    whole = private.sign(signature + trusted_comment.encode())
    return Signature(PublicKey.of(private).key_id, signature, trusted_comment, whole)


def id_text(key_id: bytes) -> str:
    """Return a key id as minisign prints it: hexadecimal, last byte first."""
    return key_id[::-1].hex().upper()


def _hash(content: bytes) -> bytes:
    return hashlib.blake2b(content).digest()


def _split(line: str, size: int) -> tuple[bytes, bytes, bytes]:
    """Decode a line into algorithm, key id and the following ``size`` bytes."""
    raw = _decoded(line, len(_HASHED) + _ID_BYTES + size)
    return raw[:2], raw[2 : 2 + _ID_BYTES], raw[2 + _ID_BYTES :]


def _decoded(line: str, size: int) -> bytes:
    try:
        raw = base64.b64decode(line.strip(), validate=True)
    except (binascii.Error, ValueError):
        raise FormatError("a line is no base64") from None
    if len(raw) != size:
        raise FormatError(f"a line has {len(raw)} bytes instead of {size}")
    return raw
