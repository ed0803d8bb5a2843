"""Tables of ``trials targets``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cellapp.commands.trials.target_records import (
    LEAST_GAIN,
    LEAST_RATIO,
    MOST_OF_FLOOR,
    ArmFigures,
    PairFigures,
    TargetTrialsResult,
    mean_of,
)
from cellapp.commands.view.table import Field, Table, table_of


def target_trial_tables(result: TargetTrialsResult) -> list[Table]:
    """Show errors by arm and by pair in every state, a row for each cell and one of the means; then hidden effects."""
    tables = []
    for state in result.states():
        tables += [_arms(result, state), _promises(result, state)]
        if result.pairs(state):
            tables.append(_pairs(result, state))
    return [*tables, _effects(result)]


def target_trial_sentences(result: TargetTrialsResult) -> list[str]:
    """Explain the columns, and state which bars are missed."""
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
    """Show errors of single targets."""
    return table_of(
        f"{result.profile}: single targets, {state}",
        _lines_of_arms(result, state),
        *_ARM,
        *_COUNTS,
        ("nominal", lambda line: line.mean("nominal_mm"), ".3f", "mm"),
        ("ours", lambda line: line.mean("compensated_mm"), ".4f", "mm"),
        ("times", lambda line: line.ratio("nominal_mm", "compensated_mm"), ".0f"),
        ("floor", lambda line: line.mean("floor_mm"), ".4f", "mm"),
        ("of floor", lambda line: line.ratio("compensated_mm", "floor_mm"), ".2f"),
    )


def _promises(result: TargetTrialsResult, state: str) -> Table:
    """Show how often measurements are within their stated intervals, beside what no calibration can predict."""
    return table_of(
        f"{result.profile}: stated intervals of single targets, {state}",
        _lines_of_arms(result, state),
        *_ARM,
        ("distances", lambda line: line.mean("within_95"), ".1f", "%"),
        ("coordinates", lambda line: line.mean("coordinates_95"), ".1f", "%"),
        ("changed since", lambda line: line.mean("changed_mm"), ".4f", "mm"),
        ("paper's", lambda line: line.mean("paper_mm"), ".4f", "mm"),
    )


def _pairs(result: TargetTrialsResult, state: str) -> Table:
    pairs = {
        str(trial.seed): [pair]
        for trial in result.trials
        if state in trial.states and (pair := trial.states[state].pair) is not None
    }
    return table_of(
        f"{result.profile}: cooperative targets, {state}",
        [_Line("", seed, some) for seed, some in {**pairs, "mean": result.pairs(state)}.items()],
        _SEED,
        *_COUNTS,
        ("nominal", lambda line: line.mean("nominal_mm"), ".3f", "mm"),
        ("compensated", lambda line: line.mean("compensated_mm"), ".4f", "mm"),
        ("floor", lambda line: line.mean("floor_mm"), ".4f", "mm"),
        ("paper's", lambda line: line.mean("paper_mm"), ".4f", "mm"),
        ("below paper's", lambda line: line.below_paper(), ".0f", "%"),
    )


@dataclass(frozen=True)
class _Line:
    """A row: the figures of an arm, or of the pair, of one cell or the means of all cells."""

    arm: str
    seed: str
    figures: Sequence[ArmFigures | PairFigures]

    def mean(self, name: str) -> float | None:
        return mean_of(getattr(one, name) for one in self.figures)

    def ratio(self, above: str, below: str) -> float | None:
        over, under = self.mean(above), self.mean(below)
        return None if over is None or under is None else over / under

    def below_paper(self) -> float | None:
        ratio = self.ratio("compensated_mm", "paper_mm")
        return None if ratio is None else 1.0 - ratio


_SEED: Field = ("seed", "seed")
_ARM: tuple[Field, ...] = (("arm", "arm"), _SEED)
_COUNTS: tuple[Field, ...] = (
    ("targets", lambda line: sum(one.targets for one in line.figures), "d"),
    ("refused", lambda line: sum(one.refused for one in line.figures), "d"),
)


def _lines_of_arms(result: TargetTrialsResult, state: str) -> list[_Line]:
    """Return a row for each arm of each cell, and one of each arm's means."""
    seeds = [str(trial.seed) for trial in result.trials if state in trial.states]
    lines = []
    for name, arms in result.by_arm(state).items():
        lines += [_Line(name, seed, [arm]) for seed, arm in zip(seeds, arms, strict=True)]
        lines.append(_Line(name, "mean", arms))
    return lines


def _effects(result: TargetTrialsResult) -> Table:
    return table_of(
        f"{result.profile}: hidden effects and what was found",
        [(str(trial.seed), name, arm) for trial in result.trials for name, arm in trial.effects.items()],
        ("seed", lambda row: row[0]),
        ("arm", lambda row: row[1]),
        ("hidden", lambda row: ", ".join(row[2].hidden)),
        ("laws", lambda row: row[2].laws),
        ("found", lambda row: ", ".join(row[2].found)),
        ("verdict", lambda row: row[2].verdict),
    )
