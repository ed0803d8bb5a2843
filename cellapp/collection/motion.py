"""Motion and measurement in an open cell: the gate checks every motion, and a fault of one arm stops all arms."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.collection.cell import Cell
from cellapp.errors import CellappError, HardwareError
from cellapp.profile import Profile
from cellapp.progress import CancelToken
from cellapp.safety.cell_bodies import home_positions
from cellapp.safety.gate import CellBodies, predicted_smr, refuse_motion
from drivers.arms.protocol import ArmError, ArmState, ArmTimeout
from drivers.trackers.protocol import Point, TargetLost, TrackerError, Unstable, WrongTarget

Vector = NDArray[np.float64]

_MOVE_ALLOWANCE_S = 10.0
"""Start and settling of a motion, added to twice its ideal duration: a lowered speed slider makes it longer."""
_ROUND_S = 1.0
"""Longest wait for one arm before the others are checked again: a fault of any arm stops all of them."""
_WRONG_TARGET_M = 0.05
"""Nominal geometry and base poses predict an SMR better than this; SMRs of two arms are farther apart."""
_AT_TARGET_RAD = 1e-3
"""Well above the repeatability of a joint, well below any planned step."""
_STILL_RAD = 1e-9
"""Smaller commanded steps are rounding: the joint does not move."""
_MEASURING_TRIES = 2
"""A beam that somebody crossed is usually free at the second try."""


class MotionRefused(CellappError):
    """The gate refused a motion; nothing has moved."""

    exit_code = 3


class Mover:
    """Moves the arms of one open cell, records the last motion of each joint, and measures.

    Every motion starts from the joint positions that the controllers report.
    """

    def __init__(self, profile: Profile, cell: Cell, bodies: CellBodies) -> None:
        self._profile, self._cell, self._bodies = profile, cell, bodies
        self._approach = {name: np.zeros(len(arm.type.joints), dtype=np.int8) for name, arm in profile.arms.items()}
        self._step: dict[str, Vector] = {}
        self._rest_since_s: dict[str, float] = {}

    def positions(self) -> dict[str, Vector]:
        """Return the joint positions (N,) of all arms [rad]. Raises ``HardwareError`` if one is not ready or moves."""
        positions = {}
        for name in self._cell.arms:
            state = self._state(name)
            if not state.ready or state.moving:
                raise HardwareError(
                    f"arm {name}: not ready: {state.reason or 'it is moving'}; look at the arm, release it there,"
                    " then continue with --resume"
                )
            positions[name] = state.q
        return positions

    def refusal(self, *legs: Mapping[str, Vector]) -> str:
        """Return why the arms must not move to the targets of each leg in turn; empty if they may."""
        start = self.positions()
        for targets in legs:
            end = {**start, **targets}
            refusal = refuse_motion(self._bodies, start, end)
            if refusal:
                return refusal
            start = end
        return ""

    def move(self, targets: Mapping[str, Vector]) -> dict[str, ArmState]:
        """Move to ``targets`` (name -> (N,) [rad]), all arms at once, and wait until they are at rest.

        Raises
        ------
        MotionRefused
            If the gate refuses; nothing has moved.
        HardwareError
            If an arm refuses, faults or does not arrive; a stop has been sent to all arms.
        """
        start = self.positions()
        refusal = refuse_motion(self._bodies, start, {**start, **targets})
        if refusal:
            raise MotionRefused(f"refused to move: {refusal}")
        try:
            timeout_s = 0.0
            for name, q in targets.items():
                speed, acceleration = self._rates(name)
                way = np.abs(q - start[name])
                timeout_s = max(timeout_s, float((way / speed + speed / acceleration).max()) * 2.0 + _MOVE_ALLOWANCE_S)
                self._cell.arms[name].start_move(q, speed, acceleration)
            states = self._settled(list(targets), timeout_s)
        except ArmError as error:
            self.stop()
            raise HardwareError(f"{error}; a stop was sent to all arms") from error
        except BaseException:
            self.stop()
            raise
        for name, q in targets.items():
            self._record_step(name, start[name], q, states[name].q)
        return states

    def _record_step(self, name: str, start: Vector, commanded: Vector, reached: Vector) -> None:
        """Record the last motion of each joint. Raises ``HardwareError`` if the arm did not reach its target."""
        step = commanded - start
        moved = np.abs(step) > _STILL_RAD
        self._approach[name] = np.where(moved, np.sign(step), self._approach[name]).astype(np.int8)
        self._step[name] = np.where(moved, reached - start, 0.0)
        miss = float(np.abs(reached - commanded).max())
        if miss > _AT_TARGET_RAD:
            raise HardwareError(f"arm {name}: it came to rest {np.degrees(miss):.3f} deg from its target")

    def go_home(self) -> None:
        """Move the arms home one at a time, in an order that the gate accepts.

        Raises as ``move`` does; ``MotionRefused`` if none of the remaining arms can move home.
        """
        homes = home_positions(self._profile)
        waiting = list(homes)
        while waiting:
            name = next((name for name in waiting if not self.refusal({name: homes[name]})), waiting[0])
            self.move({name: homes[name]})
            waiting.remove(name)

    def _settled(self, names: Sequence[str], timeout_s: float) -> dict[str, ArmState]:
        """Wait for the arms in turn, until each of them was at rest in the same round."""
        late = ""
        for name in names:
            self._rest_since_s.pop(name, None)
        for _ in range(math.ceil(timeout_s / _ROUND_S)):
            states = {}
            for name in names:
                try:
                    states[name] = self._cell.arms[name].wait_settled(_ROUND_S)
                except ArmTimeout:
                    late = name
                    continue
                since_s = states[name].rest_since_s
                self._rest_since_s.setdefault(name, self._cell.clock.now_s() if since_s is None else since_s)
            if len(states) == len(names):
                return states
        raise ArmTimeout(f"arm {late}: did not come to rest within {timeout_s:.0f} s")

    def approach(self, name: str) -> NDArray[np.int8]:
        """Return the sign of each joint's last motion (N,); 0 if it has not moved yet."""
        return self._approach[name]

    def step(self, name: str) -> Vector | None:
        """Return each joint's last motion (N,) with its sign [rad]; None if the arm has not moved yet."""
        return self._step.get(name)

    def rested_s(self, name: str) -> float | None:
        """Return how long an arm has been at rest [s]; None if it has not moved yet.

        If its controller does not report when it came to rest, this counts from when it was seen to have settled.
        """
        since_s = self._rest_since_s.get(name)
        return None if since_s is None else self._cell.clock.now_s() - since_s

    def rest(self, name: str, dwell_s: float, cancel: CancelToken) -> None:
        """Wait until an arm has been at rest for ``dwell_s`` [s]. Raises ``Cancelled`` as soon as ``cancel`` is set."""
        left_s = dwell_s - (self.rested_s(name) or 0.0)
        if left_s > 0.0:
            self._cell.clock.wait(left_s, cancel.wait)
        cancel.check()

    def measure(self, name: str, q: Vector) -> Point:
        """Measure the SMR of an arm at rest at ``q`` (N,) [rad]; tries twice.

        Raises
        ------
        TargetLost, WrongTarget, Unstable
            If both tries failed.
        HardwareError
            If the tracker itself fails.
        """
        expected = predicted_smr(self._bodies, name, q[None])[0]
        problem: TrackerError = TargetLost("not tried")
        for _ in range(_MEASURING_TRIES):
            try:
                point = self._cell.tracker.measure(expected, self._profile.tracker.averaging)
            except (TargetLost, WrongTarget, Unstable) as error:
                problem = error
                continue
            except TrackerError as error:
                raise HardwareError(f"{error}") from error
            off = float(np.linalg.norm(point.p_M - expected))
            if off <= _WRONG_TARGET_M:
                return point
            problem = WrongTarget(
                f"arm {name}: the tracker locked an SMR {off * 1e3:.0f} mm from where this one should be"
            )
        raise problem

    def stop(self) -> None:
        """Send a stop to every arm, whatever the others answer."""
        for arm in self._cell.arms.values():
            with contextlib.suppress(ArmError):
                arm.stop()

    def _state(self, name: str) -> ArmState:
        try:
            return self._cell.arms[name].state()
        except ArmError as error:
            raise HardwareError(f"{error}") from error

    def _rates(self, name: str) -> tuple[Vector, Vector]:
        arm = self._profile.arms[name]
        speed = np.array([joint.speed for joint in arm.type.joints]) * arm.speed_scale
        return speed, np.array([joint.acceleration for joint in arm.type.joints]) * arm.speed_scale
