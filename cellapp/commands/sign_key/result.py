"""Result of ``sign-key``."""

from __future__ import annotations

from cellapp.ground.results import Result


class SignKeyResult(Result, schema="cellapp-sign-key"):
    """``sign-key``: the files of a new key pair. The private key is in no result."""

    private_file: str
    public_file: str
    key_id: str
    public_key: str
    encrypted: bool
