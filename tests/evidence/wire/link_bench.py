"""The bench of the program links: moves two arms, causes faults, and measures the reaction of the cell."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from drivers.arms.protocol import ArmError, MotionStopped
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.evidence.wire.link_arms import (
    ACCELERATION,
    HOME,
    SETTLE_S,
    SPEED,
    START_DELAY_S,
    NoTracker,
    disconnect,
    other_application,
    start,
    start_far,
)
from tests.evidence.wire.link_faults import FAULTS, HUNG, SLIDER, Fault, Moment
from tests.evidence.wire.link_results import LinkLog, OtherArm, Struck
from tests.evidence.wire.polling import can_move, comes_about

_REACH_RAD = 0.35
"""Largest distance of a goal from home: motions of about a second."""
_MOVE_WITHIN_S = 15.0
"""No motion of the trial takes longer, not even with a slow program start."""
_UNDER_WAY_RAD = 0.15
"""An arm that has moved this far is surely in motion."""
_WATCHED_S = 0.25
"""Time for which arms are watched after a fault: several cycles of every link."""
_BRAKES_WITHIN_S = 1.0
_STARTS = 3
"""Attempts to begin a motion that a fault is to interrupt."""
_STANDS_S = 2.0
"""Time at slider 0: longer than the driver's longest patience with an arm that stands in a motion."""


def travel_s(distance: float, speed: float, acceleration: float) -> float:
    """Time of the fastest motion over ``distance`` [rad] from rest to rest: trapezoidal or triangular speed profile."""
    if distance * acceleration < speed * speed:
        return 2.0 * float(np.sqrt(distance / acceleration))
    return distance / speed + speed / acceleration


class TimedReaction(StopReaction):
    """The reaction of the cell, with the time of the first doubt since ``arm_for_next``."""

    def __init__(self, arms: Mapping[str, UrArm]) -> None:
        self.doubted = threading.Event()
        self.doubted_s = 0.0
        super().__init__(arms, NoTracker())

    def arm_for_next(self) -> None:
        """Forget the last doubt."""
        self.doubted.clear()

    def trigger(self, cause: StopCause) -> None:
        """Note the time of the first doubt and brake."""
        if not self.doubted.is_set():
            self.doubted_s = time.monotonic()
            self.doubted.set()
        super().trigger(cause)


