"""Link failures: two emulated UR controllers, the real client, random faults; what is reported, and how soon.

This needs no hardware. The controllers run in their own process on two loopback addresses.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import HardwareError
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Record, Result
from drivers.arms.protocol import ArmError, EmergencyStop, JointLimits, LinkLost, ProtectiveStop
from drivers.arms.ur import UrArm
from drivers.arms.ur_checks import UrExpectation
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import (
    ControllerConfig,
    EmulatorProcess,
    Series,
    personality,
    start_in_process,
)

Vector = NDArray[np.float64]
Moment = Literal["before", "during", "after"]
MOMENTS: tuple[Moment, ...] = ("before", "during", "after")

HOSTS = {"left": "127.0.0.2", "right": "127.0.0.3"}
"""Loopback addresses of the two arms: two, as the client uses the standard ports only."""
_CONTROLLERS: Mapping[str, tuple[Series, str, str]] = {
    "left": ("CB3", "UR10", "20150000001"),
    "right": ("e-Series", "UR5", "20200000002"),
}
_HOME = np.array([0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0])
_REACH_RAD = 0.35
"""Largest distance of a goal from home: motions of about a second."""
_FAR_RAD = 1.6
"""Length of a motion that a fault interrupts: it lasts longer than any fault needs to take effect."""
_SPEED, _ACCELERATION = 2.0, 6.0
_SETTLE_S = 0.1
_MOVE_WITHIN_S = 15.0
"""No motion of the trial takes longer, not even with a slow program start."""
_STEP_WITHIN_S = 60.0
"""No step takes longer, with fault, repair and connecting."""
_UNDER_WAY_RAD = 0.15
"""An arm that has moved this far is surely in motion."""
_WATCHED_S = 0.25
"""Time for which arms are watched after a fault: several cycles of every link."""
_BRAKES_WITHIN_S = 1.0
_POLL_S = 0.002
_START_DELAY_S = 0.05


@dataclass(frozen=True)
class _Fault:
    """Commands to the emulated controller, and the error that the driver must report."""

    commands: tuple[tuple[str, *tuple[object, ...]], ...]
    error: type[ArmError]


FAULTS: Mapping[str, _Fault] = {
    "link closed": _Fault((("drop", "rtde", "fin"),), LinkLost),
    "link reset": _Fault((("drop", "rtde", "rst"),), LinkLost),
    "link silent": _Fault((("fault", "rtde", "silent"),), LinkLost),
    "host silent": _Fault((("fault", "*", "silent"),), LinkLost),
    "reconnect refused": _Fault((("drop", "rtde", "rst", 1.0),), LinkLost),
    "slow program start": _Fault((("start-delay", 2.0), ("drop", "rtde", "fin")), LinkLost),
    "client killed": _Fault((), LinkLost),
    "protective stop": _Fault((("protective", "now"),), ProtectiveStop),
    "emergency stop": _Fault((("estop",),), EmergencyStop),
}
"""Faults by name; for "client killed" the driver's worker process is killed."""


@dataclass(frozen=True)
class Struck:
    """One fault and its consequences.

    Attributes
    ----------
    reported_s, at_rest_s : float
        From the fault to the driver's report, and to the arm at rest according to its controller [s]; the latter is
        meaningful for faults during a motion only.
    recovered_s : float
        From the call of ``connect``, after the operator's repair, to an arm that may move [s].
    """

    fault: str
    moment: Moment
    arm: str
    reported_s: float
    at_rest_s: float
    recovered_s: float


class Times(Record):
    """Statistics of n times [s]."""

    median: float
    p95: float
    max: float
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Times | None:
        """Statistics of times; None of none."""
        if not values:
            return None
        return cls(
            median=float(np.median(values)), p95=float(np.quantile(values, 0.95)), max=max(values), n=len(values)
        )


class FaultTimes(Record):
    """Times after one kind of fault [s]: to the report, to rest (faults during a motion only), to ready again."""

    reported_s: Times | None
    at_rest_s: Times | None
    recovered_s: Times | None


