"""Recording of a sweep of one arm: joints that lag behind their commands, gears with memory, two clocks.

The controller's joints follow the commands as in ``servo``, each as a critically damped second-order system. Its
encoders sit before the gears. Behind the gears every effect of the plant acts along the path. An effect with hysteresis
sees a motion from each reversal of a joint to the next; drive lag and vibration depend on the whole motion. Controller
and tracker have separate clocks for their timestamps. The controller loses samples if its client is slow; the tracker
sometimes loses the beam.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import lagging
from drivers.plant.mechanism import NO_DEFLECTION, inertia_torques
from drivers.plant.motion import Phase
from drivers.plant.plant import Plant, joint_rise
from drivers.plant.servo import GAIN, LOOKAHEAD_S, servo_rate
from drivers.plant.true_arm import TrueArm

_STEP_S = 1e-3
"""Time step of the joints' motion [s]."""
_BEND_S = 5e-3
"""Time step of the differences that give accelerations [s]."""
_REST_S = 0.5
"""Recorded rest before and after the motion [s]."""
_AT_ONCE = 4096
"""Points per batch of the equilibrium."""
DYNAMIC_M = 5e-6
"""Standard deviation that following a moving SMR adds to the distance [m]: half of the AT960's +-10 um for a dynamic
lock. Other errors of a single point equal those of an averaged one, as the maximum permissible error holds for both."""


@dataclass(frozen=True)
class Recorder:
    """Recording properties of the devices.

    Attributes
    ----------
    joint_hz, point_hz : float
        Rates of the controller and of the tracker [1/s].
    lost_samples : float
        Share of the controller's samples that its client does not receive.
    jitter_s : float
        Standard deviation of the instant at which joints are sampled, about its timestamp [s].
    lost_beams_per_min : float
        Breaks of the beam; each lasts up to ``longest_loss_s`` [s].
    offset_s, rate_ppm : float
        The tracker's clock against the controller's.
    seed : int
    """

    joint_hz: float = 125.0
    point_hz: float = 250.0
    lost_samples: float = 1e-3
    jitter_s: float = 20e-6
    lost_beams_per_min: float = 0.5
    longest_loss_s: float = 1.0
    offset_s: float = 0.0
    rate_ppm: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SweepRecord:
    """Data recorded by both devices.

    Attributes
    ----------
    joint_time_s, q, qd : arrays, shapes (n,), (n, N), (n, N)
        Timestamps of the controller, joint positions [rad] and speeds [rad/s] before the gears.
    point_time_s, p_M, sigma_m : arrays, shapes (m,), (m, 3), (m,)
        Timestamps of the tracker, points [m], their standard uncertainty by the specification [m]; points are NaN where
        the beam was lost.
    beside_q : mapping
        Joint positions (n, K) [rad] of each other arm that moved, at ``joint_time_s``.
    """

    joint_time_s: Array
    q: Array
    qd: Array
    point_time_s: Array
    p_M: Array
    sigma_m: Array
    beside_q: Mapping[str, Array] = field(default_factory=dict)


def record_sweep(
    plant: Plant,
    recorder: Recorder,
    name: str,
    commanded: Array,
    cycle_s: float,
    beside: Mapping[str, Array] = MappingProxyType({}),
) -> SweepRecord:
    """Make an arm at rest follow ``commanded`` (n, N) [rad], one position every ``cycle_s`` [s], and record it.

    The plant's time passes. Arms ``beside`` (n, K) follow their own positions meanwhile, the others rest. Raises
    ``ValueError`` if an arm moves, or is not at the first position.
    """
    if any(plant.moving(other) for other in plant.names):
        raise ValueError("a sweep is recorded while no other motion is under way")
    moving, paths = dict[TrueArm, Array](), {name: commanded, **beside}
    for one, rows in paths.items():
        if np.abs(plant.q(one) - rows[0]).max() > 1e-3:
            raise ValueError(f"arm {one} is not where its sweep begins")
    rng = np.random.default_rng([recorder.seed, round(1e3 * plant.clock_s)])
    for one, rows in paths.items():
        its = plant._arm(one)
        its.resting = None
        its.stop_error = plant.config.repeatability * its.repeatability.standard_normal(its.config.joints)
        time_s, moving[its] = _joint_motion(its.q, rows, cycle_s)
    arm = plant._arm(name)
    q, others = moving[arm], {its.config.name: path for its, path in moving.items() if its is not arm}
    seen = np.arange(0.0, time_s[-1], 1.0 / recorder.point_hz) + rng.uniform(0.0, 1.0 / recorder.point_hz)
    seen = seen[seen < time_s[-1]]
    began_s = plant.clock_s
    p_M = _points(plant, arm, time_s, q, seen, began_s, {one: _at(seen, time_s, path) for one, path in others.items()})
    p_M, covariance = plant.measure_positions(p_M, rng)
    if plant.config.noise:
        distance = np.linalg.norm(p_M, axis=1, keepdims=True)
        p_M = p_M * (1.0 + DYNAMIC_M * rng.standard_normal(distance.shape) / distance)
    joint_time_s, joints, speeds = _samples(time_s, q, recorder, rng)
    for one, path in others.items():
        for turn in _reversals(path).tolist():
            plant._arm(one).note_reversal(path[turn], path[turn + 1])
    _end(plant, moving, float(time_s[-1]))
    lost = _lost(seen, recorder, rng)
    return SweepRecord(
        joint_time_s=began_s + joint_time_s,
        q=joints,
        qd=speeds,
        point_time_s=recorder.offset_s + (1.0 + 1e-6 * recorder.rate_ppm) * (began_s + seen),
        p_M=np.where(lost[:, None], np.nan, p_M),
        sigma_m=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0),
        beside_q={one: _at(joint_time_s, time_s, path) for one, path in others.items()},
    )


