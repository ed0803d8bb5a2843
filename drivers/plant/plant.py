"""The simulated cell: arms that move, deflect and warm up, a tracker that measures them, one clock."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import TypedDict, Unpack

import numpy as np

from drivers.plant.clearance import Clearance
from drivers.plant.config import Array, PlantConfig, broadcast
from drivers.plant.effect import Situation
from drivers.plant.mechanism import NO_DEFLECTION, Deflection, Load, Mechanism, Posture, combined
from drivers.plant.motion import Phase, braked, travel
from drivers.plant.optics import covariances, noise, why_hidden
from drivers.plant.servo import follow
from drivers.plant.transforms import inverse, transform_points
from drivers.plant.true_arm import Seen, TrueArm, TrueTarget, largest_change, sample_true_arm, watch

_EQUILIBRIUM_RAD = 1e-12
_MAX_ITERATIONS = 200
_SAMPLE_S = 0.02


class Plant:
    """A cell with true geometry and hidden effects according to a configuration and its seed.

    Time is simulated: it passes only in ``advance``, which the simulated drivers call. Actions in ``schedule`` happen
    during this at their time. ``watch_clearance`` records in ``clearance`` the smallest distances of the arms' capsules
    from each other and from the floor during motions.

    Raises ``ValueError`` for an unknown effect, or an unknown or invalid parameter.
    """

    def __init__(self, config: PlantConfig, *, watch_clearance: bool = False) -> None:
        self.config = config
        self.clearance = Clearance() if watch_clearance else None
        self.schedule = Schedule()
        self._clock_s = 0.0
        self._T_M_C = inverse(config.tracker.T_C_M)
        self._air = TrueAir(config.temperature_c, np.random.default_rng([config.seed, 0]))
        self._air_now = (np.nan, np.nan)
        """Cache: a time [s] and the air temperature at that time [degC]."""
        self._noise = config.random(1)
        # one random stream per arm and purpose: samples from one do not change another
        self._arms = {
            arm.name: sample_true_arm(arm, config, self._T_M_C, np.random.SeedSequence([config.seed, 2, number]))
            for number, arm in enumerate(config.arms)
        }
        self._watch(np.zeros(1))

    def _arm(self, name: str) -> TrueArm:
        try:
            return self._arms[name]
        except KeyError:
            raise ValueError(f"the simulated cell has no arm '{name}'; it has {', '.join(self._arms)}") from None

    # -- truth -------------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._arms)

    def true_mechanism(self, name: str) -> Mechanism:
        """Return the true mechanism of an arm, undeflected."""
        return self._arm(name).mechanism

    def change_mechanism(self, name: str, change: Callable[[Mechanism], Mechanism]) -> None:
        """Change the true mechanism of an arm."""
        arm = self._arm(name)
        arm.mechanism, arm.resting = change(arm.mechanism), None

    def true_T_M_B(self, name: str) -> Array:
        """Return the true base pose of an arm in the tracker frame, (4, 4)."""
        return self._arm(name).T_M_B.copy()

    def _T_B_others(self, arm: TrueArm) -> dict[str, Array]:
        back = inverse(arm.T_C_B)
        return {name: back @ other.T_C_B for name, other in self._arms.items() if other is not arm}

    # -- statics -----------------------------------------------------------------------------------------------------

    def _equilibrium(
        self,
        arm: TrueArm,
        situation: Situation,
        memories: Sequence[Array | None],
        start: Deflection,
        stop_error: Array | None,
    ) -> tuple[Posture, Deflection]:
        """Find the posture whose loads cause its own deflection by fixed-point iteration; return both."""
        fixed = combined(e.offset(situation, memory) for e, memory in zip(arm.effects, memories, strict=True))
        if stop_error is not None:
            fixed = combined((fixed, Deflection(joints=stop_error)))
        load_deflection = start
        for _ in range(_MAX_ITERATIONS):
            bend = combined((fixed, load_deflection))
            posture = Posture(arm.mechanism, situation.q, arm.gravity, bend, situation.load, situation.inertia)
            after = combined(effect.bend(situation, posture) for effect in arm.effects)
            if largest_change(load_deflection, after) <= _EQUILIBRIUM_RAD:
                return posture, after
            load_deflection = after
        raise ValueError(
            f"arm {arm.config.name}: the hidden effects reach no equilibrium under gravity; their stiffness is too low"
        )

    def _apparent_smr(self, arm: TrueArm, situation: Situation, posture: Posture) -> tuple[Array, Array]:
        """Return the apparent position of the SMR and its viewing direction, (n, 3) each, in M."""
        p_B, normal_B = posture.smr
        p_M, normal_M = transform_points(arm.T_M_B, p_B), normal_B @ arm.T_M_B[:3, :3].T
        for effect in arm.effects:
            p_M = effect.apparent_position(p_M, normal_M, situation)
        return p_M, normal_M

    def _apparent_probe(self, arm: TrueArm, situation: Situation, posture: Posture) -> Array | None:
        """Return the apparent orientation of a 6-D probe in M, (n, 3, 3); None if the arm has none."""
        if arm.mechanism.probe is None:
            return None
        R_M_S = arm.T_M_B[:3, :3] @ posture.flange[:, :3, :3] @ arm.mechanism.probe
        for effect in arm.effects:
            R_M_S = effect.apparent_rotation(R_M_S, situation)
        return R_M_S

    def _other_postures(
        self, arm: TrueArm, given: Mapping[str, Array], n: int, loads: Mapping[str, Array] | None = None
    ) -> dict[str, Posture]:
        """Return the other arms at joint angles ``given`` (n, N) with ``loads`` (n,); by default as they are now."""
        loads = {} if loads is None else loads
        return {
            name: Posture(
                other.mechanism,
                np.broadcast_to(given.get(name, self._q(other)), (n, other.config.joints)),
                other.gravity,
                load=None
                if name not in loads
                else Load(
                    broadcast("other_payloads", loads[name], 0.0, (n,)),
                    np.broadcast_to(other.mechanism.payload_center, (n, 3)),
                ),
            )
            for name, other in self._arms.items()
            if other is not arm
        }

    def smr_positions(self, name: str, q: Array, **conditions: Unpack[Conditions]) -> Array:
        """Return SMR centres (n, 3) in M of an arm at rest at ``q`` (n, N), with all effects, without random errors.

        ``conditions`` are broadcast to their shapes. Raises ``ValueError`` for a wrong shape or a negative load.
        """
        return self._apparent_smr(*self._at_rest(name, q, conditions))[0]

    def probe_rotations(self, name: str, q: Array, **conditions: Unpack[Conditions]) -> Array:
        """Return orientations (n, 3, 3) in M of the 6-D probe of an arm at rest at ``q`` (n, N), without random errors.

        Raises ``ValueError`` for an arm without a probe, and as ``smr_positions``.
        """
        R_M_S = self._apparent_probe(*self._at_rest(name, q, conditions))
        if R_M_S is None:
            raise ValueError(f"arm {name} has no 6-D probe")
        return R_M_S

    def _at_rest(self, name: str, q: Array, given: Conditions) -> tuple[TrueArm, Situation, Posture]:
        """Return an arm at rest at ``q`` (n, N), its situation and its posture in equilibrium."""
        arm = self._arm(name)
        q = np.asarray(q, dtype=np.float64)
        n, joints = len(q), arm.config.joints
        step = broadcast("last_step", given.get("last_step"), np.zeros_like(q), (n, joints))
        times = broadcast("time_s", given.get("time_s"), self._clock_s, (n,))
        air = broadcast("air_c", given.get("air_c"), self._air.temperature_c(times), (n,))
        mass, center = arm.mechanism.payload_mass, arm.mechanism.payload_center
        load = Load(
            broadcast("payload", given.get("payload"), mass, (n,)),
            broadcast("payload_center", given.get("payload_center"), center, (n, 3)),
        )
        if (load.mass < 0.0).any():
            raise ValueError(f"payload must be at least 0 kg, not {load.mass.min():g}")
        situation = Situation(
            q=q,
            approach=np.sign(broadcast("approach", given.get("approach"), step, (n, joints))),
            last_step=step,
            since_rest_s=broadcast("since_rest_s", given.get("since_rest_s"), np.inf, (n,)),
            time_s=times,
            air_c=air,
            joints_c=broadcast("joints_c", given.get("joints_c"), air[:, None] + arm.rise, (n, joints)),
            others=self._other_postures(arm, given.get("others") or {}, n, given.get("other_payloads")),
            T_B_others=self._T_B_others(arm),
            mechanism=arm.mechanism,
            load=load,
        )
        memories = [effect.assumed_memory(situation) for effect in arm.effects]
        posture, _ = self._equilibrium(arm, situation, memories, NO_DEFLECTION, None)
        return arm, situation, posture

    def _in_phase(
        self, arm: TrueArm, phase: Phase, q: Array, time_s: Array, others: Mapping[str, Array], *, moving: bool
    ) -> tuple[Situation, list[Array | None]]:
        """Return the situation of an arm at ``q`` (n, N) at times (n,) [s] of a phase without reversal, and the
        memories of its effects; ``others`` (n, N) are joint positions of other arms, by default the current ones."""
        step = q - phase.q if moving else np.repeat(phase.last_step[None], len(q), axis=0)
        memories = list(phase.memories)
        if moving:
            memories = arm.remembered(memories, q)
        air_c = np.full(len(q), self.air_c)
        situation = Situation(
            q=q,
            approach=np.where(step == 0.0, phase.approach, np.sign(step)) if moving else phase.approach + 0.0 * q,
            last_step=step,
            since_rest_s=np.zeros(len(q)) if moving else time_s - phase.rest_since_s,
            time_s=time_s,
            air_c=air_c,
            joints_c=air_c[:, None] + arm.rise,
            others=self._other_postures(arm, others, len(q)),
            T_B_others=self._T_B_others(arm),
            mechanism=arm.mechanism,
        )
        return situation, memories

    # -- time and motion ---------------------------------------------------------------------------------------------

    @property
    def clock_s(self) -> float:
        """Time since the simulation began [s]."""
        return self._clock_s

    @property
    def air_c(self) -> float:
        """Air temperature now [degC]."""
        time_s, temperature_c = self._air_now
        if time_s != self._clock_s:
            temperature_c = float(self._air.temperature_c(np.array([self._clock_s]))[0])
            self._air_now = self._clock_s, temperature_c
        return temperature_c

    def joints_c(self, name: str) -> Array:
        """Return the current joint temperatures of an arm, (N,) [degC]."""
        return self.air_c + self._arm(name).rise

    def _q(self, arm: TrueArm) -> Array:
        return arm.q if arm.motion is None else arm.motion.position(np.array([self._clock_s]))[0]

    def q(self, name: str) -> Array:
        """Return the joint positions that the controller of an arm reports now, (N,) [rad], measured at the drives."""
        return self._q(self._arm(name)).copy()

    def moving(self, name: str) -> bool:
        """Return whether an arm moves."""
        return self._arm(name).motion is not None

    def speeds(self, name: str) -> Array:
        """Return the current joint speeds of an arm, (N,) [rad/s]."""
        arm = self._arm(name)
        return np.zeros(arm.config.joints) if arm.motion is None else arm.motion.velocity(np.array([self._clock_s]))[0]

    def scale_speed(self, name: str, scale: float) -> None:
        """Continue the running motion of an arm along its path at ``scale`` times its own speed; 0 stops it."""
        arm = self._arm(name)
        if arm.motion is not None:
            arm.motion = arm.motion.scaled(self._clock_s, scale)

    def rest_s(self, name: str) -> float:
        """Return when the arm comes or came to rest [s]."""
        arm = self._arm(name)
        return arm.rest_since_s if arm.motion is None else arm.motion.end_s

    def payload(self, name: str) -> tuple[float, Array]:
        """Return mass [kg] and centre (3,) [m] of the arm's load in the flange frame."""
        mechanism = self._arm(name).mechanism
        return mechanism.payload_mass, mechanism.payload_center.copy()

    def set_payload(self, name: str, mass: float, center: Array) -> None:
        """Set the arm's load: ``mass`` [kg] with its centre at ``center`` (3,) [m] in the flange frame."""
        center = np.array(center, dtype=float)
        self.change_mechanism(name, lambda one: replace(one, payload_mass=float(mass), payload_center=center))

    def start_move(self, name: str, q: Array, speed: Array, acceleration: Array) -> None:
        """Start a joint motion to ``q`` (N,) now; the arm must be at rest."""
        arm = self._arm(name)
        if arm.motion is not None:
            raise ValueError(f"arm {name} is still moving")
        goal = np.array(q, dtype=np.float64)
        arm.note_phase(self._clock_s)
        arm.resting = None
        arm.motion = travel(self._clock_s, arm.q, goal, speed, acceleration)
        if arm.motion is not None:
            arm.stop_error = self.config.repeatability * arm.repeatability.standard_normal(arm.config.joints)

    def stop(self, name: str, deceleration: Array | None = None) -> None:
        """Brake an arm along its path, at most at ``deceleration`` (N,), by default the largest; harmless at rest."""
        arm = self._arm(name)
        if arm.motion is None:
            return
        limit = arm.config.acceleration if deceleration is None else deceleration
        shortened = braked(arm.motion, self._clock_s, limit)
        self._end_motion(arm, self._q(arm), self._clock_s)
        arm.motion = shortened

    def servo(self, name: str, goal: Array, rate: float) -> None:
        """Make an arm follow ``goal`` (N,) [rad] from now on, with the lag ``rate`` [1/s] of ``ServoMotion``.

        Called in each control cycle of a stream. Raises ``ValueError`` during another motion.
        """
        follow(self._arm(name), goal, self._clock_s, rate, self.config.repeatability)

    def _end_motion(self, arm: TrueArm, q: Array, time_s: float) -> None:
        """Update the arm's state and memories after a motion to ``q``."""
        arm.note_phase(time_s)
        arm.note_motion(q)
        arm.rest_since_s = time_s
        arm.motion, arm.streamed = None, None

    def advance(self, duration_s: float) -> None:
        """Advance the clock; actions of ``schedule`` happen at their time, and their exceptions pass through."""
        end_s = self._clock_s + duration_s
        if self.schedule.next_s > end_s:
            self._pass(duration_s)
            return
        while self.schedule.next_s <= end_s:
            self._pass(max(self.schedule.next_s - self._clock_s, 0.0))
            self.schedule.run_next()
        self._pass(max(end_s - self._clock_s, 0.0))

    @property
    def undisturbed_s(self) -> float:
        """Time until the next action of ``schedule`` [s]; infinite if there is none."""
        return max(self.schedule.next_s - self._clock_s, 0.0)

    def _pass(self, duration_s: float) -> None:
        """Advance the clock through a time without scheduled actions: only running motions continue."""
        end_s = self._clock_s + duration_s
        if self.clearance is not None:
            ends = [arm.motion.end_s for arm in self._arms.values() if arm.motion is not None]
            if ends:
                last = min(max(ends), end_s)
                count = int(np.ceil((last - self._clock_s) / _SAMPLE_S)) + 1
                self._watch(np.linspace(self._clock_s, last, max(count, 2)))
        for arm in self._arms.values():
            resting_s, cold = duration_s, arm.rise
            if arm.motion is not None:
                moving_s = min(arm.motion.end_s, end_s) - self._clock_s
                arm.rise = joint_rise(arm.rise, arm.motion.mean_speed, moving_s, self.config.holding_k)
                resting_s -= moving_s
                if arm.motion.end_s <= end_s:
                    self._end_motion(arm, arm.motion.q_to, arm.motion.end_s)
            arm.rise = joint_rise(arm.rise, np.zeros_like(arm.rise), resting_s, self.config.holding_k)
            if arm.effects:
                mean_c = (air_c := self.air_c) + 0.5 * (cold + arm.rise)
                arm.memories = [
                    effect.memory_after_time(memory, air_c, mean_c, duration_s)
                    for effect, memory in zip(arm.effects, arm.memories, strict=True)
                ]
        self._clock_s = end_s

    # -- tracker -----------------------------------------------------------------------------------------------------

    def _current(self, arm: TrueArm) -> Seen:
        """Return the current SMR and probe of an arm, as a tracker could see them."""
        if arm.resting is None:
            seen = self._apparent_now(arm)
            if arm.effects or arm.motion is not None:
                return seen
            arm.resting = seen
        return arm.resting

    def _apparent_now(self, arm: TrueArm) -> Seen:
        phase, now_s = arm.phase(self._clock_s), np.array([self._clock_s])
        situation, memories = self._in_phase(arm, phase, self._q(arm)[None], now_s, {}, moving=arm.motion is not None)
        posture, arm.load_deflection = self._equilibrium(
            arm, situation, memories, arm.load_deflection, arm.stop_error[None]
        )
        (p_M,), (normal_M,) = self._apparent_smr(arm, situation, posture)
        R_M_S = self._apparent_probe(arm, situation, posture)
        return Seen(p_M, normal_M, None if R_M_S is None else R_M_S[0])

    def move_tracker(self, T_C_M: Array) -> None:
        """Move the tracker to another pose (4, 4) in the cell, now."""
        self.config = replace(self.config, tracker=replace(self.config.tracker, T_C_M=T_C_M))
        self._T_M_C = inverse(T_C_M)
        for arm in self._arms.values():
            arm.T_M_B, arm.resting = self._T_M_C @ arm.T_C_B, None

    def targets(self) -> list[TrueTarget]:
        """Return the SMRs of all arms at the current time."""
        found = []
        for name, arm in self._arms.items():
            seen = self._current(arm)
            why = why_hidden(self.config.tracker, seen.p_M, seen.normal_M, arm.config.smr_acceptance)
            found.append(TrueTarget(name, seen.p_M, why, arm.motion is not None, seen.R_M_S, arm.config.probe_sigma))
        return found

    def measure_positions(
        self, p_M: Array, rng: np.random.Generator | None = None, *, averaging_s: float | None = None
    ) -> tuple[Array, Array]:
        """Return measured positions (n, 3) of SMRs at ``p_M`` (n, 3) [m] and their covariances (n, 3, 3) [m^2].

        ``rng`` samples the noise, by default the cell's own stream; the configuration may switch noise off.
        """
        averaging_s = self.config.tracker.averaging_s if averaging_s is None else averaging_s
        p_M = np.asarray(p_M, dtype=np.float64)
        measured = p_M.copy()
        if self.config.noise:
            measured += noise(self.config.tracker, p_M, averaging_s, self._noise if rng is None else rng)
        return measured, covariances(self.config.tracker, p_M, averaging_s)

    # -- collisions --------------------------------------------------------------------------------------------------

    def _watch(self, times_s: Array) -> None:
        """Update ``clearance`` at given times of the current motions."""
        if self.clearance is not None:
            watch(self.clearance, list(self._arms.values()), times_s, self.config.floor)


