"""Result of ``check-certificate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.ground.results import Result

DocumentState = Literal["as certified", "changed", "not here"]


SignatureState = Literal["valid", "wrong", "missing", "other key", "not checked"]


class CertificateCheckResult(Result, schema="cellapp-certificate-check"):
    """``check-certificate``: whether signature and data are those that were signed; ``problems`` is empty if so.

    ``signature`` is "not checked" where no public key was given. ``comment`` is the signed comment of a valid
    signature: time, file and number. ``documents`` are the files that show the certificate to people, and whether each
    is the one whose hash the certificate states. ``run`` is the run whose data were compared; empty if none was.
    """

    certificate: str
    number: str = ""
    signature: SignatureState
    key_id: str = ""
    comment: str = ""
    documents: Mapping[str, DocumentState] = {}
    run: str = ""
    problems: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Say why the certificate cannot be relied on; empty if it can."""
        return list(self.problems)
