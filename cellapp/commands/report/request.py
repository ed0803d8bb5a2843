"""Request of the verb ``report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Strict, Verb
from cellapp.ground.outputs import Writes

PDF_FILE = "report.pdf"


class ReportRequest(Request):
    """Write report.html, one self-contained page, into the run's folder."""

    folder: RunFolder
    pdf: Annotated[bool, Asked(f"Print the page to {PDF_FILE}, too, through an installed Chromium.")] = False
    out: Annotated[
        Path | None, Asked(f"With --pdf: the PDF, instead of {PDF_FILE} in DIR.", "FILE", writes=Writes.FILE)
    ] = None
    strict: Strict = False

    @model_validator(mode="after")
    def _printed(self) -> Self:
        if self.out is not None and not self.pdf:
            raise ValueError("--out is the file of --pdf; add --pdf")
        return self


VERB = Verb("report", ReportRequest, chapter="report")
