"""Result of ``sign-key``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class SignKeyResult(Result):
    """``sign-key``: the files of a new key pair. The private key is in no result."""

    schema_: Literal["cellapp-sign-key"] = "cellapp-sign-key"
    version: Literal[1] = 1
    private_file: str
    public_file: str
    key_id: str
    public_key: str
    encrypted: bool
