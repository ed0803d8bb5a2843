"""Motion and measurement in an open cell: the gate checks every motion; a fault of one arm stops all arms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.cell import Cell, answers_of_all
from cellapp.cell.driving.reaction import CellStopped, StopCause, StopReaction, cause_of
from cellapp.cell.run.measurement_order import MOVED_RAD
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import (
    LOOK_S,
    MOST_APART_M,
    CellBodies,
    allowed_apart_m,
    apart_m,
    equally_long,
    on_rows,
    predicted_smr,
    refuse_paths,
)
from cellapp.estimation.readings import Readings, coordinate_uncertainty
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Detail, LogReport, MotionBegun, MotionEnded, PointMeasured, SweepLive
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.model.nominal import joint_rates
from drivers.arms.path_checks import driven
from drivers.arms.protocol import ArmError, ArmState, ArmTimeout, MotionStopped, PathFollower
from drivers.arms.recording import JointRecord, SettlingArm, recording
from drivers.trackers.protocol import Halted, NotReady, Point, TargetLost, TrackerError, Unstable, WrongTarget


def sweep_sentence(live: SweepLive) -> str:
    """Return the progress of a sweep as a sentence: "stop 3: sweep of left 62%, 10 of 16 s"."""
    return f"stop {live.stop + 1}: sweep of {live.arm} {', '.join(live.words())}"


def vectors(q: Mapping[str, NDArray[np.float64]]) -> dict[str, tuple[float, ...]]:
    """Convert joint positions of arms, name -> (N,) [rad], into tuples."""
    return {name: tuple(one.tolist()) for name, one in q.items()}


def motion_ended(stop: int | None, states: Mapping[str, ArmState]) -> MotionEnded:
    """Return the report of a motion's end from the states of the arms at rest."""
    warm = {name: one.joint_temperature_c for name, one in states.items() if one.joint_temperature_c is not None}
    return MotionEnded(stop, vectors({name: one.q for name, one in states.items()}), vectors(warm))


def point_measured(stop: int, arm: str, reading: Readings) -> PointMeasured:
    """Return the detail of one reading."""
    x, y, z = reading.p_M[0].tolist()
    warm, air_c, sigma_m = reading.joint_temperature_c, reading.temperature_c, coordinate_uncertainty(reading)
    return PointMeasured(
        stop=stop,
        arm=arm,
        q=tuple(reading.q[0].tolist()),
        p_M=(x, y, z),
        sigma_mm=None if sigma_m is None else 1e3 * math.sqrt(3.0) * float(sigma_m[0]),
        temperature_c=None if air_c is None else float(air_c[0]),
        joint_temperature_c=None if warm is None else tuple(warm[0].tolist()),
    )


Vector = NDArray[np.float64]
Targets = Mapping[str, Vector]
"""Arm -> joint positions (N,) [rad]."""
Way = Sequence[Targets]
"""Consecutive motions, each with the targets of the arms that move."""
T = TypeVar("T")

_MOVE_ALLOWANCE_S = 10.0
"""Time for start and settling of a motion [s], added to twice its ideal duration to get the timeout."""
_ROUND_S = 1.0
"""Longest wait for one arm [s] before its speed slider is read again: a lowered slider makes a motion longer."""
_LOOK_S = 0.5
"""Replaces ``_ROUND_S`` [s] while an arm follows a path: those who look on hear how far it is."""
_LEAST_FRACTION = 0.01
"""Lower fractions of the speed slider count as 0: the motion would take a hundred times as long."""
_STANDSTILL_S = 60.0
"""Longest wait [s] for an arm whose speed slider is at 0."""
WRONG_TARGET_M = 0.05
"""Tolerance of predictions [m]: nominal geometry predicts an SMR better; SMRs of two arms are farther apart."""
_AT_TARGET_RAD = 1e-3
"""Tolerance for having arrived [rad]: well above a joint's repeatability, well below any planned step."""
_MEASURING_TRIES = 2
"""Tries of a measurement: if somebody crossed the beam, it is usually free at the second try."""
_POLL_S = 0.1
"""Polling period of a paused job [s]; a stop does not wait for it, it brakes in the person's thread."""
_TIMES_MOVED = 3
"""Consecutive measurements during which an arm moves that are a fault of the arm."""


