"""The simulated cell: arms that move, bend and warm up, a tracker that looks at them, one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.plant import effects as hidden
from drivers.plant.clearance import Clearance, segment_distances
from drivers.plant.climate import Air, joint_rise
from drivers.plant.config import ArmConfig, Array, PlantConfig
from drivers.plant.effect import Effect, Situation
from drivers.plant.lines import carry, inverse, rigid
from drivers.plant.mechanism import (
    NO_DEFLECTION,
    STANDARD_GRAVITY,
    Deflection,
    Mechanism,
    Posture,
    combined,
    nominal,
    with_errors,
)
from drivers.plant.motion import Motion, braked, travel
from drivers.plant.optics import covariances, noise, why_hidden

_EQUILIBRIUM_RAD = 1e-12
_EQUILIBRIUM_STEPS = 200
_WATCH_STEP_S = 0.02


@dataclass(frozen=True, eq=False)
class Target:
    """An SMR as the tracker could find it now: of which arm, where (3,) [m] in M, and why not ("" when it can)."""

    arm: str
    p_M: Array
    hidden: str
    moving: bool


@dataclass(eq=False)
class _Arm:
    """One true arm and the state it is in."""

    config: ArmConfig
    mechanism: Mechanism
    T_C_B: Array
    T_M_B: Array
    gravity: Array  # acceleration of free fall in B
    effects: tuple[Effect, ...]
    repeatability: np.random.Generator
    q: Array  # (N,) at the last rest, or where the present motion began
    memories: list[Array | None]  # at that moment
    approach: Array
    last_step: Array
    miss: Array  # (N,) what the present stop misses its goal by
    rise: Array  # (N,) joint temperature above the air
    rest_since_s: float = 0.0
    motion: Motion | None = None
    bent: Deflection = NO_DEFLECTION  # by loads in the last solution, where the next one starts


def _change(before: Deflection, after: Deflection) -> float:
    """The largest difference of two deflections [rad or m]."""
    largest = 0.0
    for name in ("joints", "base", "links", "tool"):
        old, new = getattr(before, name), getattr(after, name)
        if new is not None:
            largest = max(largest, float(np.abs(new if old is None else new - old).max(initial=0.0)))
    return largest


class Plant:
    """A cell with true geometry and hidden effects, drawn and switched on by a configuration.

    Time is simulated: it passes only in ``advance``, which the simulated drivers call. ``watch_clearance`` samples the
    distances of the arms' capsules from each other and from the floor while anything moves, into ``clearance``.

    Raises ``ValueError`` for an effect or parameter that does not exist or makes no sense.
    """

    def __init__(self, config: PlantConfig, *, watch_clearance: bool = False) -> None:
        self.config = config
        self.clearance = Clearance() if watch_clearance else None
        self._clock_s = 0.0
        self._T_M_C = inverse(config.tracker.T_C_M)
        self._air = Air(config.temperature_c, np.random.default_rng([config.seed, 0]))
        self._noise = np.random.default_rng([config.seed, 1])
        # a stream of its own for each arm and purpose: what one draws moves no other
        self._arms = {
            arm.name: self._true_arm(arm, np.random.SeedSequence([config.seed, 2, number]))
            for number, arm in enumerate(config.arms)
        }
        if self.clearance is not None:
            self._watch(np.zeros(1))

    def _true_arm(self, arm: ArmConfig, seed: np.random.SeedSequence) -> _Arm:
        geometry, base, repeatability = (np.random.default_rng(s) for s in seed.spawn(3))
        errors = self.config.errors
        effects = hidden.build(arm.name, arm.joints, arm.effects)
        sizes = np.repeat([errors.base_length, errors.base_angle], 3)
        T_C_B = arm.T_C_B @ rigid(sizes * base.standard_normal(6))
        assert arm.home is not None
        return _Arm(
            config=arm,
            mechanism=with_errors(nominal(arm), errors, geometry),
            T_C_B=T_C_B,
            T_M_B=self._T_M_C @ T_C_B,
            gravity=T_C_B[:3, :3].T @ np.array([0.0, 0.0, -STANDARD_GRAVITY]),
            effects=effects,
            repeatability=repeatability,
            q=arm.home,
            memories=[effect.begin(arm.home[None]) for effect in effects],
            approach=np.zeros(arm.joints),
            last_step=np.zeros(arm.joints),
            miss=self.config.repeatability * repeatability.standard_normal(arm.joints),
            rise=np.zeros(arm.joints),
        )

    def _arm(self, name: str) -> _Arm:
        try:
            return self._arms[name]
        except KeyError:
            raise ValueError(f"the simulated cell has no arm '{name}'; it has {', '.join(self._arms)}") from None

    # -- truth -------------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._arms)

    def true_T_C_B(self, name: str) -> Array:
        """True base pose of an arm in the cell, (4, 4), at rest and undeflected."""
        return self._arm(name).T_C_B.copy()

    def true_T_M_B(self, name: str) -> Array:
        """True base pose of an arm in the tracker frame, (4, 4)."""
        return self._arm(name).T_M_B.copy()

    def true_T_B_B(self, to: str, of: str) -> Array:
        """Takes base coordinates of the arm ``of`` into base coordinates of the arm ``to``, (4, 4)."""
        return inverse(self._arm(to).T_C_B) @ self._arm(of).T_C_B

    def true_smr_offset(self, name: str) -> Array:
        """True SMR centre in the flange frame, (3,) [m]."""
        return self._arm(name).mechanism.smr.copy()

    # -- statics -----------------------------------------------------------------------------------------------------

    def _settle(
        self, arm: _Arm, situation: Situation, memories: Sequence[Array | None], start: Deflection, miss: Array | None
    ) -> tuple[Posture, Deflection]:
        """The posture whose loads cause its own deflection, and that deflection, found by repetition from ``start``."""
        fixed = combined(e.offset(situation, memory) for e, memory in zip(arm.effects, memories, strict=True))
        if miss is not None:
            fixed = combined((fixed, Deflection(joints=miss)))
        bent = start
        for _ in range(_EQUILIBRIUM_STEPS):
            posture = Posture(arm.mechanism, situation.q, arm.gravity, combined((fixed, bent)))
            after = combined(effect.bend(situation, posture) for effect in arm.effects)
            if _change(bent, after) <= _EQUILIBRIUM_RAD:
                return posture, after
            bent = after
        raise ValueError(
            f"arm {arm.config.name}: the hidden effects reach no equilibrium under gravity; their stiffness is too low"
        )

    def _seen(self, arm: _Arm, situation: Situation, posture: Posture) -> tuple[Array, Array]:
        """Where the tracker sees the SMR and the way that looks, (n, 3) each, in M."""
        p_B, normal_B = posture.smr
        p_M, normal_M = carry(arm.T_M_B, p_B), normal_B @ arm.T_M_B[:3, :3].T
        for effect in arm.effects:
            p_M = effect.seen(p_M, normal_M, situation)
        return p_M, normal_M

    def smr_positions(
        self,
        name: str,
        q: Array,
        *,
        approach: Array | None = None,
        others: Mapping[str, Array] | None = None,
        time_s: Array | None = None,
    ) -> Array:
        """SMR centres (n, 3) in M of an arm at rest at ``q`` (n, N), with all effects, without noise or repeatability.

        ``approach`` (n, N) is the sign of each joint's last motion, 0 or None in the middle of any play. ``others``
        gives the joint angles (n, N) of other arms, ``time_s`` (n,) the times; by default they are as they are now.
        """
        arm = self._arm(name)
        q = np.asarray(q, dtype=np.float64)
        n = len(q)
        approach = np.zeros_like(q) if approach is None else np.sign(np.asarray(approach, dtype=np.float64))
        times = np.full(n, self._clock_s) if time_s is None else np.asarray(time_s, dtype=np.float64)
        air = self._air.temperature_c(times)
        given = {} if others is None else others
        situation = Situation(
            q=q,
            approach=approach,
            last_step=np.zeros_like(q),
            since_rest_s=np.full(n, np.inf),
            time_s=times,
            air_c=air,
            joints_c=air[:, None] + arm.rise,
            others={
                other.config.name: Posture(
                    other.mechanism,
                    np.broadcast_to(given.get(other.config.name, self._q(other)), (n, other.config.joints)),
                    other.gravity,
                )
                for other in self._arms.values()
                if other is not arm
            },
        )
        memories = [effect.approached(q, approach) for effect in arm.effects]
        posture, _ = self._settle(arm, situation, memories, NO_DEFLECTION, None)
        return self._seen(arm, situation, posture)[0]

    # -- time and motion ---------------------------------------------------------------------------------------------

    @property
    def clock_s(self) -> float:
        """Time since the simulation began [s]."""
        return self._clock_s

    @property
    def air_temperature_c(self) -> float:
        """Air temperature now [degC]."""
        return float(self._air.temperature_c(np.array([self._clock_s]))[0])

    def joint_temperatures_c(self, name: str) -> Array:
        """Joint temperatures of an arm now, (N,) [degC]."""
        return self.air_temperature_c + self._arm(name).rise

    def _q(self, arm: _Arm) -> Array:
        return arm.q if arm.motion is None else arm.motion.position(np.array([self._clock_s]))[0]

    def q(self, name: str) -> Array:
        """Joint positions that the controller of an arm reports now, (N,) [rad]: those of its drives."""
        return self._q(self._arm(name)).copy()

    def moving(self, name: str) -> bool:
        """Whether a motion of an arm is under way."""
        return self._arm(name).motion is not None

    def rest_s(self, name: str) -> float:
        """When the arm comes, or came, to rest [s]."""
        arm = self._arm(name)
        return arm.rest_since_s if arm.motion is None else arm.motion.end_s

    def payload(self, name: str) -> tuple[float, Array]:
        """Mass [kg] and centre (3,) [m] in the flange frame of what the arm carries."""
        mechanism = self._arm(name).mechanism
        return mechanism.payload_mass, mechanism.payload_center.copy()

    def set_payload(self, name: str, mass: float, center: Array) -> None:
        """Hang a load of ``mass`` [kg] on the flange, its centre at ``center`` (3,) [m] in the flange frame."""
        arm = self._arm(name)
        load = np.array(center, dtype=np.float64)
        arm.mechanism = replace(arm.mechanism, payload_mass=float(mass), payload_center=load)

    def start_move(self, name: str, q: Array, speed: Array, acceleration: Array) -> None:
        """Start a joint motion to ``q`` (N,) now; the arm must be at rest."""
        arm = self._arm(name)
        if arm.motion is not None:
            raise ValueError(f"arm {name} is still moving")
        goal = np.array(q, dtype=np.float64)
        arm.motion = travel(self._clock_s, arm.q, goal, speed, acceleration)
        if arm.motion is not None:
            arm.miss = self.config.repeatability * arm.repeatability.standard_normal(arm.config.joints)

    def stop(self, name: str) -> None:
        """Brake all joints of an arm as hard as they can; harmless at rest."""
        arm = self._arm(name)
        if arm.motion is None:
            return
        shortened = braked(arm.motion, self._clock_s, arm.config.acceleration)
        self._arrive(arm, self._q(arm), self._clock_s)
        arm.motion = shortened

    @staticmethod
    def _arrive(arm: _Arm, q: Array, time_s: float) -> None:
        """Take the motion so far into the arm's history."""
        step = q - arm.q
        arm.memories = [effect.moved(memory, q[None]) for effect, memory in zip(arm.effects, arm.memories, strict=True)]
        arm.approach = np.where(step == 0.0, arm.approach, np.sign(step))
        arm.last_step = step
        arm.q = q
        arm.rest_since_s = time_s
        arm.motion = None

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = self._clock_s + duration_s
        if self.clearance is not None:
            ends = [arm.motion.end_s for arm in self._arms.values() if arm.motion is not None]
            if ends:
                last = min(max(ends), end_s)
                count = int(np.ceil((last - self._clock_s) / _WATCH_STEP_S)) + 1
                self._watch(np.linspace(self._clock_s, last, max(count, 2)))
        for arm in self._arms.values():
            resting_s = duration_s
            if arm.motion is not None:
                turning_s = min(arm.motion.end_s, end_s) - self._clock_s
                mean = np.abs(arm.motion.q_to - arm.motion.q_from) / arm.motion.duration_s
                arm.rise = joint_rise(arm.rise, mean, turning_s)
                resting_s -= turning_s
                if arm.motion.end_s <= end_s:
                    self._arrive(arm, arm.motion.q_to, arm.motion.end_s)
            arm.rise = joint_rise(arm.rise, np.zeros_like(arm.rise), resting_s)
        self._clock_s = end_s

    # -- tracker -----------------------------------------------------------------------------------------------------

    def _live(self, arm: _Arm) -> tuple[Array, Array]:
        """Where the tracker sees an arm's SMR now and the way that looks, (3,) each, in M."""
        q = self._q(arm)[None]
        moving = arm.motion is not None
        memories, step, approach = arm.memories, arm.last_step, arm.approach
        if moving:
            step = q[0] - arm.q
            approach = np.where(step == 0.0, approach, np.sign(step))
            memories = [effect.moved(memory, q) for effect, memory in zip(arm.effects, memories, strict=True)]
        situation = Situation(
            q=q,
            approach=approach[None],
            last_step=step[None],
            since_rest_s=np.array([0.0 if moving else self._clock_s - arm.rest_since_s]),
            time_s=np.array([self._clock_s]),
            air_c=np.array([self.air_temperature_c]),
            joints_c=(self.air_temperature_c + arm.rise)[None],
            others={
                other.config.name: Posture(other.mechanism, self._q(other)[None], other.gravity)
                for other in self._arms.values()
                if other is not arm
            },
        )
        posture, arm.bent = self._settle(arm, situation, memories, arm.bent, arm.miss[None])
        p_M, normal_M = self._seen(arm, situation, posture)
        return p_M[0], normal_M[0]

    def targets(self) -> list[Target]:
        """The SMRs of all arms as the tracker could find them now."""
        found = []
        for name, arm in self._arms.items():
            p_M, normal_M = self._live(arm)
            why = why_hidden(self.config.tracker, p_M, normal_M, arm.config.smr_acceptance)
            found.append(Target(name, p_M, why, arm.motion is not None))
        return found

    def measure_positions(
        self, p_M: Array, rng: np.random.Generator | None = None, *, averaging_s: float | None = None
    ) -> tuple[Array, Array]:
        """What the tracker reads (n, 3) of SMRs at ``p_M`` (n, 3) [m], and its covariance (n, 3, 3) [m^2].

        ``rng`` draws the noise, by default the cell's own; there is none where the configuration switches it off.
        """
        averaging_s = self.config.tracker.averaging_s if averaging_s is None else averaging_s
        p_M = np.asarray(p_M, dtype=np.float64)
        read = p_M.copy()
        if self.config.noise:
            read += noise(self.config.tracker, p_M, averaging_s, self._noise if rng is None else rng)
        return read, covariances(self.config.tracker, p_M, averaging_s)

    # -- witness -----------------------------------------------------------------------------------------------------

    def _watch(self, times_s: Array) -> None:
        """Look at all capsules at some times of the motions under way."""
        seen = self.clearance
        assert seen is not None
        bodies = []
        for arm in self._arms.values():
            q = np.broadcast_to(arm.q, (len(times_s), arm.config.joints))
            if arm.motion is not None:
                q = arm.motion.position(times_s)
            ends = [carry(arm.T_C_B, end) for end in Posture(arm.mechanism, q, arm.gravity).segments()]
            radii = arm.mechanism.capsules.radii
            bodies.append((ends[0], ends[1], radii))
            # what is bolted to the base cannot be kept off the floor
            free = arm.mechanism.capsules.frames > 0
            heights = np.minimum(ends[0], ends[1])[free, :, 2] - radii[free, None] - self.config.floor
            seen.floor_m, seen.floor_time_s = _smaller(seen.floor_m, seen.floor_time_s, heights, times_s)
        for i, (a, b, r) in enumerate(bodies):
            for c, d, s in bodies[i + 1 :]:
                gaps = segment_distances(a[:, None], b[:, None], c[None], d[None]) - (r[:, None] + s)[..., None]
                seen.arms_m, seen.arms_time_s = _smaller(seen.arms_m, seen.arms_time_s, gaps, times_s)


def _smaller(best: float, when: float, distances: Array, times_s: Array) -> tuple[float, float]:
    """The smallest of ``distances`` (..., n) and its time, if smaller than ``best``."""
    each = distances.reshape(-1, len(times_s)).min(axis=0, initial=np.inf)
    k = int(np.argmin(each))
    return (float(each[k]), float(times_s[k])) if each[k] < best else (best, when)