class LinksResult(Result):
    """``trials links``: times, and what did not happen as specified (``complaints``, empty if nothing)."""

    schema_: Literal["cellapp-trials-links"] = "cellapp-trials-links"
    version: Literal[1] = 1
    moves: int
    faults: int
    complaints: tuple[str, ...]
    connect_s: Times | None
    state_s: Times | None
    move_overhead_s: Times | None
    longest_step_s: float
    by_fault: Mapping[str, FaultTimes]


@dataclass
class LinkLog:
    """What is recorded during a trial; ``result`` summarises it."""

    moves: int = 0
    struck: list[Struck] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    connect_s: list[float] = field(default_factory=list)
    state_s: list[float] = field(default_factory=list)
    overhead_s: list[float] = field(default_factory=list)
    longest_step_s: float = 0.0

    def result(self) -> LinksResult:
        """The summary."""
        by_fault = {fault: [one for one in self.struck if one.fault == fault] for fault in FAULTS}
        return LinksResult(
            moves=self.moves,
            faults=len(self.struck),
            complaints=tuple(self.complaints),
            connect_s=Times.of(self.connect_s),
            state_s=Times.of(self.state_s),
            move_overhead_s=Times.of(self.overhead_s),
            longest_step_s=self.longest_step_s,
            by_fault={
                fault: FaultTimes(
                    reported_s=Times.of([one.reported_s for one in struck]),
                    at_rest_s=Times.of([one.at_rest_s for one in struck if one.moment == "during"]),
                    recovered_s=Times.of([one.recovered_s for one in struck]),
                )
                for fault, struck in by_fault.items()
                if struck
            },
        )


