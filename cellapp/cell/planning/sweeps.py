"""Sweeps: at each stop of a plan, each arm in turn moves about it with its SMR facing the tracker; the others rest.

Several random motions are sampled. The one is taken that tells most per second of geometry and effects, in addition to
the stops and the sweeps before. It is made narrower until the tracker sees all of it and the gate accepts the whole
path. Motions about successive stops alternate between two speeds. With ``plan.other_arm: swinging`` the other arm of
two moves at the same time, half as fast and without being measured (``PlannedSweep.beside``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter

from cellapp.cell.planning.information import geometry_priors
from cellapp.cell.planning.planned_stops import PlannedStops, last_motions
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, Gate, allowed_apart_m, refuse_motion, refuse_paths, visible
from cellapp.estimation.calibration.parameters import EXPECTED_SCATTER_M, ParameterSet
from cellapp.estimation.discovery.plan_forecast import nominal_model, tracker_covariance
from cellapp.estimation.motion.laws import (
    JointState,
    JointTerm,
    Masses,
    joint_path,
    state_at_rest,
    state_in_motion,
    torques_in_motion,
)
from cellapp.estimation.motion.search_state import foreseen_terms, motion_information
from cellapp.estimation.motion.streams import JointStream
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import Record
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.paths.joint_path import Sweep

# -- The information in a sweep of an arm about its geometry and effects, in addition to that of the stops ------------


_INDEPENDENT_S = 0.5
"""Interval [s] of points in a motion that tell as much as one stop each: sweeps of the twin gave about two a second."""
_SAMPLE_S = 0.04
_UNKNOWN = 1.0
"""Upper limit of prior standard deviations, as of a base: practically unknown [m, rad]."""
_DELAY_SD_S = 1.0
"""Prior standard deviation of the delay between the clocks: practically unknown."""


@dataclass(frozen=True, eq=False)
class SweepDesign:
    """An arm before anything moves, and the quantities that its sweeps are to determine: parameters of the geometry and
    ``terms``, each in units of its prior standard deviation ``unit``; and the information matrix (P, P) so far."""

    profile: Profile
    model: ArmModel
    masses: Masses
    estimated: ParameterSet
    terms: tuple[JointTerm, ...]
    unit: Array
    information: Array

    @classmethod
    def of(cls, profile: Profile, name: str, stops: Array, direction: Array) -> SweepDesign:
        """Set up for the geometry and those effects of ``plan.effects`` that recordings can show.

        The information is that of the priors and the stops (n, N) [rad], which the joints reached in ``direction`` (n,
        N).

        Raise ``InputError`` if the profile does not describe the cell, or its parameter set is not for this arm.
        """
        model, wanted = nominal_model(profile, name), profile.plan.effects
        estimated, sds = geometry_priors(profile, name, model)
        foreseen = foreseen_terms(model.geometry.joints)
        terms = tuple(term for term in foreseen if wanted is None or term.law.value in wanted)
        unit = np.array([*sds, *(term.prior_sd for term in terms), _DELAY_SD_S])
        masses = Masses(model.geometry, model.bodies, model.up_M)
        unmoved = cls(profile, model, masses, estimated, terms, np.minimum(unit, _UNKNOWN), np.eye(len(unit)))
        at_stops = unmoved._told_by(state_at_rest(stops, direction, masses))
        return replace(unmoved, information=unmoved.information + at_stops)

    def told(self, motion: Sweep) -> Array:
        """Compute the information matrix (P, P) of one sweep, from points that tell as much as one stop each."""
        time_s = motion.times(_SAMPLE_S)
        path = joint_path(JointStream(time_s=time_s, q=motion.at(time_s), qd=motion.at(time_s, 1)))
        # without the ends: accelerations need neighbours
        chosen = np.arange(_INDEPENDENT_S, motion.period_s - _INDEPENDENT_S / 2.0, _INDEPENDENT_S)
        state = state_in_motion(path, chosen, None)
        # torques at these few times only: a fit would need them at hundreds of times as many
        torque = torques_in_motion(path, chosen, self.masses)
        return self._told_by(JointState(state.q, state.qd, state.direction, torque))

    def _told_by(self, state: JointState) -> Array:
        covariance = tracker_covariance(self.profile.tracker, smr_positions(self.model.geometry, state.q))
        covariance = covariance + EXPECTED_SCATTER_M**2 * np.eye(3)
        information = motion_information(self.model.geometry, self.estimated, self.terms, state, covariance)
        return np.asarray(information * self.unit * self.unit[:, None])


SWEEPS_RESULT = "planned_sweeps"
"""Name of the document; it is part of the file format."""
_HARMONICS = 4
_PERIODS_S = (16.0, 32.0)
"""Shortest periods of motions about successive stops [s]: both directions of each joint at two speeds."""
_REACH_RAD = (0.15, 0.9)
"""Range of the amplitudes of single joints."""
_SAMPLES = 16
_NARROWER = 0.75
_NARROWEST = 0.08
"""Amplitude [rad] of the joint that moves most below which a motion is given up."""
_SPEED_SHARE, _ACCELERATION_SHARE = 0.5, 0.5
"""Largest speed and acceleration, as shares of the joints' limits."""
_JERK_S = 0.1
"""Shortest time [s] in which the acceleration may build up to its limit."""
_FASTEST_M_S = 0.25
"""Largest speed of the SMR: the limit where a person can reach into the cell, and slow enough for any tracker."""
_SEEN_S, _GATE_S = 0.1, 0.05
"""Sampling interval of a motion for the tracker's sight, and for the gate [s]."""
_SWING_SHARE = 0.5
"""Share of that speed for an arm that swings meanwhile: the margin between two arms grows with their speed."""
_SWING_SAMPLES = 4


