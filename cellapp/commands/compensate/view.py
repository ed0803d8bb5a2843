"""The result of ``compensate`` as tables and sentences."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.programs.records import CorrectResult
from cellapp.cell.targets.path import PathRecord, PathResult
from cellapp.cell.targets.records import CompensateResult, VerifyResult
from cellapp.commands.compensate.charts import target_charts
from cellapp.commands.compensate.program import program_view
from cellapp.commands.compensate.tables import (
    all_measured_tables,
    measured_tables,
    predicted_tables,
    stored_tables,
    uncertainty_tables,
)
from cellapp.commands.compensate.target_list import TargetState
from cellapp.commands.compensate.words import (
    compensate_lines,
    compensate_summary,
    refusal_lines,
    unknown_lines,
    verify_lines,
    verify_message,
    verify_summary,
)
from cellapp.commands.record import Request, View
from cellapp.commands.run_results import RunResults
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Table, table_of


def view(result: CompensateResult | PathResult | CorrectResult, request: Request | None = None) -> View:
    """Show what is expected at the targets, and the uncertainty's sources; of a stored result also the commands."""
    if isinstance(result, PathResult):
        return paths_view(result)
    if isinstance(result, CorrectResult):
        return program_view(result)
    tables = stored_tables(result) if request is None else predicted_tables(result)
    return View((*tables, *compensate_lines(result)))


def target_parts(results: RunResults, state: TargetState) -> list[Table | str]:
    """Show what a run knows about one target: commands, predictions, unknown conditions, measurements."""
    parts: list[Table | str] = []
    if results.compensate is not None and state.commands:
        alone = results.compensate.model_copy(update={"targets": state.commands})
        parts += [*stored_tables(alone), *compensate_lines(alone)]
    pushed = results.verify or results.push
    if pushed is not None and state.measured:
        pairs = () if state.pair is None else (state.pair,)
        measured = pushed.model_copy(update={"targets": state.measured, "pairs": pairs})
        parts += [*measured_tables(measured), *verify_lines(measured)]
    return parts


def paths_view(result: PathResult) -> View:
    """Show the paths, the joints that reverse on them, and what limits or refuses them."""
    planned = [path for path in result.paths if not path.refusal]
    lines = [f"path {path.name}: refused: {path.refusal}" for path in result.paths if path.refusal]
    lines += [
        f"path {path.name}: the wanted speed is not kept everywhere: {path.slowed}" for path in planned if path.slowed
    ]
    lines += [f"written to {file}" for file in result.files]
    tables = [table for table in (_plans(planned), _reversals(planned)) if table.rows]
    return View((*tables, *lines, *result.notes), result.complaints())


def paths_section(result: PathResult) -> Section:
    """Show the paths of a run, with how many can be driven."""
    refused = sum(bool(path.refusal) for path in result.paths)
    return section_of(
        paths_view(result).parts,
        message=f"{len(result.paths) - refused} of {len(result.paths)} paths can be driven.",
        about="Lines and arcs with speeds, as joint paths of the calibrated model; see 'cellapp docs targets'.",
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _plans(paths: list[PathRecord]) -> Table:
    return table_of(
        "Paths",
        paths,
        ("path", "name"),
        ("arm", "arm"),
        ("length", "length_mm", ".0f", "mm"),
        ("time", "duration_s", ".2f", "s"),
        ("at speed", "at_speed", ".0f", "%"),
        ("tolerance", "tolerance_mm", ".3f", "mm"),
        ("off by the model", "deviation_mm", ".4f", "mm"),
        ("sigma", "uncertainty_mm", ".4f", "mm"),
    )


def _reversals(paths: list[PathRecord]) -> Table:
    return table_of(
        "Joints that reverse",
        [(path.name, one) for path in paths for one in path.reversals],
        ("path", lambda row: row[0]),
        ("joint", lambda row: row[1].joint, "d"),
        ("at", lambda row: row[1].at_mm, ".1f", "mm"),
        ("play crossed", lambda row: row[1].jump_mm, ".3f", "mm"),
        ("within", lambda row: row[1].window_mm, ".1f", "mm"),
    )


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
    predicted = []
    if compensate is not None:
        open_ = [*unknown_lines(compensate.targets), *refusal_lines(compensate)]
        predicted = [*compensate_summary(compensate), *open_]
    measured = [] if verify is None else verify_summary(verify)
    message = predicted[0] if verify is None else verify_message(verify)
    charts = target_charts(verify, floors_mm)
    return section_of(
        [
            *(line for line in (*measured, *predicted) if line != message),
            *(chart for chart in charts if not chart.is_empty),
            *([] if verify is None else all_measured_tables(verify)),
            *([] if compensate is None or verify is not None else predicted_tables(compensate)),
            *([] if compensate is None else [Section(uncertainty_tables(compensate), folded=True, title=_SOURCES)]),
        ],
        message=message,
        about=_ABOUT,
    )
