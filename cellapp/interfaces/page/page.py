"""One self-contained HTML page of a run.

The certificate as HTML: as a part of the page, and as a separate file that prints on A4.

Templates of the HTML pages.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.certificate.view import certificate_marks, certificate_sections, certificate_verdict
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.report.data import out_of_date_lines, read_report_data
from cellapp.commands.report.sections import report_sections
from cellapp.commands.report.summary import (
    before_after_figure,
    findings,
    header_facts,
    judged_matrix,
    nothing_found,
    steps,
    verdict,
)
from cellapp.commands.run_state import RunState
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Section
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import VERDICT_TITLES
from cellapp.ground.outputs import RENEWED
from cellapp.ground.results import CERTIFICATE
from cellapp.interfaces.page.figures import chart_svg, is_wide
from cellapp.interfaces.render.chart import legend_of

if TYPE_CHECKING:
    from jinja2 import Template


_COMMAND = re.compile(r"&#39;(cellapp [^&]+)&#39;")
"""A command in an escaped sentence."""
_KINDS = {"sentence": str, "facts": Facts, "chart": Chart, "table": Table, "section": Section}
"""Kinds of parts that a template draws."""
_SHA_256 = re.compile(r"[0-9a-f]{64}")


def template(name: str) -> Template:
    """Return a template of this package; texts are escaped, and a name without a value is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    environment = Environment(
        loader=PackageLoader("cellapp.interfaces", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = lambda chart: Markup(chart_svg(chart))  # it escapes what a user wrote
    environment.filters["legend"] = legend_of
    environment.filters["prose"] = lambda text: Markup(_COMMAND.sub(r"<code>\1</code>", str(escape(text))))
    environment.filters["is_hash"] = lambda text: bool(_SHA_256.fullmatch(text))
    environment.filters["of_kind"] = lambda parts, kind: [one for one in parts if one and isinstance(one, _KINDS[kind])]
    environment.filters["is_wide"] = is_wide
    environment.globals["marks_of"] = certificate_marks
    environment.globals["verdict_of"] = certificate_verdict
    environment.globals["sections_of"] = certificate_sections
    environment.tests["verdict"] = VERDICT_TITLES.__contains__
    return environment.get_template(name)


def certificate_page(result: CertificateResult) -> str:
    """Return the certificate as a self-contained HTML page."""
    return template("certificate.html").render(certificate=result, outdated="")


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
    state = RunState(run)
    data = read_report_data(state)
    return template("page.html").render(
        profile=data.profile,
        written=written.isoformat(timespec="seconds"),
        data_mark=state.data_mark,
        simulated=" (simulated cell)" if data.profile.is_simulated else "",
        header_facts=header_facts(data),
        alarms=out_of_date_lines(data),
        next_step=data.next_step,
        steps=list(steps(data, data.judgements, written.date())),
        verdict=verdict(data, data.judgements),
        judged=judged_matrix(data.judgements, list(data.profile.arms)),
        compared=before_after_figure(data),
        findings=list(findings(data)),
        nothing_found=nothing_found(data),
        certificate=data.results.certificate,
        outdated=data.results.out_of_date.get(CERTIFICATE, ""),
        sections=report_sections(run, data),
    )
