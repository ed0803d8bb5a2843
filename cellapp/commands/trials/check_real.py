"""False alarms of the check on real robots: rows that their calibration did not see.

Rows of a series are drawn: some for the calibration, a quarter of them held out as usual, the others for checks. The
draw is random, so that the robot's drift over the series is in both. Each check chooses its stops among some of the
other rows. Correlated errors of a real arm would appear as a change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cellapp.commands.trials.check_records import CheckedChange, CheckTrialResult
from cellapp.commands.trials.league.series import Entrant, SeriesTexts, parse_entrants
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.monitoring.check import check_belief, choose_stops
from cellapp.estimation.monitoring.check.conclusion import judgement
from cellapp.estimation.monitoring.check.linear import stop_rows
from cellapp.estimation.monitoring.check.sequential import decided_prefix, design_of
from cellapp.estimation.readings import Readings
from cellapp.ground.results import Record
from cellapp.ground.scale.task import TaskKind
from cellapp.robot.model import CellModel

_AMONG = 4
"""Candidate rows per stop of a check: the choice prefers the more extreme ones."""
_HELD_OUT_EVERY = 4


class RealCheckTask(Record):
    """A draw of rows of a series, and how many checks are made with the others."""

    series: str
    seed: int
    rows: int
    planned: int
    checks: int


class RealChecks(Record):
    """The checks of one draw."""

    checks: tuple[CheckedChange, ...]


def real_check_trials(
    texts: SeriesTexts,
    seeds: Sequence[int],
    work: Work = IN_PLACE,
    *,
    rows: int,
    planned: int,
    checks: int,
) -> CheckTrialResult:
    """Run checks on measured series, in which nothing changed but by drift. Raises as ``Work.gather`` does."""
    tasks = [
        RealCheckTask(series=name, seed=seed, rows=rows, planned=planned, checks=checks)
        for name in texts.series
        for seed in seeds
    ]
    gathered = work.gather(REAL_CHECKS, "check", texts, tasks, "series {0.series}, seed {0.seed}")
    return CheckTrialResult(
        profile=f"series {', '.join(texts.series)}",
        cells=len(gathered.found),
        planned=planned,
        station_free=False,
        weakest={},
        checks=tuple(check for one in gathered.found for check in one.checks),
        failed=gathered.failed,
    )


def real_checks(entrants: Mapping[str, Entrant], task: RealCheckTask) -> RealChecks:
    """Run all checks on one draw of rows."""
    entrant = entrants[task.series]
    readings = entrant.readings
    rng = np.random.default_rng([task.seed, 0xC4EC])
    rows = rng.permutation(len(readings))
    known, others = _learned(readings, np.sort(rows[: task.rows])), rows[task.rows :]
    profile = entrant.profile.model_copy(update={"seed": task.seed})
    model = calibrate_arm(profile, entrant.arm, known)[0].model
    conditions = measurement_conditions(known)
    model = discover_arm(profile, entrant.arm, model, known, conditions=conditions).model
    belief = check_belief(profile, CellModel({entrant.arm: model}), {entrant.arm: known})
    design, found = design_of(belief), []
    for _ in range(task.checks):
        some = rng.permutation(others)[: _AMONG * task.planned]
        order = choose_stops(belief, {entrant.arm: readings.q[some]}, task.planned).order
        stops = stop_rows(belief, {entrant.arm: readings.take(some[order])}, design.directions)
        measured, state = decided_prefix(design, stops)
        verdict = judgement(design, measured, state)[0]
        found.append(
            CheckedChange(
                seed=task.seed,
                group="unchanged",
                arm=entrant.name,
                what="",
                visible=False,
                moved_mm=0.0,
                verdict=verdict,
                stops=state.stops,
            )
        )
    return RealChecks(checks=tuple(found))


REAL_CHECKS = TaskKind(
    "cellapp.commands.trials.check_real:REAL_CHECKS",
    SeriesTexts,
    RealCheckTask,
    RealChecks,
    parse_entrants,
    real_checks,
)


def _learned(readings: Readings, rows: np.ndarray) -> Readings:
    words = tuple("validate" if k % _HELD_OUT_EVERY == 0 else "identify" for k in range(len(rows)))
    return replace(readings.take(rows), split=words)
