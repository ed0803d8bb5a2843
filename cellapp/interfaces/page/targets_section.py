"""The page's section on targets: what was measured there, what is predicted, what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cellapp.cell.targets.records import CompensateResult
from cellapp.commands.compensate.charts import parts_charts, target_charts
from cellapp.commands.compensate.tables import (
    measured_tables,
    predicted_tables,
    refusal_tables,
    uncertainty_tables,
    unknown_tables,
    verification_tables,
)
from cellapp.commands.compensate.words import compensate_summary, verify_message, verify_summary
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.table import Table
from cellapp.ground.results import COMPENSATE
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_figure import chart_figure

if TYPE_CHECKING:
    from cellapp.commands.view.charts import Chart


@dataclass(frozen=True)
class TargetsSection:
    """What the page shows of targets: a message of one sentence, further sentences, figures, tables."""

    message: str
    sentences: tuple[str, ...]
    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...]


def targets_section(data: ReportData) -> TargetsSection | None:
    """The section of a run with compensated or measured targets that hold; None without them."""
    compensate = None if COMPENSATE in data.out_of_date else data.results.compensate
    if compensate is None and data.verify is None:
        return None
    charts = [chart for chart in _charts(data, compensate) if not chart.is_empty]
    predicted = [] if compensate is None else compensate_summary(compensate)
    measured = [] if data.verify is None else verify_summary(data.verify)
    message = predicted[0] if data.verify is None else verify_message(data.verify)
    return TargetsSection(
        message=message[:1].upper() + message[1:],
        sentences=tuple(line for line in (*measured, *predicted) if line != message),
        figures=tuple(chart_figure(f"targets{number}", chart) for number, chart in enumerate(charts, start=1)),
        tables=tuple(_tables(data, compensate)),
    )


def _charts(data: ReportData, compensate: CompensateResult | None) -> Iterator[Chart]:
    floors = {name: arm.tracker_mm for name, arm in data.calibrate.arms.items()}
    yield from target_charts(data.verify, floors)
    yield from () if compensate is None else parts_charts(compensate)


def _tables(data: ReportData, compensate: CompensateResult | None) -> Iterator[Table]:
    if data.verify is not None:
        yield from verification_tables(data.verify)[:1]  # the tables of each target have the tolerances, too
        yield from measured_tables(data.verify)
    if compensate is not None:
        if data.verify is None:
            yield from predicted_tables(compensate)
        yield from uncertainty_tables(compensate)
        yield from unknown_tables(compensate)
        yield from refusal_tables(compensate)
