"""The process that holds one UR arm's RTDE client, so that a crash or hang of that client ends only this process.

``drivers.arms.ur_worker_process`` runs it as ``python -m drivers.arms.ur_worker`` and alone communicates with it.
Requests and answers are JSON, one per line, on standard input and output. A request is ``{"id": n, "do": ...}``, its
answer ``{"id": n, "ok": ...}`` or ``{"id": n, "error": kind, "text": ...}``; the kinds are the keys of
``drivers.arms.ur.REFUSALS``.

While all is well, the worker keeps the controller's watchdog from expiring. When the worker ends for any reason, the
controller stops its program by itself. When standard input ends because the application has ended, the worker stops the
program first.
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
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, NoReturn

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_links import stop_program
from drivers.arms.ur_motion import Motion, RestCriterion, WorkerSample, leading_rates, read_worker_sample

_TICK_S = 0.008
_IDLE_TICK_S = 0.02
_FREQUENCY_HZ = 125.0
_SILENT_S = 0.5
"""The link counts as lost if no new state comes for this long."""
_SILENT_TICKS = 10
"""And if the worker has looked this often meanwhile: a process that was not scheduled has not looked."""
_STARTS_WITHIN_S = 1.0
_PROGRAM_WITHIN_S = 5.0
_HALT_WITHIN_S = 0.25
"""The application stops the program over another connection, then sends ``halt``. A stop that is not followed by
``halt`` within this time is a fault."""
_STANDING_S = 1.0
"""A motion reported as running while the arm rests for this long is a fault of the link."""
_STREAMS_APART_S = 0.05
"""The end of a motion comes over another connection than positions, which may be older by this much."""
_CUT_SHORT_S = 0.5
"""An arm that rests away from its goal for this long after the end of a motion will not reach it."""
_STANDS_RAD_S = 1e-4
_AT_GOAL_RAD = 2e-3
_STOP_WITHIN_S = 1.0
_VARIABLES = ("timestamp", "actual_q", "actual_qd", "joint_temperatures", "robot_mode", "safety_mode", "runtime_state")
_EMERGENCY = ("SYSTEM_EMERGENCY_STOP", "ROBOT_EMERGENCY_STOP")


class Refusal(Exception):
    """A request that cannot be served: its kind and a sentence."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


@dataclass
class SettleRequest:
    """A request to be answered when the arm has settled."""

    request: int
    deadline_s: float


