"""Request of the verb ``certificate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb
from cellapp.ground.outputs import Writes


class CertificateRequest(Request):
    """Write certificate.json, .html, SHA256SUMS: errors as found and left, budget, tolerances, what is missing."""

    folder: RunFolder
    out: Annotated[
        Path | None,
        Asked(
            "Folder of the files; DIR if not given.",
            "FOLDER",
            label="into folder",
            hint="empty: that of the run",
            writes=Writes.FOLDER,
        ),
    ] = None
    number: Annotated[
        str | None,
        Asked(
            "Number of the certificate; else a new one.", "N", label="number", hint="empty: of profile, day and data"
        ),
    ] = None
    data: Annotated[
        Path | None,
        Asked(
            "YAML with sections tolerances, traceability; before the profile.",
            "FILE",
            label="data file",
            hint="YAML, tolerances and traceability; may be empty",
            suffixes=(".yaml", ".yml"),
        ),
    ] = None
    strict: Annotated[bool, Asked("Exit code 1 unless all is verified, holds and conforms.")] = False


VERB = Verb(
    "certificate",
    CertificateRequest,
    chapter="report",
    question="Write the certificate",
    stored=(Stored("certificate", "no certificate is", ("certificate",)),),
)
