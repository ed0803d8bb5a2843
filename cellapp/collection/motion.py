"""Moving the arms of an open cell: nothing moves without the gate, and all stop when one does."""

from __future__ import annotations

import contextlib
import math
import time
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
_ROUND_S = 1.0
"""How long one arm is waited for before the others are looked at again: a fault of any stops all of them."""
_WRONG_TARGET_M = 0.05
_AT_TARGET_RAD = 1e-3
_MEASURING_TRIES = 2


class MotionRefused(CellappError):
    """The gate refused a motion; nothing has moved."""

    exit_code = 3


class Mover:
    """Moves the arms of one open cell, remembers where each joint came from, and measures.

    It always starts from where the arms really are, as their controllers say.
    """

    def __init__(self, profile: Profile, cell: Cell, bodies: CellBodies) -> None:
        self._profile, self._cell, self._bodies = profile, cell, bodies
        self._approach = {name: np.zeros(len(arm.type.joints), dtype=np.int8) for name, arm in profile.arms.items()}
        self._step: dict[str, Vector] = {}
        self._rests_since: dict[str, float] = {}

    def positions(self) -> dict[str, Vector]:
        """Where the arms are now. Raises ``HardwareError`` if one is not ready or moves."""
        positions = {}
        for name in self._cell.arms:
            state = self._state(name)
            if not state.ready or state.moving:
                raise HardwareError(
                    f"arm {name}: not ready: {state.reason or 'it is moving'}; look at the arm, release it there,"
                    " then go on with --resume"
                )
            positions[name] = state.q
        return positions

    def refusal(self, *legs: Mapping[str, Vector]) -> str:
        """Why the arms must not go from where they are to the targets of each leg in turn; empty if they may."""
        here = self.positions()
        for targets in legs:
            there = {**here, **targets}
            refusal = refuse_motion(self._bodies, here, there)
            if refusal:
                return refusal
            here = there
        return ""

    def move(self, targets: Mapping[str, Vector]) -> dict[str, ArmState]:
        """Move to ``targets`` (name -> (N,) [rad]), arms together, and wait until all rest there.

        Raises
        ------
        MotionRefused
            If the gate refuses; nothing has moved.
        HardwareError
            If an arm refuses, faults or does not arrive; all arms have been told to stop.
        """
        here = self.positions()
        refusal = refuse_motion(self._bodies, here, {**here, **targets})
        if refusal:
            raise MotionRefused(f"refused to move: {refusal}")
        try:
            timeout = 0.0
            for name, q in targets.items():
                speed, acceleration = self._rates(name)
                way = np.abs(q - here[name])
                timeout = max(timeout, float((way / speed + speed / acceleration).max()) * 2.0 + _MOVE_ALLOWANCE_S)
                self._cell.arms[name].start_move(q, speed, acceleration)
            states = self._settled(list(targets), timeout)
        except ArmError as error:
            self.stop()
            raise HardwareError(f"{error}; all arms were told to stop") from error
        except BaseException:
            self.stop()
            raise
        for name, q in targets.items():
            moved = q - here[name]
            turned = np.abs(moved) > 1e-9
            self._approach[name] = np.where(turned, np.sign(moved), self._approach[name]).astype(np.int8)
            self._step[name] = np.where(turned, states[name].q - here[name], 0.0)
            away = float(np.abs(states[name].q - q).max())
            if away > _AT_TARGET_RAD:
                raise HardwareError(f"arm {name}: rests {np.degrees(away):.3f} deg from where it was sent")
        return states

    def go_home(self) -> None:
        """Bring the arms home one at a time, in whatever order the gate lets them.

        Raises as ``move`` does; ``MotionRefused`` if no arm that is not at home yet can go there.
        """
        homes = home_positions(self._profile)
        waiting = list(homes)
        while waiting:
            name = next((name for name in waiting if not self.refusal({name: homes[name]})), waiting[0])
            self.move({name: homes[name]})
            waiting.remove(name)

    def _settled(self, names: Sequence[str], timeout_s: float) -> dict[str, ArmState]:
        """Wait for all arms in turns, until a whole round found each of them at rest."""
        late = ""
        for name in names:
            self._rests_since.pop(name, None)
        for _ in range(math.ceil(timeout_s / _ROUND_S)):
            states = {}
            for name in names:
                try:
                    states[name] = self._cell.arms[name].wait_settled(_ROUND_S)
                except ArmTimeout:
                    late = name
                    continue
                self._rests_since.setdefault(name, self._seen_at_rest_s(name))
            if len(states) == len(names):
                return states
        raise ArmTimeout(f"arm {late}: did not come to rest within {timeout_s:.0f} s")

    def approach(self, name: str) -> NDArray[np.int8]:
        """Sign of each joint's last motion, 0 where it has not moved yet."""
        return self._approach[name]

    def step(self, name: str) -> Vector | None:
        """Each joint's last motion (N,) with its sign [rad]; None before the arm has moved."""
        return self._step.get(name)

    def rested_s(self, name: str) -> float | None:
        """How long an arm has been at rest [s]; None before it has moved.

        In a real cell from the moment on when its controller was seen to have settled.
        """
        since = self._rests_since.get(name)
        return None if since is None else self._clock_s() - since

    def rest(self, name: str, dwell_s: float, cancel: CancelToken) -> None:
        """Let time pass until an arm has rested for ``dwell_s``. Raises ``Cancelled`` as soon as somebody asks to stop.

        A simulated cell's clock is set forward.
        """
        left = dwell_s - (self.rested_s(name) or 0.0)
        if left > 0.0:
            if self._cell.plant is not None:
                self._cell.plant.advance(left)
            else:
                cancel.wait(left)
        cancel.check()

    def _clock_s(self) -> float:
        return time.monotonic() if self._cell.plant is None else self._cell.plant.clock_s

    def _seen_at_rest_s(self, name: str) -> float:
        return time.monotonic() if self._cell.plant is None else self._cell.plant.rest_s(name)

    def measure(self, name: str, q: Vector) -> Point:
        """Measure the SMR of an arm that stands at ``q`` (N,); tries twice.

        Raises
        ------
        TargetLost, WrongTarget, Unstable
            If there is no reading to be had.
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
        """Tell every arm to stop, whatever the others answer."""
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