# -- Actions at given times of a simulation ---------------------------------------------------------------------------


class Schedule:
    """Queue of actions, ordered by their times; at equal times, by the order in which they were added."""

    def __init__(self) -> None:
        self._actions: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()
        self._next_s = math.inf

    @property
    def next_s(self) -> float:
        """Time of the next action [s]; infinite if there is none."""
        return self._next_s

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Add an action. If its time is past, it runs as soon as time advances."""
        heapq.heappush(self._actions, (time_s, next(self._numbers), action))
        self._next_s = self._actions[0][0]

    def run_next(self) -> None:
        """Remove the next action and call it; it may add others."""
        _, _, action = heapq.heappop(self._actions)
        self._next_s = self._actions[0][0] if self._actions else math.inf
        action()


# -- Conditions under which the simulated cell computes an arm at rest at given joint positions -----------------------


class Conditions(TypedDict, total=False):
    """Conditions of an arm at rest. Missing keys and None have the default.

    Attributes
    ----------
    approach : array, shape (n, N)
        Sign of each joint's last motion; 0: in the middle of any play. Default: that of ``last_step``.
    others : mapping
        Joint angles (n, N) of other arms, by name; default: as they are now.
    other_payloads : mapping
        Loads (n,) [kg] of other arms, by name; default: as they are now.
    time_s : array, shape (n,)
        The cell's clock [s]; default: now. Temperatures at different times are one history.
    last_step : array, shape (n, N)
        The last motion of each joint, with its sign [rad]; default: a long one.
    since_rest_s : array, shape (n,)
        Time at rest [s]; default: infinite.
    payload, payload_center : arrays, shapes (n,), (n, 3) or (3,)
        Load [kg] and its centre in the flange frame [m]; default: the current ones.
    joints_c, air_c : arrays, shapes (n, N), (n,)
        Temperatures [degC]; default: the air at ``time_s``, and joints with their current rise above it.
    """

    approach: Array | None
    others: Mapping[str, Array] | None
    other_payloads: Mapping[str, Array] | None
    time_s: Array | None
    last_step: Array | None
    since_rest_s: Array | None
    payload: Array | None
    payload_center: Array | None
    joints_c: Array | None
    air_c: Array | None


# -- Temperatures: slow drift of the air, joints that warm up by motion -----------------------------------------------


_AIR_AMPLITUDE_K = 0.5
_AIR_PERIODS_S = np.array([2.6, 5.3, 11.0]) * 3600.0
_AIR_SHARES = np.array([0.2, 0.3, 0.5])

JOINT_TIME_CONSTANT_S = 2400.0
"""Time constant of a joint's warm-up, which takes about two hours, three time constants (an estimate)."""
JOINT_RISE_K = 20.0
"""Steady-state temperature difference of a joint that rotates at 1 rad/s without pause and one at rest [K]."""


class TrueAir:
    """Air temperature: the configured mean plus three slow sine waves with seeded phases, at most 0.5 K."""

    def __init__(self, mean_c: float, rng: np.random.Generator) -> None:
        self._mean_c = mean_c
        self._phases = rng.uniform(0.0, 2.0 * np.pi, len(_AIR_PERIODS_S))

    def temperature_c(self, time_s: Array) -> Array:
        """Return the temperature (n,) [degC] at times (n,) [s]."""
        waves = np.sin(2.0 * np.pi * time_s[:, None] / _AIR_PERIODS_S + self._phases)
        temperature: Array = self._mean_c + _AIR_AMPLITUDE_K * (waves * _AIR_SHARES).sum(axis=1)
        return temperature


def joint_rise(rise: Array, speed: Array, duration_s: float, holding_k: float = 0.0) -> Array:
    """Return the rise above the air (N,) [K] after rotating at the mean ``speed`` (N,) [rad/s]: a first-order lag.

    ``holding_k`` is the steady-state rise of a joint at rest, from electronics, brake and holding current.
    """
    end = holding_k + JOINT_RISE_K * speed
    after: Array = end + (rise - end) * np.exp(-duration_s / JOINT_TIME_CONSTANT_S)
    return after
