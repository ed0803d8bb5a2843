"""Request of the verb ``sign-key``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import SecretStr

from cellapp.commands.record import Asked, Request, Verb


class SignKeyRequest(Request):
    """Make a key pair for certificates: NEW.key for who signs, NEW.pub for who checks. Asks for a passphrase."""

    path: Annotated[
        Path,
        Asked(
            "File of the new private key; it must not exist.",
            "NEW.key",
            argument=True,
            label="private key",
            hint="a new file, as ~/cell-key.pem",
        ),
    ]
    passphrase: Annotated[
        SecretStr | None,
        Asked(
            "Passphrase of the new key; empty: the file alone signs.",
            label="passphrase",
            hint="empty: the file alone signs",
            secret="new",
        ),
    ] = None


VERB = Verb("sign-key", SignKeyRequest, chapter="certificate", question="Make a key for signing")
