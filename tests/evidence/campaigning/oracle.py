"""The judgement of a campaign: what the run file holds against what the devices did."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cellapp.cell.run import RunFile
from cellapp.estimation.calibration.identification import Identification, identify, start_from_nominal
from cellapp.estimation.readings import Readings
from cellapp.robot.model.nominal import nominal_arm
from drivers.plant import Clearance
from tests.evidence.campaigning.monitor import Failure
from tests.sure import sure

if TYPE_CHECKING:
    from tests.evidence.campaigning.world import World

FALSE_ALARM = 1e-12
"""Chance of a false alarm of one statistical check: none in 10 000 campaigns of 400 stops."""
_PLANNED_RAD = 1e-9
"""Joint positions of a reading and of its planned stop agree but for rounding: the plant's arms are exact."""

_ENDED_BY = {"stopped": "stop", "aborted": "abort"}
"""Outcome of a session -> the request that it records."""
_KEEP_FROM_WRITING = ("disk", "program killed", "killed")
"""Faults, by the beginning of their names, after which a session may lack a record."""

ArmEstimate = Identification


@dataclass(frozen=True)
class Judgement:
    """What is wrong with a campaign, its numbers of readings and of planned ones that are missing, its estimates."""

    failures: tuple[Failure, ...]
    readings: int
    missing: int
    estimates: dict[str, ArmEstimate]


def judge(
    world: World,
    run: RunFile,
    plan: Mapping[str, NDArray[np.float64]],
    undisturbed: Mapping[str, ArmEstimate] | None,
    problems: tuple[Failure, ...],
) -> Judgement:
    """Check the run of a campaign against what the devices of its ``world`` did; ``problems`` were found before."""
    readings = {name: run.readings(name) for name in plan}
    failures = [*problems, *world.monitor.violations]
    failures += _lost_or_doubled(world, readings)
    for name, arm in readings.items():
        failures += _false(world, name, arm, plan[name])
    missing, unlisted = _missing(run, readings, run.profile.plan.stops)
    failures += unlisted
    failures += _collisions(sure(world.plant.clearance))
    moving = [name for name in world.plant.names if world.plant.moving(name)]
    failures += [Failure("motion after a stop", f"arm {name} moves at the end") for name in moving]
    failures += _unrecorded(world, run)
    estimates = {}
    if not failures:
        estimates = {name: _identified(run, name, arm, undisturbed) for name, arm in readings.items()}
        failures += _other_calibration(estimates, undisturbed)
    return Judgement(tuple(failures), sum(map(len, readings.values())), missing, estimates)


def _lost_or_doubled(world: World, readings: Mapping[str, Readings]) -> list[Failure]:
    """Readings that were reported as stored and are not there, or that are there twice or never were measured."""
    monitor = world.monitor
    found = {
        (int(stop), name): p_M.tobytes()
        for name, arm in readings.items()
        for stop, p_M in zip(arm.configuration, arm.p_M, strict=True)
    }
    used = Counter(found.values())
    return [
        *(
            Failure("reading lost", f"stop {stop}, arm {name} was reported as stored")
            for (stop, name), point in monitor.stored.items()
            if found.get((stop, name)) != point
        ),
        *(Failure("reading doubled", f"the point of {where}") for where, p in found.items() if used[p] > 1),
        *(
            Failure("reading false", f"the tracker never returned the point of {where}")
            for where, p in found.items()
            if not monitor.delivered[p]
        ),
    ]


def _false(world: World, name: str, readings: Readings, q: NDArray[np.float64]) -> list[Failure]:
    """Readings at other joint positions than planned, or at another place than the arm's true SMR."""
    if not len(readings):
        return []
    elsewhere = np.abs(readings.q - q[readings.configuration]).max(axis=1) > _PLANNED_RAD
    off = readings.p_M - world.plant.smr_positions(name, readings.q)
    square = np.einsum("na,na->n", off, np.linalg.solve(sure(readings.covariance_M), off[..., None])[..., 0])
    away = square > chdtri(3, FALSE_ALARM)
    return [
        *(
            Failure("reading false", f"stop {stop}, arm {name}: not at the planned joint positions")
            for stop in readings.configuration[elsewhere]
        ),
        *(
            Failure("reading false", f"stop {stop}, arm {name}: {1e3 * np.linalg.norm(d):.3f} mm from the SMR")
            for stop, d in zip(readings.configuration[away], off[away], strict=True)
        ),
    ]


def _missing(run: RunFile, readings: Mapping[str, Readings], stops: int) -> tuple[int, list[Failure]]:
    """Number of planned readings that are missing, and those of them without a reason."""
    reasons = {(one.stop, one.arm): one.reason for one in run.outcomes()}
    there = {(int(stop), name) for name, arm in readings.items() for stop in arm.configuration}
    gaps = [(stop, name) for stop in range(stops) for name in readings if (stop, name) not in there]
    unlisted = [
        Failure("not listed", f"stop {stop}, arm {name}: no reading and no reason")
        for stop, name in gaps
        if not reasons.get((stop, name))
    ]
    return len(gaps), unlisted


def _collisions(clearance: Clearance) -> list[Failure]:
    """Collisions by the plant's own check, which knows the true arms and every motion, braked ones too."""
    return [
        Failure("collision", f"{what} at {time_s:.3f} s: {distance_m * 1e3:.1f} mm")
        for what, distance_m, time_s in (
            ("the arms", clearance.arms_m, clearance.arms_time_s),
            ("an arm with the floor", clearance.floor_m, clearance.floor_time_s),
        )
        if not distance_m > 0.0
    ]


def _unrecorded(world: World, run: RunFile) -> list[Failure]:
    """Sessions that ended early without a reason, and stops of a person that no session recorded.

    The latter only where every session could write to the end.
    """
    sessions = run.sessions()
    failures = [
        Failure("not listed", f"session {one.number} ended as {one.outcome} without a reason")
        for one in sessions
        if one.outcome in ("failed", "stopped", "aborted") and not one.reason
    ]
    if any(kind.startswith(_KEEP_FROM_WRITING) for kind in world.struck):
        return failures
    found = Counter(request.kind for one in sessions for request in one.requests)
    found.update(_ENDED_BY.get(one.outcome or "", "") for one in sessions)
    return failures + [
        Failure("not listed", f"{asked - found[verb]} of {asked} requests to {verb} in no session")
        for verb, asked in world.person.asked.items()
        if found[verb] < asked
    ]


def _identified(
    run: RunFile, name: str, readings: Readings, undisturbed: Mapping[str, ArmEstimate] | None
) -> ArmEstimate:
    q, p_M, covariance = readings.q, readings.p_M, readings.covariance_M
    start = start_from_nominal(nominal_arm(run.profile.arms[name]), q, p_M, tool_unknown=False)
    if undisturbed is None:
        return identify(start, q, p_M, sigma=covariance)
    return identify(start, q, p_M, sigma=covariance, parameter_set=undisturbed[name].parameter_set)


def _other_calibration(
    estimates: Mapping[str, ArmEstimate], undisturbed: Mapping[str, ArmEstimate] | None
) -> list[Failure]:
    """Arms whose parameters differ from the undisturbed ones by more than their standard errors explain."""
    failures = []
    for name, before in (undisturbed or {}).items():
        off = estimates[name].values - before.values
        covariance = estimates[name].covariance + before.covariance
        square = float(off @ np.linalg.solve(covariance, off))
        if not square <= chdtri(len(off), FALSE_ALARM):
            failures.append(Failure("calibration", f"arm {name}: chi-square {square:.0f} of {len(off)} parameters"))
    return failures