class Swing(Record):
    """Coefficients of ``Sweep`` of one arm, by harmonic [rad]."""

    arm: str
    period_s: float
    sine: tuple[tuple[float, ...], ...]
    cosine: tuple[tuple[float, ...], ...]

    def motion(self, center: Array) -> Sweep:
        """Return the motion about ``center`` (N,) [rad]."""
        return Sweep(center, np.array(self.sine), np.array(self.cosine), self.period_s)

    @classmethod
    def of(cls, arm: str, motion: Sweep) -> Swing:
        """Return the coefficients of a motion."""
        sine, cosine = (tuple(map(tuple, table.tolist())) for table in (motion.sine, motion.cosine))
        return cls(arm=arm, period_s=motion.period_s, sine=sine, cosine=cosine)


class PlannedSweep(Swing):
    """A motion of one arm about a stop, and that of the arm that swings beside it, if one does."""

    stop: int
    beside: Swing | None = None

    @property
    def name(self) -> str:
        """Name of its recording."""
        return f"sweep-{self.stop + 1}"

    def motions(self, at: Mapping[str, Array]) -> dict[str, Sweep]:
        """Return the motions of all arms that move about a stop ``at`` (arm -> (N,) [rad]), the measured one first."""
        moving = (self, *([] if self.beside is None else [self.beside]))
        return {one.arm: one.motion(at[one.arm]) for one in moving}


class PlannedSweeps(Record):
    """All sweeps of a run, and sentences on what could not be planned."""

    sweeps: tuple[PlannedSweep, ...]
    notes: tuple[str, ...] = ()


def read_sweeps(run: RunFile) -> tuple[PlannedSweep, ...]:
    """Read the planned sweeps of a run, empty if there are none. Raise ``InputError`` if their document is damaged."""
    return read_planned_sweeps(run).sweeps


def read_planned_sweeps(run: RunFile) -> PlannedSweeps:
    """Read the planned sweeps of a run with their notes, as ``read_sweeps`` does; unknown keys are ignored."""
    none = PlannedSweeps(sweeps=())
    return run.read_checked(SWEEPS_RESULT, TypeAdapter(PlannedSweeps), none, "restore the run from a copy")


