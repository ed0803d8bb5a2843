"""The process that holds one UR arm's RTDE client, so that a crash or hang of that client ends only this process.

``drivers.arms.ur_worker_process`` runs it as ``python -m drivers.arms.ur_worker`` and alone communicates with it.
Messages are JSON, one per line, on standard input and output.

==================================  ====================================================================================
to the worker
``{"id": n, "do": ...}``            a request
``{"brake": true}``                 stop now; no motion until a request ``release`` or ``restart`` that comes later
``{"beat": true}``                  the application is alive
from the worker
``{"id": n, "ok": ...}``            an answer
``{"id": n, "error": kind, ...}``   a refusal with its ``text``; the kinds are the keys of ``drivers.arms.ur.REFUSALS``
``{"doubt": kind, "text": ...}``    a fault, sent before anything else is done about it
``{"lost": text}``                  the last line of a worker that ends itself
``{"beat": [longest, late]}``       the worker looks at the arm; its longest silence towards the watchdog [s], and how
                                    often that exceeded half of the watchdog's period
==================================  ====================================================================================

While all is well, the worker keeps the controller's watchdog from expiring. When the worker ends for any reason, the
controller stops its program by itself. When standard input ends because the application has ended, the worker stops the
program first.

No order of a brake and a motion leaves the arm moving. The thread that reads messages first sets ``braked`` (A), then
stops the program over a connection of its own (B). The main thread looks at ``braked`` before it uploads the program
and before it sends a motion (C), sends it (D), and looks again (E). If C saw it, nothing was sent. If not, C came
before A. Then either D took effect before B, and B stopped it; or D came after B, hence after A, and E sees it and
stops the program again. From A on, the watchdog is not kicked either.
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
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, NoReturn

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_control import Refusal, UrControl, failed
from drivers.arms.ur_links import LOCAL_CONTROL, in_local_control, stop_program
from drivers.arms.ur_motion import Kicks, Motion, RestCriterion, WorkerSample, leading_rates

_TICK_S = 0.008
"""The arm is looked at with 125 Hz, the rate at which its states come."""
_BEAT_EVERY_S = 0.05
_SILENT_S = 0.3
"""The arm's state is unknown if no new one comes for this long."""
_SILENT_TICKS = 10
"""And if the worker has looked this often meanwhile: a process that was not scheduled has not looked."""
_UNHEARD_S = 0.5
_UNHEARD_TICKS = 20
"""An application that says nothing for this long, and this many looks of the worker, hangs or is suspended."""
_STARTS_WITHIN_S = 1.0
_STOP_SEEN_WITHIN_S = 0.05
"""The application sends ``brake`` before it stops the program over another connection. A program that has been seen
stopped for this long without ``brake`` was stopped by something else."""
_STANDING_S = 1.0
"""A motion reported as running while the arm rests for this long is a fault of the link."""
_STREAMS_APART_S = 0.05
"""The end of a motion comes over another connection than positions, which may be older by this much."""
_CUT_SHORT_S = 0.5
"""An arm that rests away from its goal for this long after the end of a motion will not reach it."""
_STANDS_RAD_S = 1e-4
_AT_GOAL_RAD = 2e-3
_STOP_WITHIN_S = 1.0
_BRAKE_WITHIN_S = 0.3
_REST_WITHIN_S = 3.0
_REST_DWELL_S = 0.05
_LOCAL_WITHIN_S = 0.3
_EMERGENCY = ("SYSTEM_EMERGENCY_STOP", "ROBOT_EMERGENCY_STOP")


@dataclass
class SettleRequest:
    """A request to be answered when the arm has settled."""

    request: int
    deadline_s: float


