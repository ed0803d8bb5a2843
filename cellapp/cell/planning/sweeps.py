"""Sweeps: at each stop of a plan every arm swings about it, the others resting, its SMR turned to the tracker.

Of several random motions that one is taken that tells most in its time of geometry and effects beside
the stops and sweeps before; it is made narrower until the tracker sees all of it and the gate accepts the whole way.
Motions about successive stops take turns between two speeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from cellapp.cell.planning.planned_stops import PlannedStops, last_motions
from cellapp.cell.planning.records import SweepForecast
from cellapp.cell.planning.sweep_design import SweepDesign
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, Gate, refuse_motion, visible
from cellapp.cell.safety.path_gate import refuse_path
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.ground.results import Record
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.sweep import Sweep

SWEEPS_RESULT = "planned_sweeps"
"""Name of the document; it is part of the file format."""
_HARMONICS = 4
_PERIODS_S = (16.0, 32.0)
"""Shortest periods of motions about successive stops [s]: both directions of each joint at two speeds."""
_REACH_RAD = (0.15, 0.9)
"""Amplitudes of single joints are drawn between these."""
_DRAWS = 16
_NARROWER = 0.75
_NARROWEST = 0.08
"""Share of a drawn motion below which another one is taken."""
_SPEED_SHARE, _ACCELERATION_SHARE = 0.5, 0.5
"""Of the limits of the joints."""
_JERK_S = 0.1
"""An acceleration may build up within this time."""
_FASTEST_M_S = 0.25
"""Of the SMR: the limit of a person's reach into the cell, and slow enough for any tracker."""
_SEEN_S, _GATE_S = 0.1, 0.05
"""Samples of a motion for the tracker's sight, and for the gate [s]."""


class PlannedSweep(Record):
    """A motion of one arm about a stop; ``sine`` and ``cosine`` are the coefficients of ``Sweep`` by harmonic [rad]."""

    arm: str
    stop: int
    period_s: float
    sine: tuple[tuple[float, ...], ...]
    cosine: tuple[tuple[float, ...], ...]

    @property
    def name(self) -> str:
        """What its recording is called."""
        return f"sweep-{self.stop + 1}"

    def motion(self, center: Array) -> Sweep:
        """The motion about a stop at ``center`` (N,) [rad]."""
        return Sweep(center, np.array(self.sine), np.array(self.cosine), self.period_s)


class PlannedSweeps(Record):
    """All sweeps of a run, sentences on what could not be planned, and what they will tell of each arm."""

    sweeps: tuple[PlannedSweep, ...]
    notes: tuple[str, ...] = ()
    forecast: Mapping[str, SweepForecast] = {}


@dataclass(frozen=True, eq=False)
class _Known:
    """Of an arm: the joint positions of all its stops (n, N) [rad], what sweeps shall tell, and what these and those so
    far do (P, P)."""

    stops: Array
    design: SweepDesign
    information: Array


def read_sweeps(run: RunFile) -> tuple[PlannedSweep, ...]:
    """The planned sweeps of a run; none if none were planned. Raises ``InputError`` if their document is damaged."""
    return read_planned_sweeps(run).sweeps


def read_planned_sweeps(run: RunFile) -> PlannedSweeps:
    """The same with notes and forecast."""
    text = run.read_result(SWEEPS_RESULT)
    if text is None:
        return PlannedSweeps(sweeps=())
    try:
        return PlannedSweeps.model_validate_json(text)
    except ValidationError:
        raise InputError(f"{run.path} is damaged ({SWEEPS_RESULT}); restore it from a copy") from None


def plan_sweeps(
    profile: Profile, stops: PlannedStops, listener: Listener = ignore, cancel: CancelToken | None = None
) -> PlannedSweeps:
    """A sweep of each arm at each stop, as far as the gate and the tracker allow one.

    Raises
    ------
    InputError
        If no arm can sweep anywhere.
    Cancelled
    """
    cancel, cell, found = cancel or CancelToken(), cell_bodies(profile), []
    step, known = last_motions(stops, home_positions(profile)), {}
    for name, q in stops.q.items():
        design = SweepDesign.of(profile, name)
        known[name] = _Known(q, design, design.before(q, np.sign(step[name])))
    refused: list[str] = []
    for stop in range(len(stops)):
        listener(Progress("sweeps", stop, len(stops), f"sweeps about stop {stop + 1}"))
        at = stops.targets(stop)
        for number, name in enumerate(stops.q):
            cancel.check()
            rng = np.random.default_rng([profile.seed, 0x5EEB, stop, number])
            motion = _sweep_about(profile, cell, name, at, _PERIODS_S[stop % len(_PERIODS_S)], known[name], rng)
            if motion is None:
                refused.append(f"arm {name}: no sweep about stop {stop + 1} keeps clear and seen")
                continue
            told = known[name].information + known[name].design.told(motion)
            known[name] = replace(known[name], information=told)
            sine, cosine = (tuple(map(tuple, table.tolist())) for table in (motion.sine, motion.cosine))
            found.append(PlannedSweep(arm=name, stop=stop, period_s=motion.period_s, sine=sine, cosine=cosine))
    if not found:
        raise InputError("plan: no sweep keeps clear of the cell and seen by the tracker at any stop")
    return PlannedSweeps(sweeps=tuple(found), notes=tuple(refused))