Confirm = Callable[[Mapping[str, Vector], Mapping[str, Vector]], bool]
"""Callback: shows a person the start and the end of the first motion, name -> (N,) [rad]; returns whether to move."""


def motion_s(way: Vector, speeds: Vector, accelerations: Vector) -> float:
    """Return the longest duration [s] of a motion by ``way`` (N,) [rad] with trapezoidal speed profiles."""
    return float((np.abs(way) / speeds + speeds / accelerations).max())


def _last_signs(q: Vector, before: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the sign of each joint's last motion (N,) along ``q`` (m, N) [rad]; ``before`` if a joint hardly moved."""
    away = q[-1] - q
    moved = np.abs(away) > MOVED_RAD
    last = len(q) - 1 - np.argmax(moved[::-1], axis=0)
    signs = np.sign(away[last, np.arange(q.shape[1])])
    return np.where(moved.any(axis=0), signs, before).astype(np.int8)


@dataclass(frozen=True, kw_only=True)
class PointAtRest(Point):
    """A point with the joints of its arm while it was measured.

    Attributes
    ----------
    q : array, shape (N,)
        Mean joint positions during the averaging [rad]; empty for a nest.
    q_spread : float
        Largest range of a joint from before the request of the measurement until after its result [rad].
    """

    q: Vector
    q_spread: float

    @classmethod
    def of(cls, point: Point, joints: JointRecord | None, now_s: float) -> Self:
        """Add the joints of the arm, recorded until ``now_s`` on the cell's clock [s]; None for a nest."""
        if joints is None:
            return cls(**vars(point), q=np.empty(0), q_spread=0.0)
        time_s = joints.time_s - joints.time_s[-1] + now_s
        rows = joints.q[np.abs(time_s - point.time_s) <= 0.5 * point.averaging_s]
        rows = rows if len(rows) else joints.q
        mean = rows[0] + (rows - rows[0]).mean(axis=0)  # exact if all are equal
        return cls(**vars(point), q=mean, q_spread=float(np.ptp(joints.q, axis=0).max()))


def reading_of(point: PointAtRest, conditions: MeasurementConditions, **more: Any) -> Readings:
    """Return the reading of a point under the conditions of its arm, one row; ``more`` are further columns."""
    columns = {
        name: getattr(point, name) for name in ("q", "q_spread", "p_M", "covariance_M", "quaternion_M", "sigma_rad")
    }
    for name, rows in vars(conditions).items():
        if isinstance(rows, np.ndarray):
            columns["joint_temperature_c" if name == "joints_c" else name] = rows[0]
    return Readings.one(**(columns | more))


class MotionRefused(CellappError):
    """A motion, or a command corrected by measuring, was refused; nothing has moved."""

    exit_code = 3


class Mover:
    """Moves the arms of one open cell for a job, records the last motion of each joint, and measures.

    Every motion starts from the joint positions that the controllers report. Any fault triggers ``reaction``; nothing
    moves while that is latched. ``emit`` is called at the beginning and at the end of every motion.
    """

    def __init__(
        self, profile: Profile, cell: Cell, bodies: CellBodies, reaction: StopReaction, control: JobControl
    ) -> None:
        self.profile, self.cell, self.bodies, self.reaction, self.control = profile, cell, bodies, reaction, control
        self.homes: Targets = home_positions(profile)
        self.emit: Callable[[Detail], None] = lambda detail: None
        self.approach = {name: np.zeros(len(arm.type.joints), dtype=np.int8) for name, arm in profile.arms.items()}
        """Arm -> sign of each joint's last motion (N,); 0 if the joint has not moved yet."""
        self._step: dict[str, Vector] = {}
        """Arm -> each joint's last motion (N,) [rad], signed; without arms that have not moved yet."""
        self._rest_since_s: dict[str, float] = {}
        self._rested_at: dict[str, Vector] = {}
        self.departure: Targets | None = None
        """Joint positions where the last motion began: from an interrupted motion the gate has checked the straight way
        back to them; from a path it has not."""
        self.full_speed = self.speed = 1.0
        """Fractions of the profile's speed: for motions that need not be slow, and for the next motions."""
        self.began_s = cell.clock.now_s()
        """When the first motion was confirmed, on the cell's clock [s]."""
        self.stop: int | None = None
        """Stop to which the next motions lead; None for other motions."""

    def slow_start(self, visited: int | None = None) -> None:
        """Set the slow speed of real arms if fewer stops are ``visited`` than the profile asks for; None: always."""
        slow = self.profile.collection.slow_start
        slowly = self.profile.moves_hardware and (visited is None or visited < slow.stops)
        self.speed = min(slow.speed, self.full_speed) if slowly else self.full_speed

    def positions(self) -> dict[str, Vector]:
        """Return the joint positions (N,) of all arms [rad]. Raise ``CellStopped`` if one is not ready or moves."""
        positions = {}
        for name in self.cell.arms:
            state = self._state(name)
            if not state.ready or state.moving:
                raise self.stop_cell(
                    StopCause(
                        "fault",
                        f"arm {name}: not ready: {state.reason or 'it is moving'}; look at the arm, release it there,"
                        " then continue with --resume",
                        name,
                    )
                )
            positions[name] = state.q
        return positions

    def other_q(self, name: str) -> Vector | None:
        """Return the joint positions (1, K) [rad] of the other arm than ``name`` in a cell of two; None in other cells.

        Raise as ``positions``.
        """
        others = [other for other in self.cell.arms if other != name]
        return self.positions()[others[0]][None] if len(others) == 1 else None

    def rests_at(self, targets: Mapping[str, Vector]) -> bool:
        """Return whether all arms of ``targets`` (name -> (N,) [rad]) are there. Raise as ``positions``."""
        q = self.positions()
        return all(bool(np.abs(q[name] - target).max() <= _AT_TARGET_RAD) for name, target in targets.items())

    def refusal(self, *legs: Mapping[str, Vector]) -> str:
        """Return why the gate refuses the legs (each with targets) one after the other; empty if it accepts them."""
        start = self.positions()
        for targets in legs:
            end = {**start, **targets}
            refusal = self.cell.gate(self.bodies, start, end)
            if refusal:
                return refusal
            start = end
        return ""

    def confirm_first(self, targets: Mapping[str, Vector], confirm: Confirm | None) -> None:
        """Let a person confirm the first motion: to ``targets``, or home if the gate refuses those.

        Raise ``InputError`` if the person does not allow it; nothing has moved.
        """
        if confirm is not None:
            start = self.positions()
            first = {**start, **(self.homes if self.refusal(targets) else targets)}
            if not confirm(start, first):
                raise InputError("the first motion was not confirmed; nothing was moved")
        self.began_s = self.cell.clock.now_s()

    def hold(self) -> None:
        """Wait, with the arms at rest, while a person pauses. Raise ``CellStopped``, ``Stopped`` or ``Aborted``."""
        self.check()
        while self.control.request in ("pause", "stop"):
            self.attend()
            self.check()

    def check(self) -> None:
        """Raise ``CellStopped`` if the cell was stopped, ``Stopped`` or ``Aborted`` if the job has to end."""
        self.reaction.check()  # first, so that the cause of a halt is recorded
        self.control.check()

    def attend(self) -> None:
        """Wait one polling period for a person, in real time; the clock of a simulated cell advances too."""
        self.cell.pulse.beat()
        self.control.wait_while("pause", "stop", timeout_s=_POLL_S)
        self.cell.clock.wait(_POLL_S, lambda duration_s: None)

    def wait(self, duration_s: float) -> None:
        """Let time pass with the arms at rest. Raise as ``check``, as soon as the cell is stopped."""
        with self.cell.pulse.waiting():
            self.cell.clock.wait(duration_s, self.control.wait)
        self.check()

    def move(self, targets: Mapping[str, Vector]) -> dict[str, ArmState]:
        """Move to ``targets`` (name -> (N,) [rad]), all arms at once, and wait until they are at rest.

        Raises
        ------
        MotionRefused
            If the gate refuses; nothing has moved.
        CellStopped
            If an arm refuses, faults or does not arrive, or a person stopped the cell; all arms brake.
        """
        start = self.positions()
        refusal = self.cell.gate(self.bodies, start, {**start, **targets})
        if refusal:
            raise MotionRefused(f"refused to move: {refusal}")
        allowed = {name: joint_rates(self.profile.arms[name], self.speed) for name in targets}
        expected_s = max(motion_s(q - start[name], *allowed[name]) for name, q in targets.items())
        with self._moving(start, targets, expected_s):
            for name, q in targets.items():
                self.reaction.check()
                try:
                    self.cell.arms[name].start_move(q, *allowed[name])
                except ArmError as error:
                    raise self.stop_cell(cause_of(name, error)) from error
            states = self._settled(list(targets), 2.0 * expected_s + _MOVE_ALLOWANCE_S)
        for name, q in targets.items():
            self._record_step(name, start[name], q, states[name].q)
        self.emit(motion_ended(self.stop, states))
        return states

    @contextmanager
    def _moving(self, start: Targets, ends: Targets, expected_s: float) -> Iterator[None]:
        """Let arms move in this context, from ``start`` to ``ends``: every link has answered, the tracker is watched.

        The gate must have accepted the motion. Raise ``CellStopped`` if a link does not respond, also one of an arm
        that stays at rest: no motion begins while there is a fault.
        """
        self._record_foreign_steps(start)
        self.departure = dict(start)
        begins = {name: start[name] for name in ends}
        self.emit(MotionBegun(self.stop, vectors(begins), vectors(ends), expected_s))  # listeners may be slow
        with self.cell.watch_tracker(self._tracker_died):
            self.ask_all({name: arm.confirm for name, arm in self.cell.arms.items()})
            self.reaction.check()  # the tracker watch has queried the tracker
            yield

    def along(self, ways: Iterable[Way], back: Sequence[Way] = ((),)) -> dict[str, ArmState]:
        """Move along the first way that the gate accepts, followed by one of ``back``, which is only checked.

        Raise as ``move``; ``MotionRefused`` says what is wrong with the first way. Once an arm has moved, no other way
        is tried: commands are computed for where the arms were.
        """
        first: MotionRefused | None = None
        for way, after in product(ways, back):
            states: dict[str, ArmState] = {}
            try:
                legs = (*way, *after)
                if len(legs) > 1 and (refusal := self.refusal(*legs)):  # ``move`` checks a single one
                    raise MotionRefused(f"refused to move: {refusal}")
                for leg in way:
                    states |= self.move(leg)
                return states
            except MotionRefused as error:
                if states:
                    raise
                first = first or error
        assert first is not None
        raise first

    def follow(
        self, paths: Mapping[str, tuple[Vector, float]], look: Callable[[], None] = lambda: None
    ) -> dict[str, float]:
        """Let arms at the beginning of their paths follow them simultaneously while the others rest; wait until all are
        at rest.

        ``paths`` maps arm -> positions (m, N) [rad] and their period [s]. Return the row at which its ``end_path``
        ended each early, with a fraction; else inf. If several arms are no longer where the gate expected them relative
        to each other, that is a fault, which stops all. ``look`` is called at the start and then each half second, or
        more often.

        Raises
        ------
        MotionRefused
            If the gate refuses, or an arm cannot follow streamed positions; nothing has moved.
        CellStopped
            As ``move``.
        """
        start = self.positions()
        period_s = min(its for _, its in paths.values())
        in_time = equally_long({name: on_rows(q, its, period_s) for name, (q, its) in paths.items()})
        rows = {name: np.concatenate([start[name][None], q]) for name, q in in_time.items()}
        others = {other: here for other, here in start.items() if other not in paths}
        allowed_m = allowed_apart_m(self.bodies, in_time, period_s)
        row, refusal = refuse_paths(self.bodies, rows, others, self.cell.gate, allowed_m)
        if refusal:
            raise MotionRefused(f"refused to follow a path: at {row * period_s:.1f} s: {refusal}")
        if len(paths) == 1:
            return self._followed(start, paths, look, _LOOK_S)

        def look_at_all() -> None:
            off_m = apart_m(self.bodies, in_time, {name: self._state(name).q for name in paths})
            if off_m > MOST_APART_M:
                text = f"arms {' and '.join(paths)}: they are {off_m * 1e3:.0f} mm apart from where both should be"
                raise self.stop_cell(StopCause("gate", f"{text}; one of them was late: find out why, then continue"))
            look()

        return self._followed(start, paths, look_at_all, LOOK_S)

    def _followed(
        self, start: Targets, paths: Mapping[str, tuple[Vector, float]], look: Callable[[], None], round_s: float
    ) -> dict[str, float]:
        """Let arms follow paths from ``start`` that the gate has accepted; wait until they are at rest."""
        arms = {name: arm for name in paths if isinstance(arm := self.cell.arms[name], PathFollower)}
        for name in paths:
            if name not in arms:
                raise MotionRefused(f"arm {name}: its driver cannot follow a stream of joint positions")
        expected_s = max(len(q) * period_s for q, period_s in paths.values())
        with self._moving(start, {name: q[-1] for name, (q, _) in paths.items()}, expected_s):
            self.ask_all({name: partial(arms[name].start_path, *path) for name, path in paths.items()})
            states = self._settled(list(paths), expected_s + _MOVE_ALLOWANCE_S, look, round_s)
        reached = {name: arm.reached() for name, arm in arms.items()}
        for name, (q, _) in paths.items():
            part = driven(q, reached[name])
            self._record_step(name, start[name], part[-1], states[name].q)
            self.approach[name] = _last_signs(part, self.approach[name])
        self.emit(motion_ended(self.stop, states))
        return reached

    def ask_all(self, calls: Mapping[str, Callable[[], T]]) -> dict[str, T]:
        """Call a function for each arm, all at once, and return the answers. Raise ``CellStopped`` if one fails."""
        answers, errors = answers_of_all(self.cell.together, calls)
        for name, error in errors.items():
            raise self.stop_cell(cause_of(name, error)) from error
        return answers

    def refused_by_controllers(self, q: Targets) -> dict[str, NDArray[np.bool_]]:
        """Return which joint positions, name -> (n, N) [rad], each controller forbids, (n,). Raise ``CellStopped``."""
        arms = self.cell.arms
        return self.ask_all({name: partial(arms[name].refused_by_controller, own) for name, own in q.items()})

    def _tracker_died(self, reason: str) -> None:
        self.reaction.trigger(StopCause("tracker", reason))

    def _record_foreign_steps(self, start: Mapping[str, Vector]) -> None:
        """Record motions since the last completed one of this object: interrupted ones, or of an arm moved by hand."""
        for name, q in start.items():
            self._record_signs(name, q - self._rested_at.get(name, q))

    def _record_signs(self, name: str, step: Vector) -> NDArray[np.bool_]:
        """Record the signs of a motion (N,) [rad]; return which joints moved."""
        moved = np.abs(step) > MOVED_RAD
        self.approach[name] = np.where(moved, np.sign(step), self.approach[name]).astype(np.int8)
        return moved

    def _record_step(self, name: str, start: Vector, commanded: Vector, reached: Vector) -> None:
        """Record the last motion of each joint. Raise ``CellStopped`` if the arm did not reach its target."""
        moved = self._record_signs(name, commanded - start)
        if moved.any() or name not in self._step:  # an arm that was already there keeps its last motion
            self._step[name] = np.where(moved, reached - start, 0.0)
        self._rested_at[name] = reached
        miss = float(np.abs(reached - commanded).max())
        if miss > _AT_TARGET_RAD:
            text = f"arm {name}: it came to rest {np.degrees(miss):.3f} deg from its target"
            raise self.stop_cell(StopCause("gate", text, name))

    def go_home(self, names: Sequence[str] | None = None) -> None:
        """Move the arms (all, or ``names``) home one at a time, in an order that the gate accepts.

        Raise as ``move``; ``MotionRefused`` if none of the remaining arms can move home.
        """
        waiting = list(self.homes if names is None else names)
        while waiting:
            name = next((name for name in waiting if not self.refusal({name: self.homes[name]})), waiting[0])
            self.move({name: self.homes[name]})
            waiting.remove(name)

    def go_home_unless_clear(self, name: str, q: Vector) -> None:
        """Move an arm home, unless the gate accepts the straight way to ``q`` (N,) [rad] and from there home.

        This prevents stranding the arm. Raise as ``move``.
        """
        home = {name: self.homes[name]}
        if self.refusal({name: q}, home):
            self.move(home)

    def _settled(
        self, names: Sequence[str], timeout_s: float, look: Callable[[], None] = lambda: None, round_s: float = _ROUND_S
    ) -> dict[str, ArmState]:
        """Wait in rounds until all arms are at rest in the same round; return their states.

        Each round calls ``look`` and waits at most ``round_s`` [s] for each arm. A fault of any arm brakes all of
        them, which ends every wait at once.
        """
        for name in names:
            self._rest_since_s.pop(name, None)
        remaining_s, standing_s, late = timeout_s, 0.0, ""
        while remaining_s > 0.0 and standing_s < _STANDSTILL_S:
            states, fraction = {}, 1.0
            look()
            for name in names:
                try:
                    with self.cell.pulse.waiting(self.cell.oldest_data_s):
                        states[name] = self.cell.arms[name].wait_settled(round_s)
                except ArmTimeout:
                    slider = self._state(name).speed_fraction  # None: its controller does not report it
                    late, fraction = name, fraction if slider is None else min(fraction, slider)
                    continue
                except ArmError as error:
                    raise self.stop_cell(cause_of(name, error)) from error
                since_s = states[name].rest_since_s
                self._rest_since_s.setdefault(name, self.cell.clock.now_s() if since_s is None else since_s)
            if len(states) == len(names):
                self.reaction.check()
                return states
            self.reaction.check()
            if fraction < _LEAST_FRACTION:
                standing_s += round_s
            else:
                remaining_s -= round_s * fraction
        text = f"arm {late}: did not come to rest within {timeout_s:.0f} s"
        if standing_s >= _STANDSTILL_S:
            text = f"arm {late}: its speed slider is at 0 %, so that it does not move; raise it on the pendant"
        raise self.stop_cell(StopCause("fault", text, late))

    def rested_s(self, name: str) -> float | None:
        """Return how long an arm has been at rest [s]; None if it has not moved yet.

        If its controller does not report when it came to rest, count from when it was seen to have settled.
        """
        since_s = self._rest_since_s.get(name)
        return None if since_s is None else self.cell.clock.now_s() - since_s

    def conditions(self, name: str, state: ArmState, later_s: float) -> MeasurementConditions:
        """Return the known conditions of an arm at rest, one row, ``later_s`` [s] from now."""
        step, rested_s = self._step.get(name), self.rested_s(name)
        return MeasurementConditions(
            approach=self.approach[name][None].astype(np.float64),
            step=None if step is None else step[None],
            dwell_s=None if rested_s is None else np.array([max(rested_s + later_s, 0.0)]),
            payload_kg=None if state.payload_kg is None else np.array([state.payload_kg]),
            joints_c=None if state.joint_temperature_c is None else state.joint_temperature_c[None],
        )

    def rest(self, name: str, dwell_s: float) -> None:
        """Wait until an arm has been at rest for ``dwell_s`` [s]. Raise as ``wait``."""
        self.wait(max(dwell_s - (self.rested_s(name) or 0.0), 0.0))

    def measure(self, name: str, q: Vector) -> PointAtRest:
        """Measure the SMR of an arm that came to rest at ``q`` (N,) [rad]; try twice.

        Raises
        ------
        TargetLost, WrongTarget, Unstable
            If both tries failed.
        NotReady
            If the tracker is not ready to measure.
        CellStopped
            If the tracker itself fails, the arm moves at each of three tries, or the cell was stopped in the meantime.
        """
        return self.measure_at(predicted_smr(self.bodies, name, q[None])[0], f"arm {name}", at=(name, q))

    def measure_at(
        self,
        expected_M: Vector,
        what: str,
        within_m: float | None = None,
        tries: int = _MEASURING_TRIES,
        at: tuple[str, Vector] | None = None,
    ) -> PointAtRest:
        """Measure the SMR of ``what``, expected at ``expected_M`` (3,) [m]; reject points beyond ``within_m`` [m].

        ``within_m`` is ``WRONG_TARGET_M`` if None. ``at`` is its arm and where that came to rest (N,) [rad]; None for a
        nest. A point is also rejected if a joint left the arm's settling window about that, from before the request
        until after the result. Raise as ``measure``.
        """
        within_m, times_moved = WRONG_TARGET_M if within_m is None else within_m, 0
        while True:
            self.reaction.check()
            found, joints = self._tried(expected_M, what, within_m, None if at is None else at[0])
            self.reaction.check()  # the arms may have moved while they braked
            if at is not None and joints is not None and (moved := self._moved(*at, joints)):
                times_moved += 1
                if times_moved == _TIMES_MOVED:
                    text = f"{moved}, {times_moved} times in a row; find out what moves it, then continue"
                    raise self.stop_cell(StopCause("fault", text, at[0]))
                self._log(f"{moved}: rejected, measured again ({times_moved} of {_TIMES_MOVED - 1})")
            elif isinstance(found, Point):
                return PointAtRest.of(found, joints, self.cell.clock.now_s())
            elif tries <= 1:
                raise found
            else:
                tries -= 1

    def _moved(self, name: str, q: Vector, joints: JointRecord) -> str:
        """Return how far an arm that rested at ``q`` (N,) [rad] moved, in words; empty within its settling window."""
        arm, off = self.cell.arms[name], np.abs(joints.q - q).max(axis=0)
        window = arm.settle_window if isinstance(arm, SettlingArm) else MOVED_RAD
        if off.max() <= window:
            return ""
        joint, most, allowed = int(np.argmax(off)) + 1, np.degrees(off.max()), np.degrees(window)
        return (
            f"arm {name}: joint {joint} was {most:.3f} deg from its rest while it was measured, {allowed:.3f} allowed"
        )

    def _tried(
        self, expected_M: Vector, what: str, within_m: float, name: str | None
    ) -> tuple[Point | TrackerError, JointRecord | None]:
        """Measure once; return the point, or why there is none, and the joints of arm ``name`` meanwhile."""
        if name is None:
            return self._point(expected_M, what, within_m), None
        try:
            end = recording(self.cell.arms[name])
            try:
                found = self._point(expected_M, what, within_m)
            finally:
                joints = end()
        except ArmError as error:
            raise self.stop_cell(cause_of(name, error)) from error
        return found, joints

    def _point(self, expected_M: Vector, what: str, within_m: float) -> Point | TrackerError:
        try:
            with self.cell.pulse.waiting(self.cell.tracker.data_age_s):
                point = self.cell.tracker.measure(expected_M, self.profile.tracker.averaging)
        except (TargetLost, WrongTarget, Unstable) as error:
            return error
        except NotReady:
            raise
        except TrackerError as error:
            if isinstance(error, Halted):
                self.reaction.check()
            raise self.stop_cell(StopCause("tracker", str(error))) from error
        off = float(np.linalg.norm(point.p_M - expected_M))
        if off <= within_m:
            return point
        return WrongTarget(f"{what}: the tracker locked an SMR {off * 1e3:.0f} mm from where this one should be")

    def _log(self, text: str) -> None:
        self.emit(LogReport("warning", text))
        for log in self.cell.logs:
            log("warning", text)

    def stop_cell(self, cause: StopCause) -> CellStopped:
        """Stop the cell; return the exception for its first cause, which may be an earlier one.

        That an arm was braked is a consequence of a cause, not another cause.
        """
        first = self.reaction.cause
        if first is None or not isinstance(cause.error, MotionStopped):
            self.reaction.trigger(cause)
        return CellStopped(self.reaction.cause or cause)

    def _state(self, name: str) -> ArmState:
        self.cell.pulse.beat()
        try:
            return self.cell.arms[name].state()
        except ArmError as error:
            raise self.stop_cell(cause_of(name, error)) from error
