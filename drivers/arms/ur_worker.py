"""The process that holds one UR arm's RTDE client: a crash or a hang of that client ends here and nowhere else.

Run as ``python -m drivers.arms.ur_worker`` by ``drivers.arms.ur``, which alone speaks with it: requests and answers are
JSON, a line each, on standard input and output. A request is ``{"id": n, "do": ...}``, its answer ``{"id": n, "ok":
...}`` or ``{"id": n, "error": kind, "text": ...}``; kinds are the keys of ``drivers.arms.ur.KINDS``.

As long as it is well it keeps the controller's watchdog content. When it ends, in whatever way, the controller stops
its program by itself; when standard input ends, because the application did, the worker stops the program first.
"""

from __future__ import annotations

import faulthandler
import json
import math
import os
import queue
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, NoReturn

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_links import stop_program
from drivers.arms.ur_rtde_reader import PROGRAM_STATES, ROBOT_MODES, SAFETY_MODES, named

MOST_SPEED = 3.14
"""Of a joint [rad/s]; the RTDE client takes no more."""
MOST_ACCELERATION = 40.0
"""Of a joint [rad/s^2]; likewise."""

_TICK_S = 0.008
_IDLE_TICK_S = 0.02
_FREQUENCY_HZ = 125.0
_SILENT_S = 0.5
"""Without a new state for so long, the link counts as lost."""
_SILENT_TICKS = 10
_STARTS_WITHIN_S = 1.0
_PROGRAM_WITHIN_S = 5.0
_HALT_WITHIN_S = 0.25
"""The application stops the program over another connection first and says so then; a stop that nobody owns up to
within this is a fault."""
_STANDING_S = 1.0
"""A motion that is said to run while the arm stands for so long is no longer believed."""
_STREAMS_APART_S = 0.05
"""The end of a motion is told over another connection than the positions are; these may be this much older."""
_CUT_SHORT_S = 0.5
"""An arm that rests elsewhere than at its goal for so long after the end of a motion will not come there any more."""
_STANDS_RAD_S = 1e-4
_AT_GOAL_RAD = 2e-3
_STOP_WITHIN_S = 1.0
_VARIABLES = ("timestamp", "actual_q", "actual_qd", "joint_temperatures", "robot_mode", "safety_mode", "runtime_state")
_EMERGENCY = ("SYSTEM_EMERGENCY_STOP", "ROBOT_EMERGENCY_STOP")


class Refusal(Exception):
    """A request that cannot be served: a kind and a sentence."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


@dataclass(frozen=True)
class _Sample:
    time_s: float
    q: tuple[float, ...]
    qd: tuple[float, ...]
    temperatures: tuple[float, ...]
    robot_mode: str
    safety_mode: str
    program: str
    payload_kg: float | None

    def as_dict(self) -> dict[str, Any]:
        return {
            "time_s": self.time_s,
            "q": self.q,
            "qd": self.qd,
            "temperatures": self.temperatures,
            "robot_mode": self.robot_mode,
            "safety_mode": self.safety_mode,
            "program": self.program,
            "payload_kg": self.payload_kg,
        }


@dataclass
class _Motion:
    """A motion under way: the client's operation number before it, and what was seen of it since."""

    goal: Sequence[float]
    number_before: int
    began_s: float
    under_way: bool = True
    ended_s: float = math.inf
    stood_since_s: float | None = None


@dataclass
class _Waiting:
    """A request to be answered when the arm has settled."""

    request: int
    deadline_s: float


@dataclass(frozen=True)
class _Rest:
    """When the arm rests: not faster than ``speed`` nor out of ``position`` for ``dwell_s``."""

    dwell_s: float
    speed: float
    position: float