def refuse_sweep(
    cell: CellBodies, name: str, motion: Sweep, others: Mapping[str, Array], gate: Gate = refuse_motion
) -> str:
    """Why an arm must not sweep while the ``others`` rest; empty if it may. Every sample is checked with the gate."""
    time_s = motion.times(_GATE_S)
    q = motion.at(time_s)
    low, high = cell.arms[name].limits.T
    if not ((q >= low) & (q <= high)).all():
        return f"arm {name}: a joint would leave its limits"
    return refuse_path(cell, name, q, others, time_s, gate)


def _sweep_about(
    profile: Profile,
    cell: CellBodies,
    name: str,
    at: Mapping[str, Array],
    period_s: float,
    known: _Known,
    rng: np.random.Generator,
) -> Sweep | None:
    """The motion about a stop that tells most in its time beside what is ``known``; None if none is allowed."""
    others = {other: q for other, q in at.items() if other != name}
    towards = known.stops[rng.integers(len(known.stops), size=_DRAWS)]
    drawn = [_seen(cell, name, _drawn(at[name], posture, period_s, rng), others) for posture in towards]
    seen = [_slow_enough(profile, cell, name, one) for one in drawn if one is not None]
    before = float(np.linalg.slogdet(known.information)[1])
    told = [float(np.linalg.slogdet(known.information + known.design.told(one))[1]) for one in seen]
    worth = [(its - before) / one.period_s for its, one in zip(told, seen, strict=True)]
    for place in np.argsort(worth)[::-1]:
        motion: Sweep | None = seen[place]
        while motion is not None and refuse_sweep(cell, name, motion, others):
            motion = _narrower(motion)
        if motion is not None:
            return motion
    return None


def _drawn(center: Array, towards: Array, period_s: float, rng: np.random.Generator) -> Sweep:
    """A random motion with an amplitude of its own for each joint, and a share of the way ``towards`` a posture."""
    order = np.arange(1, _HARMONICS + 1)[:, None]
    sine, cosine = (rng.normal(size=(_HARMONICS, len(center))) / order for _ in range(2))
    motion = Sweep(center, sine, cosine, period_s)
    reach = np.abs(motion.at(motion.times(period_s / 200.0)) - center).max(axis=0)
    wanted = np.exp(rng.uniform(np.log(_REACH_RAD[0]), np.log(_REACH_RAD[1]), len(center))) / reach
    cosine *= wanted
    cosine[0] += rng.uniform(0.0, 0.5) * (towards - center)
    return Sweep(center, sine * wanted, cosine, period_s)


def _narrower(motion: Sweep) -> Sweep | None:
    """The same motion somewhat narrower; None if that leaves next to nothing."""
    smaller = motion.scaled(_NARROWER)
    reach = np.abs(smaller.at(smaller.times(smaller.period_s / 100.0)) - smaller.center).max()
    return smaller if reach > _NARROWEST else None


def _seen(cell: CellBodies, name: str, motion: Sweep, others: Mapping[str, Array]) -> Sweep | None:
    """The motion, so narrow that the tracker sees all of it; None if it does not even at its narrowest."""
    found: Sweep | None = motion
    while found is not None:
        time_s = found.times(_SEEN_S)
        beside = {other: np.broadcast_to(q, (len(time_s), len(q))) for other, q in others.items()}
        if visible(cell, name, found.at(time_s), beside).all():
            return found
        found = _narrower(found)
    return None


def _slow_enough(profile: Profile, cell: CellBodies, name: str, motion: Sweep) -> Sweep:
    """The motion within the limits of the joints and of the SMR's speed."""
    arm = profile.arms[name]
    speed = _SPEED_SHARE * arm.speed_scale * np.array([joint.speed for joint in arm.type.joints])
    acceleration = _ACCELERATION_SHARE * arm.speed_scale * np.array([joint.acceleration for joint in arm.type.joints])
    slower = motion.slowed(speed, acceleration, acceleration / _JERK_S)
    time_s = slower.times(slower.period_s / 400.0)
    way = np.diff(smr_positions(cell.arms[name].geometry, slower.at(time_s)), axis=0)
    fastest = float(np.linalg.norm(way, axis=1).max()) / (time_s[1] - time_s[0])
    return replace(slower, period_s=slower.period_s * max(1.0, fastest / _FASTEST_M_S))