def link_trials(
    moves: int = 1000,
    every: int = 20,
    seed: int = 0,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    hosts: Mapping[str, str] = HOSTS,
) -> LinksResult:
    """Move two arms at once, ``moves`` motions in all; one in ``every`` meets a random fault at a random moment.

    ``hosts`` has an address for ``left`` and one for ``right``. After a fault both arms are stopped and watched; then
    the fault is repaired as an operator would, and the affected arm is connected again.

    Raises
    ------
    HardwareError
        If the emulated controllers cannot be started.
    Cancelled
    """
    cancel = cancel or CancelToken()
    random = np.random.default_rng(seed)
    trial = LinkLog()
    steps = max(1, moves // len(hosts))
    between = max(1, every // len(hosts))
    faults = _shuffled(random)
    with ExitStack() as stack:
        try:
            emulator = stack.enter_context(start_in_process(_controllers(hosts)))
        except (OSError, TimeoutError) as error:
            raise HardwareError(f"the emulated controllers do not start: {error}") from error
        arms = {name: _driver(name, host) for name, host in hosts.items()}
        for arm in arms.values():
            stack.callback(_disconnect, arm)
            began = time.monotonic()
            arm.connect()
            trial.connect_s.append(time.monotonic() - began)
        bench = _Bench(trial, emulator, arms, random)
        for step in range(steps):
            cancel.check()
            listener(Progress("links", step * len(hosts), steps * len(hosts), f"{len(trial.struck)} faults"))
            began = time.monotonic()
            if step % between == between - 1:
                fault, moment = faults()
                bench.cause_fault(fault, moment, str(random.choice(list(hosts))))
            else:
                bench.step()
            took = time.monotonic() - began
            trial.longest_step_s = max(trial.longest_step_s, took)
            if took > _STEP_WITHIN_S:
                trial.complaints.append(f"step {step + 1} took {took:.0f} s")
            trial.moves += len(hosts)
        listener(Progress("links", steps * len(hosts), steps * len(hosts), "done"))
    return trial.result()


def _shuffled(random: np.random.Generator) -> Callable[[], tuple[str, Moment]]:
    """Draws pairs of fault and moment: all in random order, then all again."""
    pairs = [(fault, moment) for fault in FAULTS for moment in MOMENTS]
    left: list[tuple[str, Moment]] = []

    def draw() -> tuple[str, Moment]:
        if not left:
            left.extend(pairs[index] for index in random.permutation(len(pairs)))
        return left.pop()

    return draw


def _controllers(hosts: Mapping[str, str]) -> list[ControllerConfig]:
    quick: dict[str, Any] = {"boot_s": 0.3, "brake_release_s": 0.2, "unlock_after_s": 0.5}
    return [
        ControllerConfig(name, host, personality(*_CONTROLLERS[name]), start_delay_s=_START_DELAY_S, **quick)
        for name, host in hosts.items()
    ]


def _driver(name: str, host: str) -> UrArm:
    series, model, serial = _CONTROLLERS[name]
    limits = JointLimits(np.tile([-2.0 * math.pi, 2.0 * math.pi], (6, 1)), np.full(6, 3.0), np.full(6, 8.0))
    expected = UrExpectation(
        model=model if series == "CB3" else f"{model}e",
        serial=serial,
        limits=limits,
        payload_kg=0.0,
        payload_center_m=np.zeros(3),
    )
    return UrArm(name, UrSettings(host=host, settle_time=_SETTLE_S), expected)


def _disconnect(arm: UrArm) -> None:
    with suppress(ArmError):
        arm.disconnect()


def travel_s(distance: float, speed: float, acceleration: float) -> float:
    """Time of the fastest motion over ``distance`` [rad] from rest to rest: trapezoidal or triangular speed profile."""
    if distance * acceleration < speed * speed:
        return 2.0 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


class _Bench:
    """The two arms under test."""

    def __init__(
        self, trial: LinkLog, emulator: EmulatorProcess, arms: Mapping[str, UrArm], random: np.random.Generator
    ) -> None:
        self._trial, self._emulator, self._arms, self._random = trial, emulator, arms, random

    def step(self) -> None:
        """Move both arms together to nearby goals."""
        goals = {name: _HOME + self._random.uniform(-_REACH_RAD, _REACH_RAD, 6) for name in self._arms}
        try:
            ideal, began = 0.0, time.monotonic()
            for name, arm in self._arms.items():
                asked = time.monotonic()
                here = arm.state().q
                self._trial.state_s.append(time.monotonic() - asked)
                ideal = max(ideal, travel_s(float(np.abs(goals[name] - here).max()), _SPEED, _ACCELERATION))
            began = time.monotonic()
            for name, arm in self._arms.items():
                self._start(arm, goals[name])
            for name, arm in self._arms.items():
                away = float(np.abs(arm.wait_settled(_MOVE_WITHIN_S).q - goals[name]).max())
                if away > 1e-6:
                    self._complain(f"arm {name} rests {away:.1e} rad from its goal, and nothing was reported")
            self._trial.overhead_s.append(time.monotonic() - began - ideal - _SETTLE_S)
        except ArmError as error:
            self._complain(f"without a fault: {error}")
            self._stop_all()
            self._reconnect()

    def cause_fault(self, fault: str, moment: Moment, name: str) -> None:
        """Move both arms and cause a fault."""
        what = f"{fault} {moment} a motion of arm {name}"
        if moment != "before":
            for other in self._arms.values():
                here = other.state().q
                way = _FAR_RAD if here[0] < _HOME[0] else -_FAR_RAD
                self._start(other, here + np.array([way, 0.0, 0.0, 0.0, 0.0, 0.0]))
        if moment == "after":
            for other in self._arms.values():
                other.wait_settled(_MOVE_WITHIN_S)
        with ThreadPoolExecutor(max_workers=1) as pool:
            if moment == "during":
                self._wait_under_way(name)
                asked = pool.submit(self._outcome, name, moment)
                struck = self._strike(fault, name)
            else:
                struck = self._strike(fault, name)
                asked = pool.submit(self._outcome, name, moment)
            at_rest = self._watch_rest(name, struck)
            error, reported = asked.result()
        self._stop_all()
        self._stays(what, self._arms)
        if error is None:
            self._complain(f"{what}: not reported")
        elif not isinstance(error, FAULTS[fault].error):
            self._complain(f"{what}: reported as {type(error).__name__}: {error}")
        elif f"arm {name}" not in str(error):
            self._complain(f"{what}: the report does not name the arm: {error}")
        for other_name, other in self._arms.items():
            if other_name != name and not self._well(other):
                self._complain(f"{what}: arm {other_name} is affected too")
        self._repair(name)
        self._stays(f"{what}, repaired", self._arms)
        recovered = self._reconnect()
        self._stays(f"{what}, connected", self._arms)
        self._emulator.control(name, "start-delay", _START_DELAY_S)
        self._trial.struck.append(Struck(fault, moment, name, reported - struck, at_rest, recovered))
        self._home()

    def _outcome(self, name: str, moment: Moment) -> tuple[ArmError | None, float]:
        """The driver's error and when it came: of the motion under way, else of the next one."""
        arm = self._arms[name]
        try:
            if moment == "during":
                arm.wait_settled(_MOVE_WITHIN_S)
            else:
                self._start(arm, _HOME)
        except ArmError as error:
            return error, time.monotonic()
        return None, time.monotonic()

    def _well(self, arm: UrArm) -> bool:
        try:
            return arm.state().ready
        except ArmError:
            return False

    def _start(self, arm: UrArm, q: Vector) -> None:
        arm.start_move(q, np.full(6, _SPEED), np.full(6, _ACCELERATION))

    def _strike(self, fault: str, name: str) -> float:
        if not FAULTS[fault].commands:
            pid = self._arms[name].worker_pid
            if pid is not None:
                os.kill(pid, signal.SIGKILL)
        for command in FAULTS[fault].commands:
            self._emulator.control(name, *command)
        return time.monotonic()

    def _watch_rest(self, name: str, struck: float) -> float:
        """Time from the fault to the arm at rest [s], from its controller; the driver is not called meanwhile."""
        deadline = struck + _MOVE_WITHIN_S
        while self._emulator.control(name, "status")["moving"]:
            if time.monotonic() > deadline:
                self._complain(f"arm {name} did not come to rest")
                break
            time.sleep(_POLL_S)
        return time.monotonic() - struck

    def _wait_under_way(self, name: str) -> None:
        before = np.array(self._emulator.control(name, "status")["q"])
        deadline = time.monotonic() + _MOVE_WITHIN_S
        while np.abs(np.array(self._emulator.control(name, "status")["q"]) - before).max() < _UNDER_WAY_RAD:
            if time.monotonic() > deadline:
                self._complain(f"arm {name} did not begin to move")
                return
            time.sleep(_POLL_S)

    def _stop_all(self) -> None:
        for arm in self._arms.values():
            with suppress(ArmError):
                arm.stop()

    def _stays(self, when: str, names: Mapping[str, UrArm]) -> None:
        """Check that nothing moves, and that nothing starts to."""
        deadline = time.monotonic() + _BRAKES_WITHIN_S
        while any(self._emulator.control(name, "status")["moving"] for name in names):
            if time.monotonic() > deadline:
                self._complain(f"{when}: an arm still moves")
                return
            time.sleep(_POLL_S)
        before = {name: self._emulator.control(name, "status") for name in names}
        time.sleep(_WATCHED_S)
        for name in names:
            now = self._emulator.control(name, "status")
            if now["moving"] or now["q"] != before[name]["q"] or now["moves"] != before[name]["moves"]:
                self._complain(f"{when}: arm {name} moved without a command")

    def _repair(self, name: str) -> None:
        """Repair a fault as an operator would at the pendant and the cables."""
        control = self._emulator.control
        control(name, "fault", "*", "none")
        control(name, "release")
        control(name, "estop-release")
        control(name, "brake-release")
        deadline = time.monotonic() + _MOVE_WITHIN_S
        while True:
            status = control(name, "status")
            if status["robot_mode"] == "RUNNING" and status["safety_mode"] == "NORMAL":
                return
            if time.monotonic() > deadline:
                self._complain(f"arm {name} could not be repaired: {status['robot_mode']}, {status['safety_mode']}")
                return
            time.sleep(_POLL_S)

    def _reconnect(self) -> float:
        began = time.monotonic()
        for arm in self._arms.values():
            try:
                arm.connect()
            except ArmError as error:
                self._complain(f"could not be connected again: {error}")
        return time.monotonic() - began

    def _home(self) -> None:
        try:
            for arm in self._arms.values():
                self._start(arm, _HOME)
            for arm in self._arms.values():
                arm.wait_settled(_MOVE_WITHIN_S)
        except ArmError as error:
            self._complain(f"on the way home: {error}")
            self._stop_all()
            self._reconnect()

    def _complain(self, text: str) -> None:
        self._trial.complaints.append(f"move {self._trial.moves}: {text}")