def plan_sweeps(profile: Profile, stops: PlannedStops, job: JobToken = UNATTENDED) -> PlannedSweeps:
    """Plan a sweep of each arm at each stop where the gate and the tracker allow one.

    Raises
    ------
    InputError
        If no arm can sweep anywhere.
    Cancelled
    """
    cell, found = cell_bodies(profile), list[PlannedSweep]()
    swinging = profile.plan.other_arm == "swinging"
    if swinging and len(profile.arms) != 2:
        raise InputError(f"plan.other_arm: swinging is for cells of two arms, this one has {len(profile.arms)}")
    step = last_motions(stops, home_positions(profile))
    designs = {name: SweepDesign.of(profile, name, q, np.sign(step[name])) for name, q in stops.q.items()}
    refused: list[str] = []
    for stop in range(len(stops)):
        job.tell("sweeps", stop, len(stops), f"sweeps about stop {stop + 1}")
        at = stops.targets(stop)
        for number, (name, q) in enumerate(stops.q.items()):
            job.check()
            rng = np.random.default_rng([profile.seed, 0x5EEB, stop, number])
            towards = q[rng.integers(len(q), size=_SAMPLES)]
            motion = _sweep_about(cell, name, at, towards, _PERIODS_S[stop % len(_PERIODS_S)], designs[name], rng)
            if motion is None:
                refused.append(f"arm {name}: no sweep about stop {stop + 1} keeps clear and seen")
                continue
            told = designs[name].information + designs[name].told(motion)
            designs[name] = replace(designs[name], information=told)
            beside = _swing_beside(profile, cell, name, motion, at, rng) if swinging else None
            if swinging and beside is None:
                refused.append(
                    f"arm {name}: the other arm rests beside its sweep about stop {stop + 1}: no swing is clear"
                )
            own = Swing.of(name, motion).model_dump()
            found.append(PlannedSweep(**own, stop=stop, beside=beside))
    if not found:
        raise InputError("plan: no sweep keeps clear of the cell and seen by the tracker at any stop")
    return PlannedSweeps(sweeps=tuple(found), notes=tuple(refused))


def refuse_sweep(
    cell: CellBodies, motions: Mapping[str, Sweep], at: Mapping[str, Array], gate: Gate = refuse_motion
) -> str:
    """Return why arms must not make ``motions`` of one period at the same time while the others rest ``at`` (arm ->
    (N,) [rad]); empty if they may. The gate checks every sample."""
    time_s = next(iter(motions.values())).times(_GATE_S)
    paths = {name: motion.at(time_s) for name, motion in motions.items()}
    for name, q in paths.items():
        low, high = cell.arms[name].limits.T
        if not ((q >= low) & (q <= high)).all():
            return f"arm {name}: a joint would leave its limits"
    others = {name: q for name, q in at.items() if name not in paths}
    apart_m = allowed_apart_m(cell, paths, float(time_s[1]))
    row, refusal = refuse_paths(cell, paths, others, gate, apart_m)
    return f"at {time_s[row]:.1f} s: {refusal}" if refusal else ""


def _swing_beside(
    profile: Profile, cell: CellBodies, name: str, motion: Sweep, at: Mapping[str, Array], rng: np.random.Generator
) -> Swing | None:
    """Sample a motion of the other arm that lasts as long as ``motion`` of arm ``name`` and does not hide this from the
    tracker; None if the gate accepts none."""
    (other,) = (one for one in at if one != name)
    time_s = motion.times(_SEEN_S)
    for _ in range(_SWING_SAMPLES):
        for swing in _narrowing(_sampled(at[other], at[other], motion.period_s, rng)):
            in_time = _slow_enough(profile, cell, other, swing, _SWING_SHARE * _FASTEST_M_S).period_s
            if (
                in_time <= motion.period_s * (1.0 + 1e-9)
                and visible(cell, name, motion.at(time_s), {other: swing.at(time_s)}).all()
                and not refuse_sweep(cell, {name: motion, other: swing}, at)
            ):
                return Swing.of(other, swing)
    return None