class Worker:
    """Serves requests one after the other; only the waiting for an arm to settle goes on beside them."""

    def __init__(self, requests: queue.SimpleQueue[dict[str, Any]], answers: BinaryIO) -> None:
        self._requests, self._answers = requests, answers
        self._writing = threading.Lock()
        self._parent = os.getppid()
        self._host = ""
        self._watchdog_hz = 0.0
        self._payload = False
        self._control: Any = None
        self._receive: Any = None
        self._motion: _Motion | None = None
        self._waiting: list[_Waiting] = []
        self._rest = _Rest(0.0, 0.0, 0.0)
        self._rests_since: _Sample | None = None
        self._fault: Refusal | None = None
        self._halted = False
        self._stopped_s: float | None = None  # since when the program is seen stopped and nobody owns up to it
        self._orphaned = False
        self._kicked_s = 0.0
        self._last_time = -1.0
        self._last_news_s = 0.0
        self._ticks_without_news = 0

    # -- serving -------------------------------------------------------------------------------------------------------

    def run(self) -> NoReturn:
        """Serve until the process ends."""
        self._answer({"hello": os.getpid()})
        while True:
            tick = _TICK_S if self._motion is not None or self._waiting else _IDLE_TICK_S
            with suppress(queue.Empty):
                self._serve(self._requests.get(timeout=tick))
            if self._control is not None:
                self._watch()

    def orphan(self) -> NoReturn:
        """The application has gone: stop the program and end. Called by the thread that reads requests."""
        self._orphaned = True  # the watchdog is no longer kept content, should the dashboard not answer
        if self._host:
            with suppress(LinkLost):
                stop_program(self._host, 2.0 * _STOP_WITHIN_S)
        os._exit(0)

    def _serve(self, request: Mapping[str, Any]) -> None:
        number = int(request["id"])
        try:
            match request["do"]:
                case "open":
                    answer = self._open(request)
                case "state":
                    answer = self._state()
                case "move":
                    answer = self._move(request)
                case "settled":
                    self._settled(number, request)
                    return
                case "halt":
                    self._halt()
                    answer = {}
                case other:
                    raise Refusal("failed", f"no such request: {other}")
        except Refusal as refusal:
            self._answer({"id": number, "error": refusal.kind, "text": refusal.text})
        else:
            self._answer({"id": number, "ok": answer})

    def _answer(self, answer: Mapping[str, Any]) -> None:
        line = json.dumps(answer).encode("ascii") + b"\n"
        with self._writing:
            try:
                self._answers.write(line)
                self._answers.flush()
            except OSError:  # nobody reads: the application has gone
                self.orphan()

    def _lose(self, text: str) -> NoReturn:
        """The link is lost or in doubt: stop the arm another way, say so, and end before the client does harm."""
        with suppress(LinkLost):
            stop_program(self._host, _STOP_WITHIN_S)
        self._answer({"lost": text})
        os._exit(3)

    # -- the controller ------------------------------------------------------------------------------------------------

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        host, self._payload = str(request["host"]), bool(request["payload"])
        variables = [*_VARIABLES, "payload"] if self._payload else [*_VARIABLES]
        self._watchdog_hz = float(request["watchdog_hz"])
        self._rest = _Rest(*(float(request[key]) for key in ("settle_s", "settle_speed", "settle_position")))
        # constructors hold the interpreter still, so no thread of this process could end a hanging one
        with _ends_within(float(request["timeout_s"])):
            try:
                receive = RTDEReceiveInterface(host, _FREQUENCY_HZ, variables)
                if not receive.isConnected():
                    raise Refusal("link", "the controller accepts RTDE connections but sends no state")
                self._host = host  # from here on a program may run there that is ours
                control = RTDEControlInterface(host)
            except RuntimeError as error:
                raise _opening(str(error)) from error
            self._receive, self._control = receive, control
            self._last_news_s = time.monotonic()
            self._arm_watchdog()
        return self._state()

    def _arm_watchdog(self) -> None:
        if not self._control.setWatchdog(self._watchdog_hz):
            raise Refusal("failed", "the control program does not obey (it refused the watchdog)")
        self._kicked_s = time.monotonic()

    def _check_links(self) -> None:
        """The client would try to reconnect by itself, again and again, and crash in the end."""
        if not (self._control.isConnected() and self._receive.isConnected()):
            self._lose("the RTDE link broke")

    def _sample(self) -> _Sample:
        """The newest state, all of one packet."""
        receive = self._receive
        while True:
            stamp = receive.getTimestamp()
            payload = receive.getPayload() if self._payload else None
            q, qd, temperatures = receive.getActualQ(), receive.getActualQd(), receive.getJointTemperatures()
            modes = receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()
            if receive.getTimestamp() == stamp:
                break
        if len(q) != 6 or len(qd) != 6 or not all(map(math.isfinite, (*q, *qd))):
            self._lose("the controller's state is not one of six joints")
        return _Sample(
            time_s=stamp,
            q=tuple(q),
            qd=tuple(qd),
            temperatures=tuple(temperatures),
            robot_mode=named(ROBOT_MODES, modes[0]),
            safety_mode=named(SAFETY_MODES, modes[1]),
            program=named(PROGRAM_STATES, modes[2]),
            payload_kg=payload,
        )

    def _next_sample(self) -> _Sample:
        """The first state that came after this was called."""
        before = self._receive.getTimestamp()
        deadline = time.monotonic() + _SILENT_S
        while self._receive.getTimestamp() == before:
            self._check_links()
            if time.monotonic() > deadline:
                self._lose(f"no state came for {_SILENT_S:g} s")
            time.sleep(0.0005)
        return self._sample()

    def _state(self) -> dict[str, Any]:
        self._opened()
        state = self._next_sample().as_dict()
        fault = self._fault
        return {
            **state,
            "under_way": self._motion is not None and self._motion.under_way,
            "fault": None if fault is None else {"kind": fault.kind, "text": fault.text},
        }

    def _opened(self) -> None:
        if self._control is None:
            raise Refusal("failed", "no controller was opened")

    def _move(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self._opened()
        if self._fault is not None:
            raise self._fault
        if self._motion is not None and self._motion.under_way:
            raise Refusal("failed", "it is still moving; wait until it rests, or stop it")
        self._motion = None
        sample = self._next_sample()
        self._ready(sample)
        if self._stopped_s is not None:
            raise self._program_stopped()
        if max(map(abs, sample.qd)) > self._rest.speed:
            raise Refusal("failed", "it is still moving; wait until it rests, or stop it")
        speed, acceleration = leading(sample.q, request["q"], request["speed"], request["acceleration"])
        with _ends_within(float(request["timeout_s"])):
            self._running_program(sample)
            number = self._control.getAsyncOperationProgressEx().operationId()
            try:
                obeyed = self._control.moveJ(request["q"], speed, acceleration, True)
            except (RuntimeError, ValueError) as error:
                raise Refusal("failed", f"the RTDE client refused the motion: {error}") from error
            if not obeyed:
                self._ready(self._next_sample())
                raise self._remember(Refusal("failed", "the control program did not take the motion"))
        self._check_links()  # the client may say yes to a link that has just broken
        self._kicked_s = time.monotonic()
        self._rests_since = None
        self._motion = _Motion(request["q"], number, self._kicked_s)
        return {}

    def _ready(self, sample: _Sample) -> None:
        """Raise what keeps the arm from moving."""
        mode = sample.safety_mode
        if mode == "PROTECTIVE_STOP":
            raise self._remember(Refusal("protective", "protective stop"))
        if mode in _EMERGENCY:
            raise self._remember(Refusal("emergency", "emergency stop"))
        if mode != "NORMAL":
            raise self._remember(Refusal("failed", f"safety mode {mode}"))
        if sample.robot_mode != "RUNNING":
            raise self._remember(Refusal("failed", f"robot mode {sample.robot_mode}, needed is RUNNING"))

    def _running_program(self, sample: _Sample) -> None:
        """Send the control program anew where it was stopped on purpose."""
        if sample.program == "PLAYING" and not self._halted:
            return
        if sample.program != "STOPPED":
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
        deadline = time.monotonic() + _PROGRAM_WITHIN_S
        while self._control.isProgramRunning():  # the client learns of a stop a period later than the state says
            if time.monotonic() > deadline:
                raise self._remember(Refusal("failed", "the control program was stopped but goes on"))
            time.sleep(0.002)
        try:
            self._control.reuploadScript()
        except RuntimeError as error:
            raise self._remember(Refusal("failed", f"the control program could not be sent anew: {error}")) from error
        while not self._control.isProgramRunning():
            if time.monotonic() > deadline:
                text = f"the control program did not start within {_PROGRAM_WITHIN_S:g} s"
                raise self._remember(Refusal("timeout", text))
            time.sleep(0.002)
        self._halted = False
        self._arm_watchdog()

    def _remember(self, refusal: Refusal) -> Refusal:
        """A fault: nothing moves until the application connects anew. Whatever moves is told to stop."""
        if self._fault is None:
            self._fault = refusal
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
        self._motion = None
        return refusal

    def _halt(self) -> None:
        """Forget the motion: the program was stopped from outside, on purpose."""
        self._opened()
        self._motion = None
        self._halted = True
        self._stopped_s = None
        self._rests_since = None

    def _settled(self, number: int, request: Mapping[str, Any]) -> None:
        self._opened()
        self._waiting.append(_Waiting(number, time.monotonic() + float(request["timeout_s"])))

    # -- watching ------------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        """What is looked at a hundred times a second."""
        now = time.monotonic()
        if os.name == "posix" and os.getppid() != self._parent:
            self.orphan()
        self._check_links()
        sample = self._sample()
        if sample.time_s == self._last_time:
            self._ticks_without_news += 1
            if now - self._last_news_s > _SILENT_S and self._ticks_without_news > _SILENT_TICKS:
                self._lose(f"no state came for {_SILENT_S:g} s")
            news = False
        else:
            self._last_time, self._last_news_s, self._ticks_without_news = sample.time_s, now, 0
            news = True
        self._notice(sample, now)
        if news:
            self._settle(sample)
        if self._motion is not None and self._motion.under_way:
            self._follow(self._motion, sample, now)
        if self._fault is None and not self._halted and self._stopped_s is None:
            self._kick(now)
        if self._waiting and (news or self._fault is not None):
            self._waiting = [waiting for waiting in self._waiting if not self._answered(waiting, sample)]
        late = [waiting for waiting in self._waiting if now > waiting.deadline_s]
        for waiting in late:
            self._waiting.remove(waiting)
            self._answer({"id": waiting.request, "error": "timeout", "text": "it did not come to rest in time"})

    def _notice(self, sample: _Sample, now: float) -> None:
        """Faults are remembered even if a person takes them back before anybody asks."""
        if self._fault is not None:
            return
        with suppress(Refusal):
            self._ready(sample)
            # a packet of the other stream tells whether this one is only older
            if sample.program == "PLAYING" or self._halted or self._control.isProgramRunning():
                self._stopped_s = None
            elif self._stopped_s is None:
                self._stopped_s = now
            elif now - self._stopped_s > _HALT_WITHIN_S:
                raise self._program_stopped()

    def _program_stopped(self) -> Refusal:
        text = "its program was stopped: on the pendant, or because this computer fell silent for too long"
        return self._remember(Refusal("failed", text))

    def _follow(self, motion: _Motion, sample: _Sample, now: float) -> None:
        """See whether a motion has ended."""
        status = self._control.getAsyncOperationProgressEx()
        if status.operationId() != motion.number_before:
            if not status.isAsyncOperationRunning():
                motion.under_way, motion.ended_s = False, now
                self._rests_since = None  # it may have rested before it began, in positions that are only late
                return
        elif now - motion.began_s > _STARTS_WITHIN_S:
            self._lose("a motion was sent but not begun")
        if max(map(abs, sample.qd)) > _STANDS_RAD_S or now - motion.began_s < _STARTS_WITHIN_S:
            motion.stood_since_s = None
        elif motion.stood_since_s is None:
            motion.stood_since_s = now
        elif now - motion.stood_since_s > _STANDING_S:
            self._lose("the arm stands, but its motion is said to go on")

    def _kick(self, now: float) -> None:
        if self._orphaned or now - self._kicked_s < 0.2 / self._watchdog_hz:
            return
        self._kicked_s = now
        self._control.kickWatchdog()

    def _settle(self, sample: _Sample) -> None:
        """Remember since when the arm rests."""
        first = self._rests_since
        if max(map(abs, sample.qd)) > self._rest.speed:
            self._rests_since = None
        elif first is None or max(abs(a - b) for a, b in zip(sample.q, first.q)) > self._rest.position:
            self._rests_since = sample

    def _answered(self, waiting: _Waiting, sample: _Sample) -> bool:
        """Whether a wait is over; then its answer has been sent."""
        if self._fault is not None:
            self._answer({"id": waiting.request, "error": self._fault.kind, "text": self._fault.text})
            return True
        now = time.monotonic()
        if self._motion is not None and now - self._motion.ended_s < _STREAMS_APART_S:
            return False
        first = self._rests_since
        if first is None or sample.time_s - first.time_s < self._rest.dwell_s:
            return False
        if self._motion is not None and now - self._motion.ended_s < _CUT_SHORT_S and self._off(sample) > _AT_GOAL_RAD:
            return False
        self._rests(waiting, sample)
        return True

    def _off(self, sample: _Sample) -> float:
        """How far the arm is from the goal of its motion [rad]."""
        assert self._motion is not None
        return max(abs(a - b) for a, b in zip(sample.q, self._motion.goal))

    def _rests(self, waiting: _Waiting, sample: _Sample) -> None:
        if self._motion is not None:
            off = self._off(sample)
            self._motion = None
            if off > _AT_GOAL_RAD:
                text = f"its motion was cut short: it rests {math.degrees(off):.2f} deg from where it was sent"
                self._answer({"id": waiting.request, "error": "failed", "text": self._remember(_failed(text)).text})
                return
        self._answer({"id": waiting.request, "ok": {**sample.as_dict(), "under_way": False, "fault": None}})


def leading(
    here: Sequence[float], goal: Sequence[float], speed: Sequence[float], acceleration: Sequence[float]
) -> tuple[float, float]:
    """Speed and acceleration of the joint with the longest way, such that no joint exceeds its own.

    A UR controller moves all joints in the same time; the others are slower in proportion to their ways.
    """
    ways = [abs(b - a) for a, b in zip(here, goal, strict=True)]
    longest = max(ways)
    if longest == 0.0:
        return min(*speed, MOST_SPEED), min(*acceleration, MOST_ACCELERATION)
    most_speed = min(most * longest / way for most, way in zip(speed, ways, strict=True) if way > 0.0)
    most_acceleration = min(most * longest / way for most, way in zip(acceleration, ways, strict=True) if way > 0.0)
    return min(most_speed, MOST_SPEED), min(most_acceleration, MOST_ACCELERATION)


def _failed(text: str) -> Refusal:
    return Refusal("failed", text)


def _opening(text: str) -> Refusal:
    """Why the client's constructor raised, in our words where they are clearer."""
    if "enable remote control" in text:
        return Refusal("local", "not in remote control; switch the pendant from Local to Remote")
    if "before timeout of 5 seconds" in text:
        return Refusal("timeout", "its control program did not start within 5 s; see what the pendant shows")
    if "already in use" in text:
        return Refusal("failed", "another RTDE client (a fieldbus, another program) holds its inputs; end that")
    return Refusal("link", f"the RTDE client could not connect: {' '.join(text.split())[:200]}")


@contextmanager
def _ends_within(seconds: float) -> Iterator[None]:
    """End the process if the block hangs, even where it holds the interpreter still and the application has gone."""
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def main() -> None:
    """Serve on standard input and output, which the client's own messages must not reach."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the application, which then tells what to do
    requests_in, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 0)
    os.dup2(nowhere, 1)
    faulthandler.enable()
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    worker = Worker(requests, answers)

    def read() -> None:
        for line in requests_in:
            requests.put(json.loads(line))
        worker.orphan()

    threading.Thread(target=read, name="requests", daemon=True).start()
    worker.run()


if __name__ == "__main__":
    main()
