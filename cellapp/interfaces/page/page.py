"""One self-contained HTML page of a run."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.headlines import out_of_date_lines, unusable_arms
from cellapp.commands.report.sections import report_sections
from cellapp.commands.report.summary import header_facts, nothing_found, summary
from cellapp.commands.stages import data_mark
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.page.certificate_page import certificate_of_run
from cellapp.interfaces.page.drawn import drawn_sections
from cellapp.interfaces.page.templates import plotly_base64, plotly_notice, template


def write_page(run: RunFile) -> Path:
    """Write ``report.html`` into the run's folder and return its path; if that fails, an earlier page stays intact.

    The page needs no other file and no network. The same run gives the same bytes except for the time of writing.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or the page cannot be written.
    """
    path = run.folder / REPORT_FILE
    RENEWED.write_text(path, page_text(run, datetime.now(UTC)))
    return path


def page_text(run: RunFile, written: datetime) -> str:
    """Return the page as text. Raises ``InputError`` if the run is not calibrated yet."""
    data = read_report_data(run)
    outdated = out_of_date_lines(data)
    return template("page.html").render(
        profile=data.profile,
        written=written.isoformat(timespec="seconds"),
        data_mark=data_mark(run),
        simulated=" (simulated cell)" if data.profile.is_simulated else "",
        header_facts=header_facts(data),
        alarm_title="Out of date" if outdated else "Do not use",
        outdated=bool(outdated),
        alarms=[*unusable_arms(data), *outdated],
        next_step=data.next_step,
        summary=summary(data, data.judgements, written.date()),
        nothing_found=nothing_found(data),
        certificate=certificate_of_run(data),
        sections=drawn_sections(report_sections(run, data)),
        plotly=plotly_base64(),
        plotly_notice=plotly_notice(),
    )