def _sweep_about(
    cell: CellBodies,
    name: str,
    at: Mapping[str, Array],
    towards: Array,
    period_s: float,
    design: SweepDesign,
    rng: np.random.Generator,
) -> Sweep | None:
    """Find the motion about a stop, ``towards`` others (m, N) [rad], that tells most per second in addition to what is
    known; None if none is allowed."""
    others = {other: q for other, q in at.items() if other != name}
    sampled = [_seen(cell, name, _sampled(at[name], posture, period_s, rng), others) for posture in towards]
    seen = [_slow_enough(design.profile, cell, name, one) for one in sampled if one is not None]
    before = float(np.linalg.slogdet(design.information)[1])
    told = [float(np.linalg.slogdet(design.information + design.told(one))[1]) for one in seen]
    worth = [(its - before) / one.period_s for its, one in zip(told, seen, strict=True)]
    for place in np.argsort(worth)[::-1]:
        for motion in _narrowing(seen[place]):
            if not refuse_sweep(cell, {name: motion}, others):
                return motion
    return None


def _sampled(center: Array, towards: Array, period_s: float, rng: np.random.Generator) -> Sweep:
    """Sample a random motion with its own amplitude for each joint, part of it ``towards`` another posture."""
    order = np.arange(1, _HARMONICS + 1)[:, None]
    sine, cosine = (rng.normal(size=(_HARMONICS, len(center))) / order for _ in range(2))
    motion = Sweep(center, sine, cosine, period_s)
    reach = np.abs(motion.at(motion.times(period_s / 200.0)) - center).max(axis=0)
    wanted = np.exp(rng.uniform(np.log(_REACH_RAD[0]), np.log(_REACH_RAD[1]), len(center))) / reach
    cosine *= wanted
    cosine[0] += rng.uniform(0.0, 0.5) * (towards - center)
    return Sweep(center, sine * wanted, cosine, period_s)


def _narrowing(motion: Sweep) -> Iterator[Sweep]:
    """Yield a motion, then scaled down step by step until next to nothing is left."""
    reach = np.inf
    while reach > _NARROWEST:
        yield motion
        motion = motion.scaled(_NARROWER)
        reach = np.abs(motion.at(motion.times(motion.period_s / 100.0)) - motion.center).max()


def _seen(cell: CellBodies, name: str, motion: Sweep, others: Mapping[str, Array]) -> Sweep | None:
    """Scale a motion down until the tracker sees all of it; None if it does not even at its narrowest."""
    for found in _narrowing(motion):
        time_s = found.times(_SEEN_S)
        beside = {other: np.broadcast_to(q, (len(time_s), len(q))) for other, q in others.items()}
        if visible(cell, name, found.at(time_s), beside).all():
            return found
    return None


def _slow_enough(
    profile: Profile, cell: CellBodies, name: str, motion: Sweep, fastest_m_s: float = _FASTEST_M_S
) -> Sweep:
    """Slow a motion down to the limits of the joints and of the SMR's speed."""
    arm = profile.arms[name]
    speed = _SPEED_SHARE * arm.speed_scale * np.array([joint.speed for joint in arm.type.joints])
    acceleration = _ACCELERATION_SHARE * arm.speed_scale * np.array([joint.acceleration for joint in arm.type.joints])
    slower = motion.slowed(speed, acceleration, acceleration / _JERK_S)
    time_s = slower.times(slower.period_s / 400.0)
    way = np.diff(smr_positions(cell.arms[name].geometry, slower.at(time_s)), axis=0)
    fastest = float(np.linalg.norm(way, axis=1).max()) / (time_s[1] - time_s[0])
    return replace(slower, period_s=slower.period_s * max(1.0, fastest / fastest_m_s))
