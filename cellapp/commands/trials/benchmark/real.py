"""Real series of the league as problems: their truth is unknown, so held-out errors are judged, not names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.commands.trials.benchmark.methods.answer import answer_of
from cellapp.commands.trials.benchmark.problem import Problem
from cellapp.commands.trials.benchmark.scoring import ScoredAnswer
from cellapp.commands.trials.league.series import SERIES, Entrant, Rows, SeriesTexts, draw_rows, parse_entrants
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.ground.results import Record
from cellapp.ground.scale.task import TaskKind

REAL = "real"
"""Prefix of the names of their sets."""


class RealQuestion(Record):
    """Rows of a series, drawn by a seed, for one method."""

    method: str
    series: str
    rows: Rows
    seed: int


def _answered(entrants: Mapping[str, Entrant], asked: RealQuestion) -> ScoredAnswer:
    """Let the method learn from some rows and predict all others."""
    entrant = entrants[asked.series]
    drawn = draw_rows(entrant, asked.rows, asked.seed)
    readings = drawn.split(entrant.readings)
    kept = np.sort(np.concatenate([drawn.learned, drawn.judged]))
    own = readings.take(np.isin(np.arange(len(readings)), kept))
    name = f"{REAL}/{asked.series}/{asked.seed}"
    problem = Problem.of(name, entrant.profile, entrant.arm, own, measurement_conditions(own))
    measured = own.p_M[own.in_split("validate")]
    answer, seconds = answer_of(asked.method, problem)
    return ScoredAnswer(
        method=asked.method,
        problem=name,
        set=f"{REAL} {asked.series}",
        hidden=(),
        exact=None,
        statements=(),
        heldout_ratio=None,
        seconds=seconds,
        heldout_mm=None if answer is None else 1e3 * float(np.mean(np.linalg.norm(answer.p_M - measured, axis=1))),
        answered=answer is not None,
    )


REAL_ANSWERS = TaskKind(
    "cellapp.commands.trials.benchmark.real:REAL_ANSWERS",
    SeriesTexts,
    RealQuestion,
    ScoredAnswer,
    parse_entrants,
    _answered,
)


def records_words(series: Sequence[str]) -> list[str]:
    """State the errors that others published for these series."""
    return [
        f"{SERIES[name].title}: {SERIES[name].published_mm} mm published for the rows that its authors held out,"
        f" {SERIES[name].published_how}"
        for name in series
        if SERIES[name].published_mm is not None
    ]
