"""Request of the verb ``check-certificate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class CheckCertificateRequest(Request):
    """Verify signature and page of a certificate, with --run its data; exit code 1 if anything does not hold."""

    file: Annotated[
        Path,
        Asked(
            "A certificate.json, or its page or PDF beside it.",
            "FILE",
            argument=True,
            label="certificate",
            hint="JSON, or its page or PDF",
            suffixes=(".json", ".html", ".pdf"),
        ),
    ]
    public_key: Annotated[
        str | None,
        Asked(
            "The signer's public key: its file or its line.",
            "PUB",
            label="public key",
            hint="its file or its line; empty: not checked",
            suffixes=(".pub",),
        ),
    ] = None
    run: Annotated[
        Path | None,
        Asked(
            "Compare with the data of this run as they are now.",
            "DIR",
            label="compare with run",
            hint="its folder; empty: not compared",
        ),
    ] = None


VERB = Verb("check-certificate", CheckCertificateRequest, chapter="certificate", question="Check a certificate")