class Worker:
    """Serves requests one after the other; waiting for an arm to settle runs in parallel."""

    def __init__(self, requests: queue.SimpleQueue[dict[str, Any]], answers: BinaryIO) -> None:
        self._requests, self._answers = requests, answers
        self._writing = threading.Lock()
        self._parent = os.getppid()
        self._host = ""
        self._watchdog_hz = 0.0
        self._payload = False
        self._control: Any = None
        self._receive: Any = None
        self._motion: Motion | None = None
        self._settle_requests: list[SettleRequest] = []
        self._rest = RestCriterion(0.0, 0.0, 0.0)
        self._resting_since: WorkerSample | None = None
        self._fault: Refusal | None = None
        self._halted = False
        self._program_stopped_s: float | None = None  # since when the program is seen stopped without a halt
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
            tick = _TICK_S if self._motion is not None or self._settle_requests else _IDLE_TICK_S
            with suppress(queue.Empty):
                self._serve(self._requests.get(timeout=tick))
            if self._control is not None:
                self._monitor()

    def exit_orphaned(self) -> NoReturn:
        """Stop the program and end, because the application has ended. Called by the thread that reads requests."""
        self._orphaned = True  # no more kicks: the watchdog stops the program if the dashboard does not answer
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
                    self._wait_settled(number, request)
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
            except OSError:  # the application has ended
                self.exit_orphaned()

    def _exit_link_lost(self, text: str) -> NoReturn:
        """Stop the arm over the dashboard, report, and end before the client can do harm."""
        with suppress(LinkLost):
            stop_program(self._host, _STOP_WITHIN_S)
        self._answer({"lost": text})
        os._exit(3)

    # -- requests ------------------------------------------------------------------------------------------------------

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        host, self._payload = str(request["host"]), bool(request["payload"])
        variables = [*_VARIABLES, "payload"] if self._payload else [*_VARIABLES]
        self._watchdog_hz = float(request["watchdog_hz"])
        self._rest = RestCriterion(*(float(request[key]) for key in ("settle_s", "settle_speed", "settle_position")))
        # the constructors hold the interpreter's lock, so no thread of this process could end one that hangs
        with _exit_after(float(request["timeout_s"])):
            try:
                receive = RTDEReceiveInterface(host, _FREQUENCY_HZ, variables)
                if not receive.isConnected():
                    raise Refusal("link", "the controller accepts RTDE connections but sends no state")
                self._host = host  # from here on a program of this worker may run there
                control = RTDEControlInterface(host)
            except RuntimeError as error:
                raise _open_refusal(str(error)) from error
            self._receive, self._control = receive, control
            self._last_news_s = time.monotonic()
            self._start_watchdog()
        return self._state()

    def _state(self) -> dict[str, Any]:
        self._require_open()
        state = self._next_sample().as_dict()
        fault = self._fault
        return {
            **state,
            "moving": self._motion is not None and self._motion.running,
            "fault": None if fault is None else {"kind": fault.kind, "text": fault.text},
        }

    def _move(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self._require_open()
        if self._fault is not None:
            raise self._fault
        if self._motion is not None and self._motion.running:
            raise _failed("it is still moving; wait until it rests, or stop it")
        self._motion = None
        sample = self._next_sample()
        self._require_ready(sample)
        if self._program_stopped_s is not None:
            raise self._program_stopped()
        if sample.speed > self._rest.speed:
            raise _failed("it is still moving; wait until it rests, or stop it")
        goal = request["q"]
        speed, acceleration = leading_rates(sample.q, goal, request["speed"], request["acceleration"])
        with _exit_after(float(request["timeout_s"])):
            self._ensure_program_runs(sample)
            number = self._control.getAsyncOperationProgressEx().operationId()
            try:
                accepted = self._control.moveJ(goal, speed, acceleration, True)
            except (RuntimeError, ValueError) as error:
                raise _failed(f"the RTDE client refused the motion: {error}") from error
            if not accepted:
                self._require_ready(self._next_sample())
                raise self._record_fault(_failed("the control program did not take the motion"))
        self._check_links()  # the client may report success on a link that has just broken
        self._kicked_s = time.monotonic()
        self._resting_since = None
        self._motion = Motion(goal, number, self._kicked_s)
        return {}

    def _wait_settled(self, number: int, request: Mapping[str, Any]) -> None:
        self._require_open()
        self._settle_requests.append(SettleRequest(number, time.monotonic() + float(request["timeout_s"])))

    def _halt(self) -> None:
        """Forget the motion: the application has stopped the program itself."""
        self._require_open()
        self._motion = None
        self._halted = True
        self._program_stopped_s = None
        self._resting_since = None

    # -- the controller ------------------------------------------------------------------------------------------------

    def _require_open(self) -> None:
        if self._control is None:
            raise _failed("no controller was opened")

    def _start_watchdog(self) -> None:
        if not self._control.setWatchdog(self._watchdog_hz):
            raise _failed("the control program does not respond (it refused the watchdog)")
        self._kicked_s = time.monotonic()

    def _check_links(self) -> None:
        """End if a link broke: the client would reconnect by itself again and again, and crash in the end."""
        if not (self._control.isConnected() and self._receive.isConnected()):
            self._exit_link_lost("the RTDE link broke")

    def _sample(self) -> WorkerSample:
        """Return the newest state."""
        sample = read_worker_sample(self._receive, payload=self._payload)
        if not sample.valid:
            self._exit_link_lost("the controller's state is not one of six joints")
        return sample

    def _next_sample(self) -> WorkerSample:
        """Return the first state that comes after this call."""
        before = self._receive.getTimestamp()
        deadline = time.monotonic() + _SILENT_S
        while self._receive.getTimestamp() == before:
            self._check_links()
            if time.monotonic() > deadline:
                self._exit_link_lost(f"no state came for {_SILENT_S:g} s")
            time.sleep(0.0005)
        return self._sample()

    def _require_ready(self, sample: WorkerSample) -> None:
        """Raise and record what keeps the arm from moving."""
        mode = sample.safety_mode
        if mode == "PROTECTIVE_STOP":
            raise self._record_fault(Refusal("protective", "protective stop"))
        if mode in _EMERGENCY:
            raise self._record_fault(Refusal("emergency", "emergency stop"))
        if mode != "NORMAL":
            raise self._record_fault(_failed(f"safety mode {mode}"))
        if sample.robot_mode != "RUNNING":
            raise self._record_fault(_failed(f"robot mode {sample.robot_mode}, needed is RUNNING"))

    def _ensure_program_runs(self, sample: WorkerSample) -> None:
        """Upload the control program again if it was stopped on purpose."""
        if sample.program == "PLAYING" and not self._halted:
            return
        if sample.program != "STOPPED":
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
        deadline = time.monotonic() + _PROGRAM_WITHIN_S
        while self._control.isProgramRunning():  # the client learns of a stop one period later than the state
            if time.monotonic() > deadline:
                raise self._record_fault(_failed("the control program was stopped but still runs"))
            time.sleep(0.002)
        try:
            self._control.reuploadScript()
        except RuntimeError as error:
            raise self._record_fault(_failed(f"the control program could not be uploaded again: {error}")) from error
        while not self._control.isProgramRunning():
            if time.monotonic() > deadline:
                text = f"the control program did not start within {_PROGRAM_WITHIN_S:g} s"
                raise self._record_fault(Refusal("timeout", text))
            time.sleep(0.002)
        self._halted = False
        self._start_watchdog()

    def _record_fault(self, refusal: Refusal) -> Refusal:
        """Record the first fault and stop the arm: nothing moves until the application connects again."""
        if self._fault is None:
            self._fault = refusal
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
        self._motion = None
        return refusal

    def _program_stopped(self) -> Refusal:
        text = "its program was stopped: on the pendant, or because this computer was silent for too long"
        return self._record_fault(_failed(text))

    # -- monitoring ----------------------------------------------------------------------------------------------------

    def _monitor(self) -> None:
        """Check links, faults, motion and rest; called about a hundred times a second."""
        now = time.monotonic()
        if os.name == "posix" and os.getppid() != self._parent:
            self.exit_orphaned()
        self._check_links()
        sample = self._sample()
        news = self._is_news(sample, now)
        self._check_faults(sample, now)
        if news:
            self._update_rest(sample)
        if self._motion is not None and self._motion.running:
            self._track_motion(self._motion, sample, now)
        if self._fault is None and not self._halted and self._program_stopped_s is None:
            self._kick_watchdog(now)
        if self._settle_requests and (news or self._fault is not None):
            self._settle_requests = [item for item in self._settle_requests if not self._answer_settled(item, sample)]
        for item in [item for item in self._settle_requests if now > item.deadline_s]:
            self._settle_requests.remove(item)
            self._answer({"id": item.request, "error": "timeout", "text": "it did not come to rest in time"})

    def _is_news(self, sample: WorkerSample, now: float) -> bool:
        """Return whether a sample is new; end if none has come for too long."""
        if sample.time_s != self._last_time:
            self._last_time, self._last_news_s, self._ticks_without_news = sample.time_s, now, 0
            return True
        self._ticks_without_news += 1
        if now - self._last_news_s > _SILENT_S and self._ticks_without_news > _SILENT_TICKS:
            self._exit_link_lost(f"no state came for {_SILENT_S:g} s")
        return False

    def _check_faults(self, sample: WorkerSample, now: float) -> None:
        """Record a fault, even if it is cleared on the pendant before the application polls."""
        if self._fault is not None:
            return
        with suppress(Refusal):
            self._require_ready(sample)
            # the control stream shows whether the state stream is only older
            if sample.program == "PLAYING" or self._halted or self._control.isProgramRunning():
                self._program_stopped_s = None
            elif self._program_stopped_s is None:
                self._program_stopped_s = now
            elif now - self._program_stopped_s > _HALT_WITHIN_S:
                raise self._program_stopped()

    def _track_motion(self, motion: Motion, sample: WorkerSample, now: float) -> None:
        """Detect the end of a motion; end the process if the client's report contradicts the arm's state."""
        status = self._control.getAsyncOperationProgressEx()
        if status.operationId() != motion.number_before:
            if not status.isAsyncOperationRunning():
                motion.running, motion.ended_s = False, now
                self._resting_since = None  # delayed positions from before the motion may have looked like rest
                return
        elif now - motion.began_s > _STARTS_WITHIN_S:
            self._exit_link_lost("a motion was sent but not begun")
        if sample.speed > _STANDS_RAD_S or now - motion.began_s < _STARTS_WITHIN_S:
            motion.standing_since_s = None
        elif motion.standing_since_s is None:
            motion.standing_since_s = now
        elif now - motion.standing_since_s > _STANDING_S:
            self._exit_link_lost("the arm rests, but its motion is reported as running")

    def _kick_watchdog(self, now: float) -> None:
        if self._orphaned or now - self._kicked_s < 0.2 / self._watchdog_hz:
            return
        self._kicked_s = now
        self._control.kickWatchdog()

    def _update_rest(self, sample: WorkerSample) -> None:
        """Track since when the arm rests."""
        first = self._resting_since
        if sample.speed > self._rest.speed:
            self._resting_since = None
        elif first is None or sample.distance(first.q) > self._rest.position:
            self._resting_since = sample

    def _answer_settled(self, item: SettleRequest, sample: WorkerSample) -> bool:
        """Answer a settle request if the arm has settled or has a fault; return whether it was answered."""
        if self._fault is not None:
            self._answer({"id": item.request, "error": self._fault.kind, "text": self._fault.text})
            return True
        motion, first, now = self._motion, self._resting_since, time.monotonic()
        ended_for_s = math.inf if motion is None else now - motion.ended_s
        if ended_for_s < _STREAMS_APART_S:
            return False
        if first is None or sample.time_s - first.time_s < self._rest.dwell_s:
            return False
        off = 0.0 if motion is None else sample.distance(motion.goal)
        if off > _AT_GOAL_RAD and ended_for_s < _CUT_SHORT_S:
            return False
        self._motion = None
        if off > _AT_GOAL_RAD:
            text = f"its motion was cut short: it rests {math.degrees(off):.2f} deg from its goal"
            self._answer({"id": item.request, "error": "failed", "text": self._record_fault(_failed(text)).text})
        else:
            self._answer({"id": item.request, "ok": {**sample.as_dict(), "moving": False, "fault": None}})
        return True


def _failed(text: str) -> Refusal:
    return Refusal("failed", text)


def _open_refusal(text: str) -> Refusal:
    """Return why the RTDE client's constructor raised, reworded where its text is unclear."""
    if "enable remote control" in text:
        return Refusal("local", "not in remote control; switch the pendant from Local to Remote")
    if "before timeout of 5 seconds" in text:
        return Refusal("timeout", "its control program did not start within 5 s; see what the pendant shows")
    if "already in use" in text:
        return _failed("another RTDE client (a fieldbus, another program) holds its inputs; end that")
    return Refusal("link", f"the RTDE client could not connect: {' '.join(text.split())[:200]}")


@contextmanager
def _exit_after(seconds: float) -> Iterator[None]:
    """End the process if the block hangs, even while it holds the interpreter's lock."""
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def main() -> None:
    """Serve on standard input and output, kept free of the RTDE client's own messages."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the application
    requests_in, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    devnull = os.open(os.devnull, os.O_RDWR)
    os.dup2(devnull, 0)
    os.dup2(devnull, 1)
    faulthandler.enable()
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    worker = Worker(requests, answers)

    def read() -> None:
        for line in requests_in:
            requests.put(json.loads(line))
        worker.exit_orphaned()

    threading.Thread(target=read, name="requests", daemon=True).start()
    worker.run()


if __name__ == "__main__":
    main()
