"""One draw of the league: calibrate and discover on some rows, judge geometry, network and discovery on the others."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from cellapp.commands.trials.league.series import Entrant, Group, Rows, SeriesTexts, draw_rows, parse_entrants
from cellapp.estimation.calibration.calibrate import calibrate_arm, train_arm
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.readings import Readings
from cellapp.ground.results import Record
from cellapp.ground.scale.task import TaskKind
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_TWO_SIDED_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


class TurnScore(Record):
    """Mean errors of orientations on held-out rows, and the share of their components within the stated 95 %."""

    geometry_mrad: float
    discovery_mrad: float
    within_95: float


class HeldOutScore(Record):
    """Errors of the three models on held-out rows.

    Attributes
    ----------
    n : int
        Held-out rows.
    geometry_mm, network_mm, discovery_mm : float
        Mean position error. That of the residual network is None where it was not asked for, and that of geometry
        alone where its folds chose no network.
    within_95 : float
        Share of the measured coordinates within the 95 % interval that discovery states for them.
    turned : TurnScore, optional
        Of orientations, where they were measured.
    """

    n: int
    geometry_mm: float
    network_mm: float | None
    discovery_mm: float
    within_95: float
    turned: TurnScore | None = None
    omitted_when_none = frozenset({"turned"})


class LeagueDraw(Record):
    """One draw: ``learned`` rows of a series, drawn by ``seed``.

    Attributes
    ----------
    rows : int or "all"
        The size that was asked for.
    scores : mapping
        Group of held-out rows -> errors; the first one is all of them.
    names : tuple of str
        Effects that discovery accepted.
    seconds : float
        Wall time of discovery, in one thread [s].
    """

    series: str
    rows: Rows
    seed: int
    learned: int
    scores: Mapping[Group, HeldOutScore]
    names: tuple[str, ...]
    verdict: str
    seconds: float


class DrawTask(Record):
    """What to draw of a series; ``learnable`` as in ``draw_rows``, ``network`` trains the residual network too."""

    series: str
    rows: Rows
    seed: int
    network: bool = False
    learnable: int | None = None


def run_draw(entrant: Entrant, task: DrawTask) -> LeagueDraw:
    """Learn from the drawn rows, and judge by the held-out ones. Raises ``InputError`` if there are too few rows."""
    rows = draw_rows(entrant, task.rows, task.seed, task.learnable)
    profile = entrant.profile.model_copy(update={"seed": task.seed})
    readings = rows.split(entrant.readings)
    conditions = measurement_conditions(readings)
    arm, _ = calibrate_arm(profile, entrant.arm, readings)
    began = time.perf_counter()
    found = discover_arm(profile, entrant.arm, arm.model, readings, conditions=conditions)
    seconds = time.perf_counter() - began
    network = train_arm(profile, arm, readings).model if task.network else None
    left = {
        name: readings.p_M - model.predict(readings.q, conditions=conditions)
        for name, model in (("geometry", arm.model), ("network", network), ("discovery", found.model))
        if model is not None
    }
    sd = found.model.measured_uncertainty(readings.q, conditions)
    return LeagueDraw(
        series=entrant.name,
        rows=task.rows,
        seed=task.seed,
        learned=len(rows.learned),
        scores={
            group: _score({name: off[some] for name, off in left.items()}, sd[some]).model_copy(
                update={"turned": _turn_score(readings.take(some), conditions.take(some), arm.model, found.model)}
            )
            for group, some in rows.held_out.items()
        },
        names=tuple(effect.effect for effect in found.result.accepted),
        verdict=found.result.verdict,
        seconds=seconds,
    )


def _score(left: Mapping[str, Array], sd: Array) -> HeldOutScore:
    """Score residuals (n, 3) [m] by model, beside the stated standard deviations (n,) [m]."""
    means = {name: float(np.linalg.norm(off, axis=1).mean()) * 1e3 for name, off in left.items()}
    return HeldOutScore(
        n=len(sd),
        geometry_mm=means["geometry"],
        network_mm=means.get("network"),
        discovery_mm=means["discovery"],
        within_95=float(np.mean(np.abs(left["discovery"]) <= _TWO_SIDED_95 * sd[:, np.newaxis])),
    )


def _turn_score(
    readings: Readings, conditions: MeasurementConditions, geometry: ArmModel, discovery: ArmModel
) -> TurnScore | None:
    """Score the orientations at held-out rows; None if none was measured."""
    its = measured_quantities(readings, conditions)
    if its.turned is None:
        return None
    rows = np.flatnonzero(its.turned)
    q, then = its.readings.q[rows], its.conditions.take(rows)
    off = [model.predict(q, conditions=then) for model in (geometry, discovery)]
    means = [float(np.linalg.norm(one, axis=1).mean()) * 1e3 for one in off]
    sd = discovery.measured_uncertainty(q, then)
    within = float(np.mean(np.abs(off[1]) <= _TWO_SIDED_95 * sd[:, np.newaxis]))
    return TurnScore(geometry_mrad=means[0], discovery_mrad=means[1], within_95=within)


def _draw(entrants: Mapping[str, Entrant], task: DrawTask) -> LeagueDraw:
    return run_draw(entrants[task.series], task)


DRAWS = TaskKind("cellapp.commands.trials.league.draws:DRAWS", SeriesTexts, DrawTask, LeagueDraw, parse_entrants, _draw)
