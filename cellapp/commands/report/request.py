"""Request of the verb ``report``."""

from __future__ import annotations

from cellapp.commands.record import Request, RunFolder, Strict, Verb


class ReportRequest(Request):
    """Write report.html, one self-contained page, into the run's folder."""

    folder: RunFolder
    strict: Strict = False


VERB = Verb("report", ReportRequest, chapter="report")
