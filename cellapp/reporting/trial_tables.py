"""Tables of the trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cellapp.reporting.table import Cell, Column, Number, Table, number_column

if TYPE_CHECKING:  # the trials open devices; their tables need only the types
    from cellapp.trials.bridge import BridgeResult
    from cellapp.trials.links import LinksResult, TimeSpread
    from cellapp.trials.paper import PaperResult
    from cellapp.trials.parameter_sets import ParameterSetTrial

_MM, _S = ".4f", ".3f"


def parameter_set_table(arm: str, trials: Sequence[ParameterSetTrial]) -> Table:
    """Redundant against reduced parameter sets, by solver."""
    rows = [
        (
            f"{trial.parameter_set} ({trial.parameters}), {trial.solver}",
            trial.iterations,
            f"{trial.converged} of {trial.seeds}",
            trial.mean_mm,
            trial.max_mm,
        )
        for trial in trials
    ]
    columns = (
        Column("set (parameters), solver"),
        number_column("iterations", "g"),
        Column("converged"),
        number_column("mean", ".4g", "mm"),
        number_column("max", ".4g", "mm"),
    )
    return Table(f"Arm {arm}: redundant and reduced models, medians over seeds", columns, tuple(rows))


def paper_tables(result: PaperResult) -> list[Table]:
    """The methods of the paper over seeds beside the paper's figures; position errors; errors at another station."""
    rows: list[tuple[Cell, ...]] = [
        (method, entry.median, entry.worst, entry.paper) for method, entry in result.cooperative_mm.items()
    ]
    gain = (result.gain.median, result.gain.worst, result.gain.paper)
    rows.append(
        ("proposed below method_1", *(None if share is None else Number(100 * share, 1, "%") for share in gain))
    )
    columns = (Column("method"), *(number_column(title, _MM) for title in ("median", "worst", "paper")))
    title = f"Mean cooperative error [mm], {len(result.trials)} simulated cells"
    return [
        Table(title, columns, tuple(rows)),
        _seeds_table("Mean position error [mm]", [trial.position_mm for trial in result.trials]),
        _seeds_table("At another tracker station [mm]", [trial.moved_mm for trial in result.trials]),
    ]


def _seeds_table(title: str, trials: Sequence[Mapping[str, Mapping[str, float]]]) -> Table:
    """Median and worst over seeds, from errors by arm and model."""
    rows: list[tuple[Cell, ...]] = []
    for arm, models in trials[0].items():
        for model in models:
            errors = sorted(trial[arm][model] for trial in trials if model in trial[arm])
            rows.append((f"{arm}, {model}", errors[len(errors) // 2], errors[-1]))
    return Table(title, (Column("arm, model"), number_column("median", _MM), number_column("worst", _MM)), tuple(rows))


def link_table(result: LinksResult) -> Table:
    """Times that emulated arms took under the real client, without and with faults."""
    rows: list[tuple[Cell, ...]] = [
        ("connect", *_time_cells(result.connect_s)),
        ("read the state", *_time_cells(result.state_s)),
        ("motion, beyond its ideal time", *_time_cells(result.move_overhead_s)),
    ]
    for fault, times in result.by_fault.items():
        rows.append((f"{fault}: reported", *_time_cells(times.reported_s)))
        rows.append((f"{fault}: at rest", *_time_cells(times.at_rest_s)))
        rows.append((f"{fault}: ready again", *_time_cells(times.recovered_s)))
    columns = (
        Column("what"),
        *(number_column(title, _S) for title in ("median", "95 %", "max")),
        number_column("n", "d"),
    )
    return Table("Times [s]", columns, tuple(rows))


def _time_cells(spread: TimeSpread | None) -> tuple[Cell, ...]:
    return (None, None, None, 0) if spread is None else (spread.median, spread.p95, spread.max, spread.n)


def bridge_table(result: BridgeResult) -> Table:
    """Longest time of a measurement by fault; the first row has the median of those without a fault."""
    undisturbed = ("none", result.asked - sum(result.faults.values()), result.undisturbed_s)
    rows = [(fault, result.faults[fault], longest) for fault, longest in result.recovery_s.items()]
    columns = (Column("fault"), number_column("n", "d"), number_column("longest; none: median", _S))
    return Table("Times of a measurement [s]", columns, (undisturbed, *rows))
