"""Tables of ``trials targets``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cellapp.commands.trials.target_records import (
    LEAST_GAIN,
    LEAST_RATIO,
    MOST_OF_FLOOR,
    ArmFigures,
    PairFigures,
    TargetTrialsResult,
    mean_of,
)
from cellapp.commands.view.table import Cell, Column, Table, number_column


def target_trial_tables(result: TargetTrialsResult) -> list[Table]:
    """Errors by arm and by pair in every state, a row each cell and one of the means; then what was hidden."""
    tables = []
    for state in result.states():
        tables += [_arms(result, state), _promises(result, state)]
        if result.pairs(state):
            tables.append(_pairs(result, state))
    return [*tables, _effects(result)]


def target_trial_sentences(result: TargetTrialsResult) -> list[str]:
    """What the columns mean, and which bars are missed."""
    return [
        f"Bars on the means: at least {LEAST_RATIO:g} times below nominal, at most {MOST_OF_FLOOR:g} times the floor,"
        f" cooperative at least {LEAST_GAIN:.0%} below the paper's proposed method on the same readings.",
        "Floor: repeated measurements of the same point, the tracker's noise and the arm's repeatability.",
        "Changed since: displacement by effects of time between the last reading and the last target.",
        *(
            f"Seed {trial.seed}: the moved tracker was not located: {trial.location}."
            for trial in result.trials
            if trial.location != "located"
        ),
        *(f"Missed: {text}." for text in result.complaints()),
    ]


def _arms(result: TargetTrialsResult, state: str) -> Table:
    """Errors of single targets."""
    return Table(
        f"{result.profile}: single targets, {state}",
        (
            Column("arm"),
            Column("seed"),
            number_column("targets", "d"),
            number_column("refused", "d"),
            number_column("nominal", ".3f", "mm"),
            number_column("ours", ".4f", "mm"),
            number_column("times", ".0f"),
            number_column("floor", ".4f", "mm"),
            number_column("of floor", ".2f"),
        ),
        _rows_of_arms(result, state, _error_cells),
    )


def _promises(result: TargetTrialsResult, state: str) -> Table:
    """How often measurements keep what was stated of them, beside what no calibration can foresee."""
    return Table(
        f"{result.profile}: stated intervals of single targets, {state}",
        (
            Column("arm"),
            Column("seed"),
            number_column("distances", ".1f", "%"),
            number_column("coordinates", ".1f", "%"),
            number_column("changed since", ".4f", "mm"),
            number_column("paper's", ".4f", "mm"),
        ),
        _rows_of_arms(result, state, _promise_cells),
    )


def _rows_of_arms(
    result: TargetTrialsResult, state: str, cells: Callable[[Sequence[ArmFigures]], tuple[Cell, ...]]
) -> tuple[tuple[Cell, ...], ...]:
    """A row for each arm of each cell, and one of the means of each arm."""
    rows: list[tuple[Cell, ...]] = []
    for name, arms in result.by_arm(state).items():
        seeds = [trial.seed for trial in result.trials if state in trial.states]
        rows += [(name, str(seed), *cells([arm])) for seed, arm in zip(seeds, arms, strict=True)]
        rows.append((name, "mean", *cells(arms)))
    return tuple(rows)


def _error_cells(arms: Sequence[ArmFigures]) -> tuple[Cell, ...]:
    nominal, ours = mean_of(arm.nominal_mm for arm in arms), mean_of(arm.compensated_mm for arm in arms)
    floor = mean_of(arm.floor_mm for arm in arms)
    assert nominal is not None
    assert ours is not None
    assert floor is not None
    counts = sum(arm.targets for arm in arms), sum(arm.refused for arm in arms)
    return (*counts, nominal, ours, nominal / ours, floor, ours / floor)


def _promise_cells(arms: Sequence[ArmFigures]) -> tuple[Cell, ...]:
    return (
        _percent(mean_of(arm.within_95 for arm in arms)),
        _percent(mean_of(arm.coordinates_95 for arm in arms)),
        mean_of(arm.changed_mm for arm in arms),
        mean_of(arm.paper_mm for arm in arms),
    )


def _pairs(result: TargetTrialsResult, state: str) -> Table:
    rows = [
        (str(trial.seed), *_pair_cells([pair]))
        for trial in result.trials
        if state in trial.states and (pair := trial.states[state].pair) is not None
    ]
    rows.append(("mean", *_pair_cells(result.pairs(state))))
    return Table(
        f"{result.profile}: cooperative targets, {state}",
        (
            Column("seed"),
            number_column("targets", "d"),
            number_column("refused", "d"),
            number_column("nominal", ".3f", "mm"),
            number_column("compensated", ".4f", "mm"),
            number_column("floor", ".4f", "mm"),
            number_column("paper's", ".4f", "mm"),
            number_column("below paper's", ".0f", "%"),
        ),
        tuple(rows),
    )


def _pair_cells(pairs: Sequence[PairFigures]) -> tuple[int | float | None, ...]:
    ours, paper = mean_of(pair.compensated_mm for pair in pairs), mean_of(pair.paper_mm for pair in pairs)
    return (
        sum(pair.targets for pair in pairs),
        sum(pair.refused for pair in pairs),
        mean_of(pair.nominal_mm for pair in pairs),
        ours,
        mean_of(pair.floor_mm for pair in pairs),
        paper,
        None if paper is None or ours is None else 100.0 * (1.0 - ours / paper),
    )


def _effects(result: TargetTrialsResult) -> Table:
    return Table(
        f"{result.profile}: hidden effects and what was found",
        (Column("seed"), Column("arm"), Column("hidden"), Column("laws"), Column("found"), Column("verdict")),
        tuple(
            (str(trial.seed), name, ", ".join(arm.hidden), arm.laws, ", ".join(arm.found), arm.verdict)
            for trial in result.trials
            for name, arm in trial.effects.items()
        ),
    )


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
