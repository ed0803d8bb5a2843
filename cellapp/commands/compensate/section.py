"""Targets as a section of the report: measurements, predictions, refusals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cellapp.cell.targets.records import CompensateResult, VerifyResult
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
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Table

_SOURCES = "What the uncertainty of each target is made of"
_ABOUT = (
    "A measured target was approached twice: with the joint positions from the nominal model, and with those from the"
    " calibrated model. Bounds are those that the error keeps with 95 % probability; 'cellapp docs targets' explains"
    " them."
)


def targets_section(
    compensate: CompensateResult | None, verify: VerifyResult | None, floors_mm: Mapping[str, float | None]
) -> Section:
    """Show compensated targets, measured targets, or both; ``floors_mm`` is the noise floor of each arm."""
    predicted = [] if compensate is None else compensate_summary(compensate)
    measured = [] if verify is None else verify_summary(verify)
    message = predicted[0] if verify is None else verify_message(verify)
    charts = [*target_charts(verify, floors_mm), *([] if compensate is None else parts_charts(compensate))]
    return section_of(
        "",
        [
            *(line for line in (*measured, *predicted) if line != message),
            *(chart for chart in charts if not chart.is_empty),
            *_tables(compensate, verify),
            *([] if compensate is None else [Section(_SOURCES, uncertainty_tables(compensate), folded=True)]),
        ],
        message=message,
        about=_ABOUT,
    )


def _tables(compensate: CompensateResult | None, verify: VerifyResult | None) -> Iterator[Table]:
    if verify is not None:
        yield from verification_tables(verify)[:1]  # without tolerances: the tables of targets have them
        yield from measured_tables(verify)
    if compensate is not None:
        if verify is None:
            yield from predicted_tables(compensate)
        yield from unknown_tables(compensate)
        yield from refusal_tables(compensate)