class LinkBench:
    """The two arms under test, the reaction that stops both, and their emulated controllers."""

    def __init__(
        self,
        log: LinkLog,
        emulator: EmulatorProcess,
        arms: Mapping[str, UrArm],
        hosts: Mapping[str, str],
        random: np.random.Generator,
    ) -> None:
        self._log, self._emulator, self._arms, self._hosts, self._random = log, emulator, arms, hosts, random
        self._reaction = TimedReaction(arms)

    # -- motions -------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Move both arms together to nearby goals."""
        goals = {name: HOME + self._random.uniform(-_REACH_RAD, _REACH_RAD, 6) for name in self._arms}
        try:
            ideal = 0.0
            for name, arm in self._arms.items():
                asked = time.monotonic()
                here = arm.state().q
                self._log.state_s.append(time.monotonic() - asked)
                ideal = max(ideal, travel_s(float(np.abs(goals[name] - here).max()), SPEED, ACCELERATION))
            began = time.monotonic()
            for name, arm in self._arms.items():
                start(arm, goals[name])
            for name, arm in self._arms.items():
                away = float(np.abs(arm.wait_settled(_MOVE_WITHIN_S).q - goals[name]).max())
                if away > 1e-6:
                    self._log.complain(f"arm {name} rests {away:.1e} rad from its goal, and nothing was reported")
            self._log.overhead_s.append(time.monotonic() - began - ideal - SETTLE_S)
        except ArmError as error:
            self._stopped_without_fault("without a fault", error)

    def _home(self) -> None:
        try:
            for arm in self._arms.values():
                start(arm, HOME)
            for arm in self._arms.values():
                arm.wait_settled(_MOVE_WITHIN_S)
        except ArmError as error:
            self._stopped_without_fault("on the way home", error)

    def _stopped_without_fault(self, when: str, error: ArmError) -> None:
        cause = self._reaction.cause
        if cause is not None and cause.kind == "host stalled":
            self._log.host_stalls += 1
        else:
            self._log.complain(f"{when}: {error}")
        self._release()

    # -- faults --------------------------------------------------------------------------------------------------------

    def cause_fault(self, name: str, moment: Moment, arm: str) -> None:
        """Move both arms, cause a fault, measure, repair it, and release the cell."""
        self._reaction.arm_for_next()
        if name == SLIDER:
            self._set_slider_to_zero(arm)
        elif name == HUNG:
            self._hang_application()
        else:
            self._stop_cell(name, FAULTS[name], moment, arm)
        self._home()

    def _stop_cell(self, name: str, fault: Fault, moment: Moment, arm: str) -> None:
        what = f"{name} {moment} a motion of arm {arm}"
        if moment != "before":
            self._start_all_far(what)
        if moment == "after":
            for other in self._arms.values():
                other.wait_settled(_MOVE_WITHIN_S)
        with ThreadPoolExecutor(max_workers=len(self._arms)) as pool:
            asked: dict[str, Future[ArmError | None]] = {}
            if moment == "during":
                self._wait_under_way(self._arms)
                asked = {one: pool.submit(self._outcome, one) for one in self._arms}
            struck_s = time.monotonic()
            self._strike(fault, arm)
            if not self._reaction.doubted.wait(_MOVE_WITHIN_S):
                self._log.complain(f"{what}: no doubt was reported")
                self._reaction.trigger(StopCause("engine", "the trial gave up"))
            at_rest_s = self._watch_rest([arm], struck_s)
            errors = {one: asked[one].result() if asked else self._refusal(one) for one in self._arms}
        unseen = self._reaction.wait_at_rest()
        whole = fault.cause is not None
        others = self._others_since(struck_s, what, [one for one in self._arms if whole or one != arm])
        self._check_errors(what, arm, fault, errors, unseen)
        self._stays(what)
        self._repair(arm)
        self._stays(f"{what}, repaired")
        recovered_s = self._release()
        self._stays(f"{what}, connected")
        self._emulator.control(arm, "start-delay", START_DELAY_S)
        detected_s = self._reaction.doubted_s - struck_s
        self._log.add(Struck(name, moment, "" if whole else arm, detected_s, at_rest_s, recovered_s, others))

    def _start_all_far(self, what: str) -> None:
        """Start a long motion of all arms; again where this computer stalled and the cell was stopped for that.

        Raises ``ArmError`` if it stalled every time.
        """
        for attempt in range(1, _STARTS + 1):
            try:
                for other in self._arms.values():
                    start_far(other)
            except ArmError as error:
                self._stopped_without_fault(f"before {what}", error)
                self._reaction.arm_for_next()
                if attempt == _STARTS:
                    raise
            else:
                return

    def _strike(self, fault: Fault, arm: str) -> None:
        if fault.cause == "stop":
            control = JobControl(holds=True)
            with control.brakes(lambda verb: self._reaction.trigger(StopCause("stop", f"a person asked to {verb}"))):
                control.stop()
        elif fault.cause is not None:
            self._reaction.trigger(StopCause(fault.cause, "tracker: the bridge does not answer"))
        pid = self._arms[arm].worker_pid
        if fault.signal and pid is not None:
            os.kill(pid, getattr(signal, fault.signal))
        for command in fault.commands:
            self._emulator.control(arm, *command)

    def _outcome(self, arm: str) -> ArmError | None:
        """Return the error that ends the motion under way."""
        try:
            self._arms[arm].wait_settled(_MOVE_WITHIN_S)
        except ArmError as error:
            return error
        return None

    def _refusal(self, arm: str) -> ArmError | None:
        """Return the error with which the next motion is refused."""
        try:
            start(self._arms[arm], HOME)
        except ArmError as error:
            return error
        return None

    def _check_errors(
        self, what: str, arm: str, fault: Fault, errors: Mapping[str, ArmError | None], unseen: Mapping[str, str]
    ) -> None:
        for name, error in errors.items():
            expected = fault.error if name == arm else MotionStopped
            if error is None:
                self._log.complain(f"{what}: not reported by arm {name}")
            elif not isinstance(error, expected):
                self._log.complain(f"{what}: arm {name} reports {type(error).__name__}: {error}")
            elif f"arm {name}" not in str(error):
                self._log.complain(f"{what}: the report does not name the arm: {error}")
        for name, reason in unseen.items():
            if name != arm or fault.cause is not None:
                self._log.complain(f"{what}: arm {name} was not seen at rest: {reason}")

    def _set_slider_to_zero(self, arm: str) -> None:
        """At slider 0 an arm stands and its motion is not over: nothing is reported, and it goes on afterwards."""
        for other in self._arms.values():
            start_far(other)
        self._wait_under_way(self._arms)
        struck_s = time.monotonic()
        with ThreadPoolExecutor(max_workers=1) as pool:
            asked = pool.submit(self._outcome, arm)
            self._emulator.control(arm, "slider", 0.0)
            at_rest_s = self._watch_rest([arm], struck_s)
            if self._reaction.doubted.wait(_STANDS_S):
                cause = self._reaction.cause
                self._log.complain(f"{SLIDER} of arm {arm}: reported as {'?' if cause is None else cause.text}")
            self._emulator.control(arm, "slider", 1.0)
            error = asked.result()
        if error is not None:
            self._log.complain(f"{SLIDER} of arm {arm}: its motion ended with {type(error).__name__}: {error}")
            self._release()
        else:
            self._log.add(Struck(SLIDER, "during", arm, None, at_rest_s, time.monotonic() - struck_s))
        for other in self._arms.values():
            try:
                other.wait_settled(_MOVE_WITHIN_S)
            except ArmError as problem:
                self._log.complain(f"{SLIDER} of arm {arm}: {problem}")

    def _hang_application(self) -> None:
        """Stop a whole process that moves both arms; the arms' own processes and controllers must notice."""
        for arm in self._arms.values():
            disconnect(arm)
        with other_application(self._hosts) as pid:
            self._wait_under_way(self._arms)
            struck_s = time.monotonic()
            os.kill(pid, signal.SIGSTOP)
            at_rest_s = self._watch_rest(self._arms, struck_s)
            first = {name: records[0] for name in self._arms if (records := self._stops_since(name, struck_s))}
        if len(first) < len(self._arms):
            self._log.complain(f"{HUNG}: an arm was not commanded to stop")
        doubted_s = min((record["received_s"] for record in first.values()), default=time.monotonic())
        others = tuple(_other(name, record, doubted_s) for name, record in first.items())
        self._stays(HUNG)
        recovered_s = self._release()
        self._stays(f"{HUNG}, connected")
        self._log.add(Struck(HUNG, "during", "", doubted_s - struck_s, at_rest_s, recovered_s, others))

    # -- what the controllers saw --------------------------------------------------------------------------------------

    def _others_since(self, struck_s: float, what: str, names: list[str]) -> tuple[OtherArm, ...]:
        found = []
        for name in names:
            records = self._stops_since(name, struck_s)
            if not records or records[0]["rest_s"] is None:
                self._log.complain(f"{what}: arm {name} was not commanded to stop")
                continue
            found.append(_other(name, records[0], self._reaction.doubted_s))
        return tuple(found)

    def _stops_since(self, name: str, since_s: float) -> list[dict[str, Any]]:
        stops: list[dict[str, Any]] = self._emulator.control(name, "stops", since_s)
        return stops

    def _moving(self, name: str) -> bool:
        return bool(self._emulator.control(name, "status")["moving"])

    def _watch_rest(self, names: Mapping[str, UrArm] | list[str], struck_s: float) -> float:
        """Time from the fault to the arms at rest [s], from their controllers; the drivers are not called meanwhile."""
        if not comes_about(lambda: not any(map(self._moving, names)), struck_s + _MOVE_WITHIN_S):
            self._log.complain(f"arm {' or '.join(names)} did not come to rest")
        return time.monotonic() - struck_s

    def _wait_under_way(self, names: Mapping[str, UrArm]) -> None:
        before = {name: np.array(self._emulator.control(name, "status")["q"]) for name in names}
        deadline = time.monotonic() + _MOVE_WITHIN_S

        def under_way(name: str) -> bool:
            q = np.array(self._emulator.control(name, "status")["q"])
            return bool(np.abs(q - before[name]).max() >= _UNDER_WAY_RAD)

        for name in names:
            if not comes_about(partial(under_way, name), deadline):
                self._log.complain(f"arm {name} did not begin to move")
                return

    def _stays(self, when: str) -> None:
        """Check that nothing moves, and that nothing starts to."""
        if not comes_about(lambda: not any(map(self._moving, self._arms)), time.monotonic() + _BRAKES_WITHIN_S):
            self._log.complain(f"{when}: an arm still moves")
            return
        before = {name: self._emulator.control(name, "status") for name in self._arms}
        time.sleep(_WATCHED_S)
        for name in self._arms:
            now = self._emulator.control(name, "status")
            if now["moving"] or now["q"] != before[name]["q"] or now["moves"] != before[name]["moves"]:
                self._log.complain(f"{when}: arm {name} moved without a command")

    # -- repair --------------------------------------------------------------------------------------------------------

    def _repair(self, name: str) -> None:
        """Repair a fault as an operator would at the pendant and the cables."""
        control = self._emulator.control
        control(name, "fault", "*", "none")
        control(name, "release")
        control(name, "estop-release")
        control(name, "brake-release")
        if not comes_about(lambda: can_move(control(name, "status")), time.monotonic() + _MOVE_WITHIN_S):
            status = control(name, "status")
            self._log.complain(f"arm {name} could not be repaired: {status['robot_mode']}, {status['safety_mode']}")

    def _release(self) -> float:
        """Release the cell as a person's resume does; return the time that takes [s]."""
        began = time.monotonic()
        try:
            self._reaction.wait_at_rest()
            self._reaction.release(self._reaction.causes)
        except HardwareError as error:
            self._log.complain(f"could not be connected again: {error}")
        return time.monotonic() - began


def _other(name: str, record: Mapping[str, Any], doubted_s: float) -> OtherArm:
    rest_s = record["rest_s"] if record["rest_s"] is not None else time.monotonic()
    return OtherArm(name, record["received_s"] - doubted_s, rest_s - doubted_s - record["ideal_s"])