class Worker:
    """Serves requests one after the other; waiting for an arm to settle runs in parallel.

    ``heard``, ``brake``, ``put`` and ``exit_orphaned`` are called by the thread that reads messages.
    """

    def __init__(self, answers: BinaryIO) -> None:
        self._requests: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._answers = answers
        self._writing = threading.Lock()
        self._parent = os.getppid()
        self._host = ""
        self._control: UrControl | None = None
        self._watchdog_hz = 1.0
        self._kicks = Kicks()
        self._brakes = 0  # counted by the reading thread
        self._released = 0  # the number of brakes that are no longer in force
        self._motion: Motion | None = None
        self._cut_short = False
        self._settle_requests: list[SettleRequest] = []
        self._rest = RestCriterion(0.0, 0.0, 0.0)
        self._resting_since: WorkerSample | None = None
        self._fault: Refusal | None = None
        self._halted = False
        self._program_stopped_s: float | None = None  # since when the program is seen stopped without a brake
        self._orphaned = False
        self._beat_s = 0.0
        self._heard_s = time.monotonic()
        self._ticks_unheard = 0
        self._last_time = -1.0
        self._last_news_s = 0.0
        self._ticks_without_news = 0

    # -- the thread that reads messages --------------------------------------------------------------------------------

    def heard(self) -> None:
        """Note that the application is alive."""
        self._heard_s, self._ticks_unheard = time.monotonic(), 0

    def put(self, request: Mapping[str, Any]) -> None:
        """Queue a request. It releases only brakes that came before it."""
        self._requests.put({**request, "brakes": self._brakes})

    def brake(self) -> None:
        """Stop the program now, whatever the main thread does; see the module's text for the order."""
        self._brakes += 1
        self._requests.put(None)
        if self._host:
            with suppress(LinkLost):
                stop_program(self._host, _BRAKE_WITHIN_S)

    def exit_orphaned(self) -> NoReturn:
        """Stop the program and end, because the application has ended."""
        self._orphaned = True  # no more kicks: the watchdog stops the program if the dashboard does not answer
        if self._host:
            with suppress(LinkLost):
                stop_program(self._host, 2.0 * _STOP_WITHIN_S)
        os._exit(0)

    # -- serving -------------------------------------------------------------------------------------------------------

    def run(self) -> NoReturn:
        """Serve until the process ends."""
        self._answer({"hello": os.getpid()})
        while True:
            with suppress(queue.Empty):
                request = self._requests.get(timeout=_TICK_S)
                if request is not None:
                    self._serve(request)
            if self._control is not None:
                self._monitor(self._control)

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
                case "allowed":
                    answer = {"allowed": self._allowed(request)}
                case "release":
                    self._release(request)
                    answer = {}
                case "restart":
                    answer = self._restart(request)
                case other:
                    raise failed(f"no such request: {other}")
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
        """Report, stop the arm over the dashboard, and end before the client can do harm."""
        self._answer({"doubt": "link", "text": text})
        with suppress(LinkLost):
            stop_program(self._host, _STOP_WITHIN_S)
        self._answer({"lost": text})
        os._exit(3)

    # -- requests ------------------------------------------------------------------------------------------------------

    @property
    def braked(self) -> bool:
        """Whether a brake is in force."""
        return self._brakes > self._released

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self._watchdog_hz = float(request["watchdog_hz"])
        self._rest = RestCriterion(*(float(request[key]) for key in ("settle_s", "settle_speed", "settle_position")))
        host = str(request["host"])

        def opening() -> None:
            self._host = host  # from here on a program of this worker may run there

        self._control = control = UrControl.open(host, request["optional"], float(request["timeout_s"]), opening)
        self._last_news_s = time.monotonic()
        self._start_watchdog(control)
        return self._ready_state(control)

    def _ready_state(self, control: UrControl) -> dict[str, Any]:
        """Return the state with the tool centre point, read after the program has started: the program may set both."""
        return {**self._state(), "tcp": control.tcp()}

    def _state(self) -> dict[str, Any]:
        control = self._opened()
        state = self._next_sample(control).as_dict()
        fault = self._fault
        return {
            **state,
            "moving": self._motion is not None and self._motion.running,
            "fault": None if fault is None else {"kind": fault.kind, "text": fault.text},
        }

    def _move(self, request: Mapping[str, Any]) -> dict[str, Any]:
        control = self._opened()
        self._require_no_fault()
        self._require_not_braked()
        if self._motion is not None and self._motion.running:
            raise failed("it is still moving; wait until it rests, or stop it")
        self._motion = None
        sample = self._next_sample(control)
        self._require_ready(sample)
        if self._program_stopped_s is not None:
            raise self._program_stopped()
        if sample.speed > self._rest.speed:
            raise failed("it is still moving; wait until it rests, or stop it")
        if sample.slider_down:
            raise failed("the speed slider is at 0 %; raise it on the pendant")
        goal = request["q"]
        speed, acceleration = leading_rates(sample.q, goal, request["speed"], request["acceleration"])
        self._ensure_program_runs(control, sample)
        number, _ = control.operation()
        self._require_not_braked()
        accepted = control.move(goal, speed, acceleration)
        if self.braked:
            stopped = self._stopped()
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
            raise stopped
        if not accepted:
            self._require_ready(self._next_sample(control))
            raise self._record_fault(failed("the control program did not take the motion"))
        self._check_links(control)  # the client may report success on a link that has just broken
        now = time.monotonic()
        self._kicks.kicked(now)
        self._resting_since, self._cut_short = None, False
        self._motion = Motion(goal, number, now)
        return {}

    def _wait_settled(self, number: int, request: Mapping[str, Any]) -> None:
        self._opened()
        self._settle_requests.append(SettleRequest(number, time.monotonic() + float(request["timeout_s"])))

    def _allowed(self, request: Mapping[str, Any]) -> list[bool]:
        """Return which joint positions the controller's safety configuration allows."""
        control = self._opened()
        self._require_no_fault()
        self._require_not_braked()
        if self._motion is not None and self._motion.running:
            raise failed("it is moving; safety limits can be asked at rest only")
        self._ensure_program_runs(control, self._next_sample(control))
        allowed = []
        for q in request["q"]:
            self._require_not_braked()
            allowed.append(control.within_safety_limits(q))
            self._monitor(control)
        return allowed

    def _release(self, request: Mapping[str, Any]) -> None:
        """Accept motions again after the brakes that came before this request."""
        self._take_brake()
        self._released = int(request["brakes"])

    def _restart(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Release the brakes, start the control program again and return the state with the tool centre point."""
        control = self._opened()
        self._require_no_fault()
        self._wait_at_rest(control)
        self._require_no_fault()
        self._release(request)
        self._ensure_program_runs(control, self._next_sample(control))
        state = self._ready_state(control)
        self._require_no_fault()
        return state

    def _wait_at_rest(self, control: UrControl) -> None:
        deadline, since = time.monotonic() + _REST_WITHIN_S, None
        while True:
            sample = self._next_sample(control)
            if sample.speed > self._rest.speed:
                since = None
            elif since is None:
                since = sample.time_s
            elif sample.time_s - since >= _REST_DWELL_S:
                return
            if time.monotonic() > deadline:
                raise failed(f"it still moves {_REST_WITHIN_S:g} s after it was stopped")
            self._monitor(control)

    # -- the controller ------------------------------------------------------------------------------------------------

    def _opened(self) -> UrControl:
        if self._control is None:
            raise failed("no controller was opened")
        return self._control

    def _start_watchdog(self, control: UrControl) -> None:
        control.set_watchdog(self._watchdog_hz)
        self._kicks.start(time.monotonic(), 1.0 / self._watchdog_hz)

    def _check_links(self, control: UrControl) -> None:
        """End if a link broke: the client would reconnect by itself again and again, and crash in the end."""
        if not control.connected:
            self._exit_link_lost("the RTDE link broke")

    def _sample(self, control: UrControl) -> WorkerSample:
        """Return the newest state."""
        sample = control.sample()
        if not sample.valid:
            self._exit_link_lost("the controller's state is not one of six joints")
        return sample

    def _next_sample(self, control: UrControl) -> WorkerSample:
        """Return the first state that comes after this call."""
        before = control.time_s
        deadline = time.monotonic() + _SILENT_S
        while control.time_s == before:
            self._check_links(control)
            if time.monotonic() > deadline:
                self._exit_link_lost(f"no state came for {_SILENT_S:g} s")
            time.sleep(0.0005)
        return self._sample(control)

    def _require_ready(self, sample: WorkerSample) -> None:
        """Raise and record what keeps the arm from moving."""
        mode = sample.safety_mode
        if mode == "PROTECTIVE_STOP":
            raise self._record_fault(Refusal("protective", "protective stop"))
        if mode in _EMERGENCY:
            raise self._record_fault(Refusal("emergency", "emergency stop"))
        if mode != "NORMAL":
            raise self._record_fault(failed(f"safety mode {mode}"))
        if sample.robot_mode != "RUNNING":
            raise self._record_fault(failed(f"robot mode {sample.robot_mode}, needed is RUNNING"))

    def _require_no_fault(self) -> None:
        if self._fault is not None:
            raise self._fault

    def _require_not_braked(self) -> None:
        if self.braked:
            raise self._stopped()

    def _stopped(self) -> Refusal:
        self._take_brake()
        return Refusal("stopped", "its motion was stopped before the goal")

    def _take_brake(self) -> None:
        """Stop a motion through the control program too, and forget it: its program is being stopped."""
        if not self._halted and self._control is not None:
            self._control.brake()
        if self._motion is not None:
            self._motion, self._cut_short = None, True
        self._halted = True
        self._kicks.end()
        self._program_stopped_s = None
        self._resting_since = None

    def _ensure_program_runs(self, control: UrControl, sample: WorkerSample) -> None:
        """Upload the control program again if it was stopped on purpose."""
        if sample.program == "PLAYING" and not self._halted:
            return
        if sample.program != "STOPPED":
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)

        def meanwhile() -> None:
            self._require_not_braked()
            self._look(control)

        try:
            control.upload(meanwhile)
            self._start_watchdog(control)
        except Refusal as refusal:
            if refusal.kind != "stopped":
                self._record_fault(refusal)
            with suppress(LinkLost):  # an uploaded program may still start
                stop_program(self._host, _STOP_WITHIN_S)
            raise
        self._halted = False

    def _record_fault(self, refusal: Refusal) -> Refusal:
        """Report the first fault, then stop the arm: nothing moves until the application connects again."""
        if self._fault is None:
            self._fault = refusal
            self._answer({"doubt": refusal.kind, "text": refusal.text})
            with suppress(LinkLost):
                stop_program(self._host, _STOP_WITHIN_S)
        self._motion = None
        return self._fault

    def _program_stopped(self) -> Refusal:
        """Record why the control program was stopped by something else than the application."""
        gap_s = self._kicks.expired_before(self._program_stopped_s)
        if gap_s is not None:
            text = (
                f"this computer was silent for {gap_s:.2f} s, so the controller's watchdog"
                f" ({1.0 / self._watchdog_hz:.2f} s) stopped its program"
            )
            return self._record_fault(Refusal("stalled", text))
        fault = self._record_fault(failed("its program was stopped on the pendant"))
        if fault.kind == "failed" and in_local_control(self._host, _LOCAL_WITHIN_S):
            text = f"its program was stopped, and {LOCAL_CONTROL}; switch it to Remote"
            self._fault = fault = Refusal("local", text)
        return fault

    # -- monitoring ----------------------------------------------------------------------------------------------------

    def _monitor(self, control: UrControl) -> None:
        """Check links, faults, motion and rest; keep the watchdog from expiring; answer settle requests."""
        now = time.monotonic()
        sample, news = self._look(control)
        if self.braked and not self._halted:
            self._take_brake()
        self._check_program(control, sample, now)
        self._check_application(now)
        if news:
            self._update_rest(sample)
        if self._motion is not None and self._motion.running:
            self._track_motion(control, self._motion, sample, now)
        if self._may_kick() and self._kicks.due(now):
            self._kicks.kicked(now)
            control.kick_watchdog()
        if self._settle_requests:
            self._answer_settle_requests(sample, now, news)

    def _look(self, control: UrControl) -> tuple[WorkerSample, bool]:
        """Check what can stop an arm at any time; return its newest state, and whether that is new."""
        now = time.monotonic()
        if os.name == "posix" and os.getppid() != self._parent:
            self.exit_orphaned()
        self._check_links(control)
        sample = self._sample(control)
        news = self._is_news(sample, now)
        if self._fault is None:
            with suppress(Refusal):
                self._require_ready(sample)
        if now - self._beat_s >= _BEAT_EVERY_S:
            self._beat_s = now
            self._answer({"beat": [self._kicks.longest_s, self._kicks.late]})
        return sample, news

    def _may_kick(self) -> bool:
        return (
            self._fault is None
            and not (self._halted or self.braked or self._orphaned)
            and self._program_stopped_s is None
        )

    def _is_news(self, sample: WorkerSample, now: float) -> bool:
        """Return whether a sample is new; end if none has come for too long."""
        if sample.time_s != self._last_time:
            self._last_time, self._last_news_s, self._ticks_without_news = sample.time_s, now, 0
            return True
        self._ticks_without_news += 1
        if now - self._last_news_s > _SILENT_S and self._ticks_without_news > _SILENT_TICKS:
            self._exit_link_lost(f"no state came for {_SILENT_S:g} s")
        return False

    def _check_program(self, control: UrControl, sample: WorkerSample, now: float) -> None:
        """Record that something else than the application stopped the program."""
        if self._fault is not None:
            return
        # the control stream shows whether the state stream is only older
        if sample.program == "PLAYING" or self._halted or self.braked or control.program_runs:
            self._program_stopped_s = None
        elif self._program_stopped_s is None:
            self._program_stopped_s = now
        elif now - self._program_stopped_s > _STOP_SEEN_WITHIN_S:
            self._program_stopped()

    def _check_application(self, now: float) -> None:
        """Stop a motion that an application that hangs, or is suspended, no longer watches."""
        self._ticks_unheard += 1
        if self._motion is None or not self._motion.running or self._fault is not None:
            return
        if now - self._heard_s > _UNHEARD_S and self._ticks_unheard > _UNHEARD_TICKS:
            text = f"this program was silent for {_UNHEARD_S:g} s (suspended, or hung), so its worker stopped the arm"
            self._record_fault(Refusal("stalled", text))

    def _track_motion(self, control: UrControl, motion: Motion, sample: WorkerSample, now: float) -> None:
        """Detect the end of a motion; end the process if the client's report contradicts the arm's state."""
        number, running = control.operation()
        if number != motion.number_before:
            if not running:
                motion.running, motion.ended_s = False, now
                self._resting_since = None  # delayed positions from before the motion may have looked like rest
                return
        elif now - motion.began_s > _STARTS_WITHIN_S:
            self._exit_link_lost("a motion was sent but not begun")
        if sample.speed > _STANDS_RAD_S or now - motion.began_s < _STARTS_WITHIN_S or sample.slider_down:
            motion.standing_since_s = None
        elif motion.standing_since_s is None:
            motion.standing_since_s = now
        elif now - motion.standing_since_s > _STANDING_S:
            self._exit_link_lost("the arm rests, but its motion is reported as running")

    def _update_rest(self, sample: WorkerSample) -> None:
        """Track since when the arm rests."""
        first = self._resting_since
        if sample.speed > self._rest.speed:
            self._resting_since = None
        elif first is None or sample.distance(first.q) > self._rest.position:
            self._resting_since = sample

    def _answer_settle_requests(self, sample: WorkerSample, now: float, news: bool) -> None:
        waiting = []
        for item in self._settle_requests:
            answer = self._settled(sample, now, news)
            if answer is None and now > item.deadline_s:
                why = "; the speed slider is at 0 %" if sample.slider_down else ""
                answer = {"error": "timeout", "text": f"it did not come to rest in time{why}"}
            if answer is None:
                waiting.append(item)
            else:
                self._answer({"id": item.request, **answer})
        self._settle_requests = waiting

    def _settled(self, sample: WorkerSample, now: float, news: bool) -> dict[str, Any] | None:
        """Return the answer to a settle request if the arm has settled, was stopped or has a fault; else None."""
        if self._fault is not None:
            return {"error": self._fault.kind, "text": self._fault.text}
        if self._cut_short or self.braked:
            return {"error": "stopped", "text": self._stopped().text}
        motion, first = self._motion, self._resting_since
        ended_for_s = math.inf if motion is None else now - motion.ended_s
        if not news or ended_for_s < _STREAMS_APART_S:
            return None
        if first is None or sample.time_s - first.time_s < self._rest.dwell_s:
            return None
        off = 0.0 if motion is None else sample.distance(motion.goal)
        if off > _AT_GOAL_RAD and ended_for_s < _CUT_SHORT_S:
            return None
        self._motion = None
        if off > _AT_GOAL_RAD:
            fault = self._record_fault(
                failed(f"its motion was cut short: it rests {math.degrees(off):.2f} deg from its goal")
            )
            return {"error": fault.kind, "text": fault.text}
        return {"ok": {**sample.as_dict(), "moving": False, "fault": None}}


def _raise_priority() -> None:
    """Run before other programs where that is allowed, so that the watchdog is kicked in time.

    Not with real-time priority: the client busy-waits, which would keep a small computer from everything else.
    """
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, -10)


def main() -> None:
    """Serve on standard input and output, kept free of the RTDE client's own messages."""
    _raise_priority()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the application
    messages, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    devnull = os.open(os.devnull, os.O_RDWR)
    os.dup2(devnull, 0)
    os.dup2(devnull, 1)
    faulthandler.enable()
    worker = Worker(answers)

    def read() -> None:
        for line in messages:
            worker.heard()
            message = json.loads(line)
            if "brake" in message:
                worker.brake()
            elif "do" in message:
                worker.put(message)
        worker.exit_orphaned()

    threading.Thread(target=read, name="messages", daemon=True).start()
    worker.run()


if __name__ == "__main__":
    main()
