"""``report``: write the page of a run, print it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.cli.job import Job, open_run
from cellapp.interfaces.cli.options import JsonOption, RunFolder, Strict


def report(
    folder: RunFolder,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print the page to report.pdf, too, through an installed Chromium.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="With --pdf: the PDF, instead of report.pdf in DIR."),
        Writes.FILE,
    ] = None,
    strict: Strict = False,
    json_file: JsonOption = None,
) -> None:
    """Write report.html, one self-contained page, into the run's folder."""
    from cellapp.commands.out_of_date import check_nothing_out_of_date
    from cellapp.commands.report.run import report_run
    from cellapp.commands.report.tables import all_tables, out_of_date_sentences
    from cellapp.interfaces.page.page import write_page

    if out is not None and not pdf:
        raise InputError("report: --out is the file of --pdf; add --pdf")
    with Job(json_file) as job, open_run(folder) as opened:
        own = out is None
        printed_to = (out or folder / "report.pdf") if pdf else None
        result = report_run(opened, write_page, printed_to, RENEWED if own else job.outputs)
        job.show(all_tables(result))
        printed = [] if result.pdf is None else [f"printed: {result.pdf}"]
        job.say(*out_of_date_sentences(result), f"written: {result.page}", *printed)
        job.result(result)
        if strict:
            check_nothing_out_of_date(opened, "report")
