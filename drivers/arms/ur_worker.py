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
``{"id": n, "error": kind, ...}``   a refusal: a key of ``drivers.arms.ur_supervised_link.REFUSALS``, and its ``text``
``{"fault": kind, "text": ...}``    a fault, sent before anything else is done about it
``{"decelerating": true}``          the control program decelerates the motion, or there was none
``{"lost": text, "kind": kind}``    the last line of a worker that ends itself
``{"waits": ...}``                  how long it has asked the controller for something without an answer [s]
``{"opening": true}``               from now on a program of this worker may start; false: it was seen to run
``{"beat": [...]}``                 the worker looks at the arm; its longest silence towards the watchdog [s], how often
                                    that exceeded half of the watchdog's period, age of the arm's newest state [s],
                                    whether the arm moves, and the number of the last request served
==================================  ====================================================================================

While all is well, the worker keeps the controller's watchdog from expiring. When the worker ends for any reason, the
controller stops its program by itself. When standard input ends because the application has ended, the worker stops the
program first.

No order of a brake and a motion leaves the arm moving. The thread that reads messages first sets ``braked`` (A), then
stops the program over a connection of its own (B), a little later so that the control program can decelerate the motion
harder than the end of a program does. The main thread looks at ``braked`` before it uploads the program
and before it sends a motion (C), sends it (D), and looks again (E). If C saw it, nothing was sent. If not, C came
before A. Then either D took effect before B, and B stopped it; or D came after B, hence after A, and E sees it and
stops the program again. From A on, the watchdog is not kicked either.
"""

from __future__ import annotations

import faulthandler
import json
import os
import queue
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, BinaryIO, NoReturn

from drivers.arms.protocol import LinkLost, LiveArm
from drivers.arms.ur_control import Refusal, UrControl, failed
from drivers.arms.ur_links import printable, stop_program
from drivers.arms.ur_motion import DECELERATES_WITHIN_S, Kicks, RestCriterion
from drivers.arms.ur_path_supervisor import PathSupervisor
from drivers.priority import run_first

_TICK_S = 0.008
"""Period of the looks at the arm: 125 Hz, the rate at which its states arrive."""
_BEAT_EVERY_S = 0.05
_UNHEARD_S = 0.5
_UNHEARD_LOOKS = 20
"""An application hangs or is suspended if it sends nothing for ``_UNHEARD_S`` and this many looks of the worker. Then
the arm needs a person, also at rest: what the application would do next was decided before."""
_WAITS_S = 0.1
_STOP_WITHIN_S = 1.0
_BRAKE_WITHIN_S = 0.3
_BRAKE_READ_S = 0.002
_NICENESS = -10
"""Priority of this process where it is allowed, so that the watchdog is kicked in time. Not real-time priority: the
client busy-waits and would block everything else on a small computer."""


class Worker:
    """Server of requests, one after the other; waiting for an arm to settle runs in parallel.

    ``received``, ``brake`` and ``exit_orphaned`` are called by the thread that reads messages.
    """

    def __init__(self, answers: BinaryIO) -> None:
        self._requests: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._answers = answers
        self._writing = threading.Lock()
        self._parent = os.getppid()
        self._host = ""
        self._supervisor: PathSupervisor | None = None
        self._brakes = 0  # counted by the reading thread
        self._released = 0  # number of brakes that are no longer in force
        self._decelerating = threading.Event()
        self._beat_s = 0.0
        self._served = 0
        self._heard_s = time.monotonic()
        self._looks_unheard = 0

    # -- the thread that reads messages --------------------------------------------------------------------------------

    def received(self, message: Mapping[str, Any]) -> None:
        """Handle a message. A request releases only brakes that came before it."""
        self._heard_s, self._looks_unheard = time.monotonic(), 0
        if "brake" in message:
            self.brake()
        elif "do" in message:
            self._requests.put({**message, "brakes": self._brakes})
        elif self._supervisor is not None and (waits_s := self._supervisor.waits_s) > _WAITS_S:
            self.answer({"waits": waits_s})

    def brake(self) -> None:
        """Stop the program now, whatever the main thread does; the module docstring explains the order."""
        self._decelerating.clear()
        self._brakes += 1
        self._requests.put(None)
        self._decelerating.wait(DECELERATES_WITHIN_S)
        if self._host:
            with suppress(LinkLost):
                stop_program(self._host, _BRAKE_WITHIN_S)

    def exit_orphaned(self) -> NoReturn:
        """Stop the program and end the process, because the application has ended."""
        self._brakes += 1  # no more kicks: the watchdog stops the program even if the dashboard does not answer
        if self._host:
            with suppress(LinkLost):
                stop_program(self._host, 2.0 * _STOP_WITHIN_S)
        os._exit(0)

    # -- the application, for the supervisor ---------------------------------------------------------------------------

    @property
    def braked(self) -> bool:
        """Whether a brake is in force."""
        return self._brakes > self._released

    def answer(self, message: Mapping[str, Any]) -> None:
        """Send a message."""
        line = json.dumps(message).encode("ascii") + b"\n"
        with self._writing:
            try:
                self._answers.write(line)
                self._answers.flush()
            except OSError:  # the application has ended
                self.exit_orphaned()

    def opening(self, may_start: bool) -> None:
        """Tell that a program may start from now on, or that it was seen to run."""
        self.answer({"opening": may_start})

    def check(self, kicks: Kicks, live: LiveArm) -> str:
        """Exchange heartbeats; return why the application no longer watches its arm, else empty."""
        now = time.monotonic()
        if os.name == "posix" and os.getppid() != self._parent:
            self.exit_orphaned()
        if now - self._beat_s >= _BEAT_EVERY_S:
            self._beat_s = now
            self.answer({"beat": [kicks.longest_s, kicks.late, live.age_s, live.moving, self._served]})
        self._looks_unheard += 1
        if now - self._heard_s > _UNHEARD_S and self._looks_unheard > _UNHEARD_LOOKS:
            return f"this program was silent for {_UNHEARD_S:g} s (suspended, or hung), so its worker stopped the arm"
        return ""

    def exit_link_lost(self, kind: str, text: str) -> NoReturn:
        """Report, stop the arm over the dashboard, and end the process before the client can do harm."""
        self.answer({"fault": kind, "text": text})
        with suppress(LinkLost):
            stop_program(self._host, _STOP_WITHIN_S)
        self.answer({"lost": text, "kind": kind})
        os._exit(3)

    # -- serving -------------------------------------------------------------------------------------------------------

    def run(self) -> NoReturn:
        """Serve until the process ends."""
        self.answer({"hello": os.getpid()})
        while True:
            try:
                self._round()
            except (RuntimeError, ValueError) as error:  # the client raises these if its link breaks during a call
                self.exit_link_lost("link", f"its RTDE client failed ({printable(str(error))})")

    def _round(self) -> None:
        supervisor = self._supervisor
        with suppress(queue.Empty):
            request = self._requests.get(timeout=min(_TICK_S, supervisor.patience_s if supervisor else _TICK_S))
            if request is not None:
                self._serve(request)
        if self._supervisor is not None:
            self._supervisor.stream()
            self._supervisor.monitor()
        if self.braked and not self._decelerating.is_set():
            self._decelerating.set()
            self.answer({"decelerating": True})

    def _serve(self, request: Mapping[str, Any]) -> None:
        try:
            answer = self._result(request)
        except Refusal as refusal:
            self.answer({"id": request["id"], "error": refusal.kind, "text": refusal.text})
        else:
            if answer is not None:
                self.answer({"id": request["id"], "ok": answer})
        self._served = int(request["id"])

    def _result(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Execute a request and return its answer; None if the answer comes later. Raises ``Refusal``."""
        if request["do"] == "open":
            return self._open(request)
        supervisor = self._supervisor
        if supervisor is None:
            raise failed("no controller was opened")
        match request["do"]:
            case "state" | "confirm" | "end_path" | "reached" as question:
                return dict(getattr(supervisor, question)())
            case "move" | "path" | "allowed" as order:
                return dict(getattr(supervisor, order)(request))
            case "settled":
                supervisor.wait_settled(int(request["id"]), float(request["timeout_s"]))
                return None
            case "release":
                released = supervisor.release()
                self._released = int(request["brakes"])
                return released
            case "restart":
                supervisor.require_restartable()
                self._released = int(request["brakes"])
                return supervisor.restart()
            case other:
                raise failed(f"no such request: {other}")

    def _open(self, request: Mapping[str, Any]) -> dict[str, Any]:
        rest = RestCriterion(*(float(request[key]) for key in ("settle_s", "settle_speed", "settle_position")))
        host, version = str(request["host"]), (int(request["version"][0]), int(request["version"][1]))
        timeout_s = float(request["timeout_s"])
        control = UrControl.open(host, request["optional"], timeout_s, str(request["program"]), version)

        def meanwhile() -> None:
            if self.braked:
                raise Refusal("stopped", "it was stopped while it was being connected")

        time.sleep(_BRAKE_READ_S)  # the client has held the interpreter's lock: a brake may be unread
        self._host = host  # from here on a program of this worker may run on that host
        supervisor = PathSupervisor(self, control, float(request["watchdog_hz"]), rest)
        try:
            control.upload(meanwhile, self.opening)
            state = supervisor.begin()
        except Refusal as refusal:  # a controller may accept only the client's own name
            if refusal.kind not in ("timeout", "failed"):
                raise
            control.rename()
            if control.program_runs:
                with suppress(LinkLost):
                    stop_program(host, _STOP_WITHIN_S)
            control.upload(meanwhile, self.opening)
            state = supervisor.begin()
        self._supervisor = supervisor
        return state


def main() -> None:
    """Serve on standard input and output; keep the RTDE client's own messages out of them."""
    run_first(_NICENESS)
    for name in ("SIGINT", "SIGTSTP", "SIGHUP"):  # sent to all processes of a terminal; the application handles them
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    messages, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    devnull = os.open(os.devnull, os.O_RDWR)
    os.dup2(devnull, 0)
    os.dup2(devnull, 1)
    faulthandler.enable()
    worker = Worker(answers)

    def read() -> None:
        for line in messages:
            worker.received(json.loads(line))
        worker.exit_orphaned()

    threading.Thread(target=read, name="messages", daemon=True).start()
    worker.run()


if __name__ == "__main__":
    main()