def _at(times: Array, time_s: Array, table: Array) -> Array:
    """Interpolate the columns of a ``table`` (n, N) given at ``time_s`` (n,) at other times (m,)."""
    return np.column_stack([np.interp(times, time_s, column) for column in table.T])


def _joint_motion(start: Array, commanded: Array, cycle_s: float) -> tuple[Array, Array]:
    """Return times (n,) and positions before the gears (n, N) of joints that follow commands, resting at both ends."""
    time_s = np.arange(0.0, len(commanded) * cycle_s + 2.0 * _REST_S, _STEP_S)
    at = np.arange(len(commanded), dtype=np.float64) * cycle_s + _REST_S
    goal = _at(time_s, at, commanded)
    keep = np.full(len(start), np.exp(-servo_rate(LOOKAHEAD_S, GAIN) * _STEP_S))
    # at rest before the start; two equal lags in series are critically damped
    return time_s, lagging(lagging(goal - start, keep), keep) + start


def _samples(time_s: Array, q: Array, recorder: Recorder, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return the timestamps, positions and speeds that the controller's client received."""
    stamps = np.arange(0.0, time_s[-1], 1.0 / recorder.joint_hz)
    stamps = stamps[rng.random(len(stamps)) >= recorder.lost_samples]
    instants = np.clip(stamps + recorder.jitter_s * rng.standard_normal(len(stamps)), 0.0, time_s[-1])
    speed = np.gradient(q, _STEP_S, axis=0)
    return stamps, _at(instants, time_s, q), _at(instants, time_s, speed)


def _lost(seen: Array, recorder: Recorder, rng: np.random.Generator) -> np.ndarray:
    """Sample a mask (m,) of the points at which the beam was lost."""
    lost = np.zeros(len(seen), dtype=bool)
    for _ in range(rng.poisson(recorder.lost_beams_per_min * float(np.ptp(seen)) / 60.0)):
        begin = rng.uniform(seen[0], seen[-1])
        lost |= (seen >= begin) & (seen <= begin + rng.uniform(0.0, recorder.longest_loss_s))
    return lost


def _reversals(q: Array) -> np.ndarray:
    """Return the rows at which a joint reverses; between two of them no joint does."""
    way = np.sign(np.diff(q, axis=0))
    # after a rest, a joint has reversed only if it then moves the other way
    moved = np.maximum.accumulate(np.where(way != 0.0, np.arange(len(way))[:, None], 0), axis=0)
    way = np.take_along_axis(way, moved, axis=0)
    return np.flatnonzero((way[1:] * way[:-1] < 0.0).any(axis=1)) + 1


def _points(
    plant: Plant, arm: TrueArm, time_s: Array, q: Array, seen: Array, began_s: float, others: Mapping[str, Array]
) -> Array:
    """Return the true apparent points (m, 3) at times ``seen`` (m,), segment by segment between reversals of joints;
    ``others`` (m, K) are joint positions of other arms that move."""
    q_seen = _at(seen, time_s, q)
    inertia, added = _of_course(arm, time_s, q, seen)
    reversals = [0, *_reversals(q).tolist(), len(q) - 1]
    points = np.empty((len(seen), 3))
    segment = np.searchsorted(time_s[reversals[1:-1]], seen, side="right")
    for number, end in enumerate(reversals[1:]):
        rows = np.flatnonzero(segment == number)
        phase = arm.phase(began_s)
        for at in range(0, len(rows), _AT_ONCE):
            some = rows[at : at + _AT_ONCE]
            at_s, turn, more = began_s + seen[some], inertia[some], added[some]
            here = {one: its[some] for one, its in others.items()}
            points[some], _ = smr_in(
                plant, arm, phase, q_seen[some], at_s, here, moving=True, inertia=turn, response=more
            )
        arm.note_reversal(q[end], q[min(end + 1, len(q) - 1)])
    return points


def _of_course(arm: TrueArm, time_s: Array, q: Array, seen: Array) -> tuple[Array, Array]:
    """Return torques of inertia [Nm] and joint deviations caused by the course of the motion [rad], each (m, N)."""

    now, responses = _at(seen, time_s, q), [effect.response(time_s, q, arm.mechanism) for effect in arm.effects]
    added = np.sum([np.zeros_like(now), *(_at(seen, time_s, one) for one in responses if one is not None)], axis=0)
    if not arm.effects:
        return added, added
    before, after = (_at(seen + step, time_s, q) for step in (-_BEND_S, _BEND_S))
    return inertia_torques(arm.mechanism, before, now, after, _BEND_S), added


def _end(plant: Plant, moving: Mapping[TrueArm, Array], seconds: float) -> None:
    """Put arms at rest at the end of their paths (n, N), and advance the clock by ``seconds``."""
    warmer = dict[TrueArm, Array]()
    for arm, q in moving.items():
        arm.note_motion(q[-1].copy())
        speed = np.abs(np.diff(q, axis=0)).mean(axis=0) / _STEP_S
        warmer[arm] = joint_rise(arm.rise, speed, seconds, plant.config.holding_k)
    plant.advance(seconds)
    for arm, rise in warmer.items():
        arm.rise, arm.rest_since_s = rise, plant.clock_s - _REST_S


def recorder_of(plant: Plant) -> Recorder:
    """Return the devices of a simulated cell, with clocks that differ by its seed."""
    rng = np.random.default_rng([plant.config.seed, 4])
    return Recorder(
        offset_s=float(rng.uniform(-500.0, 500.0)), rate_ppm=float(rng.normal(0.0, 20.0)), seed=plant.config.seed
    )


# -- Recent positions of the SMR of a moving arm, for a tracker that sends packets of points --------------------------


_BACK_S = 0.024
"""Step of the differences that give accelerations. The future is not known, so accelerations are delayed by this much.
It is a multiple of all controllers' cycles, whose ripple is thus excluded."""


def recent_smr(plant: Plant, name: str, time_s: Array) -> tuple[Array, Array]:
    """Return apparent positions and viewing directions of an arm's SMR, (n, 3) each, in M, at recent times (n,) [s].

    The arm may have moved since; history older than about a second is not available.
    """
    arm = plant._arm(name)
    q, known = arm.joints_at(time_s, plant._clock_s)
    inertia = np.zeros_like(q)
    if arm.effects and any(phase.motion is not None for phase, _ in known):
        earlier, first = (arm.joints_at(time_s - n * _BACK_S, plant._clock_s)[0] for n in (1, 2))
        inertia = inertia_torques(arm.mechanism, first, earlier, q, _BACK_S)
    p_M, normal_M = np.empty((2, len(time_s), 3))
    moved = {other: plant._arm(other).joints_at(time_s, plant._clock_s)[0] for other in plant.names if other != name}
    for phase, rows in known:
        moving, others = phase.motion is not None, {other: its[rows] for other, its in moved.items()}
        p_M[rows], normal_M[rows] = smr_in(
            plant, arm, phase, q[rows], time_s[rows], others, moving=moving, inertia=inertia[rows]
        )
    return p_M, normal_M


def smr_in(
    plant: Plant,
    arm: TrueArm,
    phase: Phase,
    q: Array,
    time_s: Array,
    others: Mapping[str, Array],
    *,
    moving: bool,
    inertia: Array | None = None,
    response: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Return apparent positions and viewing directions (n, 3) of an arm's SMR at ``q`` (n, N) in a phase without
    reversal, with other arms at ``others`` (n, N). ``inertia`` (n, N) are torques of its acceleration [Nm];
    ``response`` (n, N) is the joint deviation caused by the course of the motion [rad]."""
    situation, memories = plant._in_phase(arm, phase, q, time_s, others, moving=moving)
    situation = replace(situation, inertia=inertia)
    posture, _ = plant._equilibrium(arm, situation, memories, NO_DEFLECTION, arm.stop_error[None] + response)
    return plant._apparent_smr(arm, situation, posture)
