"""The links of one UR arm, its worker process and its dashboard connection, for queries, motions and stops.

On any fault, in this order: the listener is called, the worker process is killed, a stop is requested over a separate
dashboard connection, and the arm is monitored over a separate RTDE connection until it rests.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import numpy as np

from drivers.arms.protocol import (
    ArmError,
    ArmState,
    ArmTimeout,
    EmergencyStop,
    FaultListener,
    HostStalled,
    LinkLost,
    LiveArm,
    MotionStopped,
    NotInRemoteControl,
    ProtectiveStop,
)
from drivers.arms.ur_checks import JOINTS
from drivers.arms.ur_control import Refusal
from drivers.arms.ur_links import DASHBOARD_PORT, RTDE_PORT, Connection, Dashboard, cause, require_stopped, stop_program
from drivers.arms.ur_options import UrOptions
from drivers.arms.ur_rtde_reader import not_ready, samples, wait_at_rest
from drivers.arms.ur_worker_process import HeartbeatGaps, WorkerGone, WorkerProcess
from drivers.patience import SLICE_S, Patience, patient_get

ANSWER_WITHIN_S = 2.0
CONFIRM_WITHIN_S = 0.3
_MESSAGE_WITHIN_S = 0.3
"""A worker that accepts no message for this long hangs."""


class SupervisedLink:
    """Base of one UR arm's driver: stops, faults, and calls to the worker."""

    def __init__(self, name: str, settings: UrOptions, rest_s: float) -> None:
        self._name = name
        self._host = settings.host
        self._settings = settings
        self._worker: WorkerProcess | None = None
        self._connecting: WorkerProcess | None = None
        """The worker during ``connect``, while it may start a program on the controller; else None."""
        self._stop_line = StopLine(settings.host, self._dashboard_lost)
        self._program = OwnProgram(settings.host, rest_s)
        self._fault: ArmError | None = None
        self._gaps = HeartbeatGaps()
        self._latch = StopLatch()
        self._first_fault = FirstFault()

    @property
    def name(self) -> str:
        """The arm's name in the profile."""
        return self._name

    def watch(self, listener: FaultListener) -> None:
        """Report the first fault after each ``connect`` to ``listener``, from a thread of this driver."""
        self._first_fault.watch(listener)

    def live(self) -> LiveArm:
        """Return the worker's last report, at most 0.05 s old in normal operation."""
        worker = self._worker
        return LiveArm(math.inf, self._program.may_run) if worker is None else worker.live

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker, for tests that kill it; None without one."""
        worker = self._worker
        return None if worker is None else worker.pid

    def confirm(self) -> None:
        """Query the dashboard, then the worker; the worker checks the arm's state and whether its control program runs.

        Raises ``LinkLost``, or the arm's fault; the listener has been told.
        """
        noted, worker = self._first_fault.error, self._worker
        if worker is None:
            raise self._without_worker()
        if noted is not None:
            raise type(noted)(*noted.args)
        patience = Patience(CONFIRM_WITHIN_S)
        try:
            self._stop_line.confirm(patience)
        except LinkLost as error:
            raise self._dashboard_lost(cause(error)) from error
        try:
            fault = worker.call("confirm", patience.remaining_s)["fault"]
        except WorkerGone as error:
            raise self._report_fault(error.kind, str(error)) from error
        except Refusal as error:
            raise arm_error(self._name, error.kind, error.text) from error
        if fault is not None:
            raise arm_error(self._name, fault["kind"], fault["text"])

    # -- stopping ------------------------------------------------------------------------------------------------------

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``; a ``connect`` in progress starts nothing more on the controller.

        Tell the worker to brake if that needs no waiting.
        """
        self._refuse()
        worker = self._worker
        if worker is not None:
            worker.tell_at_once()

    def _refuse(self) -> None:
        self._latch.refuse()
        connecting = self._connecting
        if connecting is not None:
            connecting.abandon()

    def brake(self) -> None:
        """Stop at full deceleration; return within about 20 ms, or within 0.4 s if the dashboard does not answer.

        Raises ``LinkLost`` if the controller did not confirm the stop; the worker no longer kicks its watchdog then.
        """
        self._refuse()
        with self._latch.stopping():
            try:
                self._command_stop()
            except LinkLost as error:
                raise LinkLost(
                    f"arm {self._name}: its stop was not confirmed: {cause(error)}; its watchdog stops it after"
                    f" {1.0 / self._settings.watchdog_hz:.1f} s, but treat it as moving until you see it at rest"
                ) from error

    def stop(self) -> None:
        """Stop the controller's program and wait until the arm rests; harmless if no program of this driver runs.

        Raises ``LinkLost`` if the arm could not be reached or seen; its watchdog then stops it.
        """
        if not self._program.may_run:
            return
        with self._latch.stopping():
            worker = self._worker
            if worker is None or worker.has_ended:
                self._drop_worker()
                self._require_rest()
                return
            try:
                self._command_stop()
                self._program.wait_at_rest()
                with suppress(MotionStopped):
                    worker.call("release", ANSWER_WITHIN_S, self._require_last_stop)
            except (LinkLost, WorkerGone, Refusal) as error:
                kind = error.kind if isinstance(error, WorkerGone) else "link"
                why = cause(error) if isinstance(error, LinkLost) else str(error)
                noted = self._link_fault(f"the stop failed: {why}", kind)
                if self._program.may_run:  # otherwise it was seen at rest, and the next call reports the lost link
                    raise noted from error

    def _command_stop(self) -> None:
        """Stop the arm by all means; wait until the dashboard confirms. Raises ``LinkLost`` without the arm's name."""
        worker = self._worker
        # before the dashboard stop, which the worker must not take for a stop by somebody else
        informed = worker is None or worker.brake()
        if not self._program.may_run:
            return
        try:
            self._stop_line.stop()
        finally:
            if worker is not None and not informed and not worker.brake(_MESSAGE_WITHIN_S):
                worker.kill_at_once()  # a living worker would keep the watchdog from expiring

    def _require_not_braked(self) -> None:
        if self._latch.in_force:
            raise arm_error(self._name, "stopped", "it was stopped")

    def _require_last_stop(self) -> None:
        """Raise ``MotionStopped`` if a brake is in force or another stop is under way."""
        self._require_not_braked()
        if self._latch.stops > 1:
            raise arm_error(self._name, "stopped", "it is being stopped")

    def _require_rest(self, *, look: Callable[[], None] | None = None) -> None:
        """Bring the arm to rest. Raises ``LinkLost`` with the arm's name."""
        try:
            self._program.bring_to_rest(look=look)
        except LinkLost as error:
            text = f"its stop was not confirmed: {cause(error)}; treat it as moving until you see it at rest"
            raise LinkLost(f"arm {self._name}: {text}") from error

    # -- faults --------------------------------------------------------------------------------------------------------

    def _report_fault(self, kind: str, text: str) -> ArmError:
        """Report the first fault since ``connect``, and return it; called from the worker's threads, too."""
        error = arm_error(self._name, kind, text)
        self._first_fault.note(error, text, kind)
        return error

    def _dashboard_lost(self, why: str) -> ArmError:
        return self._report_fault("link", f"the dashboard, over which it is stopped, does not answer: {why}")

    def _fault_or(self, stopped: ArmError) -> ArmError:
        """Return the fault that preceded a stop, if any: a person must know the fault."""
        noted, worker = self._first_fault.error, self._worker
        if noted is None or worker is None:
            return noted or stopped
        if isinstance(noted, LinkLost):
            return self._link_fault(self._first_fault.text, self._first_fault.kind)
        with suppress(WorkerGone, Refusal):
            fault = worker.call("state", ANSWER_WITHIN_S)["fault"]  # the worker may know the cause better by now
            if fault is not None:
                return arm_error(self._name, fault["kind"], fault["text"])
        return type(noted)(*noted.args)

    def _link_fault(self, why: str, kind: str) -> ArmError:
        """Report the fault, kill the client, stop the arm, monitor it until it rests if possible; return the error."""
        self._report_fault(kind, why)
        self._drop_worker()
        try:
            self._program.bring_to_rest()
            outcome = "a stop was requested and the arm was seen at rest"
        except LinkLost as error:
            reason = "" if kind == "nonsense" else f" ({cause(error)})"  # without this condition it would be said twice
            outcome = (
                f"it could not be seen at rest{reason}; its controller stops it"
                f" {1.0 / self._settings.watchdog_hz:.1f} s after the last message of this computer, but treat it as"
                " moving until you see it at rest"
            )
        what = f"link lost: {why}" if kind == "link" else why
        self._fault = arm_error(self._name, kind, f"{what}; {outcome}")
        return self._fault

    def _drop_worker(self) -> None:
        worker, self._worker = self._worker, None
        self._first_fault.mute()
        if worker is not None:
            worker.kill()
            self._gaps = self._gaps.joined(worker.gaps)

    # -- calls and their failures --------------------------------------------------------------------------------------

    def _without_worker(self) -> ArmError:
        if self._fault is not None:
            return type(self._fault)(*self._fault.args)
        return LinkLost(f"arm {self._name}: not connected; connect first")

    def _call(
        self, request: str, within_s: float, permitted: Callable[[], None] = lambda: None, **arguments: Any
    ) -> dict[str, Any]:
        worker = self._worker
        if worker is None:
            if self._fault is None:
                permitted()
            raise self._without_worker()
        try:
            return worker.call(request, within_s, permitted, **arguments)
        except MotionStopped as stopped:
            raise self._fault_or(stopped) from stopped
        except Refusal as error:
            refused = arm_error(self._name, error.kind, error.text)
            raise (self._fault_or(refused) if isinstance(refused, MotionStopped) else refused) from error
        except WorkerGone as error:
            raise self._link_fault(str(error), error.kind) from error


# ---------------------------------------------------------------------------------------------------------------------
# Faults of an arm since ``connect``: the first is stored, and the first of each kind is reported to a listener.


class FirstFault:
    """Store of the first fault; reports the first of each kind. Any thread may call any method.

    A later fault of another kind matters: the first may be harmless, but a safety stop is not.

    Attributes
    ----------
    error : ArmError or None
        The first fault since ``clear``; None if there is none.
    text, kind : str
        What was found, without the arm's name and the remedy; a key of ``REFUSALS``.
    """

    def __init__(self) -> None:
        self._listener: FaultListener = lambda error: None
        self.error: ArmError | None = None
        self.text, self.kind = "", ""
        self._noted: dict[type[ArmError], ArmError] = {}
        self._reporting = False
        self._lock = threading.Lock()

    def watch(self, listener: FaultListener) -> None:
        """Report to ``listener`` from now on; report faults that are already noted at once."""
        with self._lock:
            self._listener = listener
            noted = [*self._noted.values()] if self._reporting else []
        for error in noted:
            listener(error)

    def note(self, error: ArmError, text: str, kind: str = "link") -> None:
        """Store a fault if it is the first; report it if it is the first of its kind and the arm is connected."""
        with self._lock:
            if type(error) in self._noted:
                return
            self._noted[type(error)] = error
            if self.error is None:
                self.error, self.text, self.kind = error, text, kind
            reporting = self._reporting
        if reporting:
            self._listener(error)

    def report(self) -> None:
        """Report faults from now on, and also those noted during ``connect``."""
        with self._lock:
            noted = [] if self._reporting else [*self._noted.values()]
            self._reporting = True
        for error in noted:
            self._listener(error)

    def mute(self) -> None:
        """Report no more faults: the link is being closed."""
        with self._lock:
            self._reporting = False

    def clear(self) -> None:
        """Forget all faults."""
        with self._lock:
            self.error, self.text, self.kind = None, "", ""
            self._noted.clear()


# -- The stop latch of a UR arm: from a brake until the next ``connect`` all motions are refused ----------------------


class StopLatch:
    """Counter of brakes and of stops under way. Any thread may call any method.

    Attributes
    ----------
    brakes : int
        Number of brakes so far.
    stops : int
        Number of stops being commanded or waited for. They would also stop a program that is started meanwhile.
    """

    def __init__(self) -> None:
        self.brakes = 0
        self.stops = 0
        self._released = 0
        self._changed = threading.Condition()

    @property
    def in_force(self) -> bool:
        """Whether a brake has not been released."""
        return self.brakes > self._released

    def refuse(self) -> None:
        """Count a brake; it may be commanded later."""
        with self._changed:
            self.brakes += 1
            self._changed.notify_all()

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """Count a stop that is under way."""
        with self._changed:
            self.stops += 1
        try:
            yield
        finally:
            with self._changed:
                self.stops -= 1
                self._changed.notify_all()

    def wait_for_stops(self, brakes: int, timeout_s: float) -> None:
        """Wait until no stop is under way, or until there are more than ``brakes`` brakes."""
        with self._changed:
            self._changed.wait_for(lambda: not self.stops or self.brakes != brakes, timeout_s)

    def release(self, brakes: int) -> None:
        """Release all brakes up to number ``brakes``."""
        with self._changed:
            self._released = max(self._released, brakes)


# ---------------------------------------------------------------------------------------------------------------------
# Tracking of whether a program of this driver may run on a UR controller; stop of its arm over plain connections.


_STOP_WITHIN_S = 1.0
_LOOK_AGAIN_S = 0.1


class OwnProgram:
    """Programs that this driver has started on one controller, which may run motions.

    Attributes
    ----------
    awaited : bool
        Whether one was uploaded that was not seen to run yet. A stop before its start may not keep it from starting.
    """

    def __init__(self, host: str, rest_s: float) -> None:
        """``rest_s`` [s] is the longest time to wait for rest."""
        self._host, self._rest_s = host, rest_s
        self._started = self._ended = 0
        """Counters, so that a program that starts while the previous one is brought to rest is not forgotten."""
        self.awaited = False

    @property
    def may_run(self) -> bool:
        """Whether a program, and with it a motion, may run."""
        return self._started > self._ended

    def started(self) -> None:
        """Note that a program may run from now on."""
        self._started += 1

    def uploaded(self, may_start: bool) -> None:
        """Note that a program was uploaded, or that it was seen to run."""
        self.awaited = may_start
        self.started()

    def end_late_start(self, within_s: float) -> None:
        """Wait until a program that was uploaded runs, then end it; it has begun no motion. Raises ``LinkLost``."""
        patience = Patience(within_s)
        while self.awaited:
            try:
                with Connection.to(self._host, RTDE_PORT, patience) as link:
                    if any(sample.program != "STOPPED" for sample in samples(link, patience)):
                        self.bring_to_rest()
                        self.awaited = False
            except LinkLost as error:
                if patience.remaining_s < 2.0 * _LOOK_AGAIN_S:
                    raise LinkLost(
                        f"the program that was uploaded to it was not seen to start and end within {within_s:g} s"
                        f" ({cause(error)}); look at the pendant: end it if it runs"
                    ) from error
                time.sleep(_LOOK_AGAIN_S)

    def wait_at_rest(self) -> None:
        """Monitor the arm until it rests. Raises ``LinkLost``."""
        wait_at_rest(self._host, self._rest_s)

    def bring_to_rest(self, *, look: Callable[[], None] | None = None) -> None:
        """Stop the controller's program and monitor the arm until it rests; ``look`` is called meanwhile and may raise.

        Raises
        ------
        LinkLost
            If it was not stopped, or not seen at rest.
        """
        started = self._started
        not_stopped: LinkLost | None = None
        try:
            stop_program(self._host, _STOP_WITHIN_S, look=look)
        except LinkLost as error:
            not_stopped = error
        try:
            sample = wait_at_rest(self._host, self._rest_s, look=look)
        except LinkLost as error:
            raise LinkLost(" and ".join(cause(one) for one in (not_stopped, error) if one is not None)) from error
        if not_stopped is not None and sample.program == "PLAYING":
            raise not_stopped
        self._ended = max(self._ended, started)


# -- The dashboard connection over which a UR arm is stopped. It stays open and is checked all the time ---------------
#
# Questions and stops share it. The controller answers in order, so a stop can be sent without waiting for the answer to
# an earlier question. If the line fails when it is needed, a new one is tried for a short time.


_QUESTION = "running"
_ASK_EVERY_S = 0.1
_SILENT_S = 0.35
"""A dashboard that leaves a question unanswered for this long is lost."""
_ANSWER_WITHIN_S = 0.04
"""Time to wait for an open dashboard to answer a stop; after it a new connection is tried."""
_RETRY_WITHIN_S = 0.25
_OPEN_WITHIN_S = 0.25
_AGAIN_S = 0.05
_TRIES = 2
"""A dashboard is lost if it closed its connection and this many attempts to open it again failed."""
_END_WITHIN_S = 1.0
_MOST_BYTES = 4096


class _Line:
    """One open connection. One thread calls ``pump`` and then ``close``; any thread may call the other methods."""

    def __init__(self, host: str, port: int, patience: Patience) -> None:
        """Connect and read the greeting. Raises ``LinkLost``."""
        with ExitStack() as unfinished:
            self._link = unfinished.enter_context(Connection.to(host, port, patience))
            Dashboard(self._link, patience)
            self._link.keep_alive()
            unfinished.pop_all()
        self._sending = threading.Lock()
        self._waiting: deque[queue.SimpleQueue[str | None]] = deque()
        self._received = bytearray()
        self._ended = False

    def send(self, text: str) -> queue.SimpleQueue[str | None]:
        """Send a line and return the queue for its answer; the answer is None if the connection has ended."""
        answer: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        with self._sending:
            self._waiting.append(answer)
            try:
                if not self._ended:
                    self._link.send_at_once(f"{text}\n".encode("ascii"))
            except OSError:
                self._ended = True
            if self._ended:
                answer.put(None)
        return answer

    def ask(self, text: str, patience: Patience) -> str:
        """Send a line and return its answer. Raises ``LinkLost``."""
        try:
            answer = patient_get(self.send(text), patience)
        except queue.Empty:
            raise LinkLost(f"{self._link.where}: the dashboard did not answer '{text}' in time") from None
        if answer is None:
            raise LinkLost(f"{self._link.where}: the controller closed the dashboard's connection")
        return answer

    @property
    def ended(self) -> bool:
        """Whether the connection has ended."""
        return self._ended

    @property
    def where(self) -> str:
        """Host and port."""
        return self._link.where

    def pump(self, patience: Patience) -> None:
        """Wait for bytes and pass complete lines to those who asked; detect the end of the connection."""
        try:
            more = self._link.receive(patience)
        except OSError:
            more = b""
        if more is None:
            return
        self._received += more
        while (end := self._received.find(b"\n")) >= 0:
            line = self._received[:end].decode("utf-8", errors="replace").strip()
            del self._received[: end + 1]
            with self._sending:
                if not self._waiting:  # a line that nobody asked for: the peer is no dashboard any more
                    more = b""
                    break
                self._waiting.popleft().put(line)
        if not more or len(self._received) > _MOST_BYTES:
            self.end()

    def end(self) -> None:
        """End the connection; pending questions get the answer None."""
        with self._sending:
            self._ended = True
            while self._waiting:
                self._waiting.popleft().put(None)
            self._link.shut_down()

    def close(self) -> None:
        """End the connection and free its socket."""
        self.end()
        self._link.close()


class StopLine:
    """Stops the program of one controller. Any thread may call any method.

    A thread of this object calls ``lost`` when the controller no longer answers: within 0.2 s if it closed the
    connection and refuses a new one, within 0.6 s if it is silent.
    """

    def __init__(self, host: str, lost: Callable[[str], object], *, port: int = DASHBOARD_PORT) -> None:
        self._host, self._lost, self._port = host, lost, port
        self._opening = threading.Lock()
        self._line: _Line | None = None
        self._closing = threading.Event()
        self._keeper: threading.Thread | None = None

    def open(self, look: Callable[[], None] = lambda: None) -> None:
        """Open a new connection and keep it; ``look`` is called during waits and may raise. Raises ``LinkLost``."""
        self.close()
        self._closing = threading.Event()
        self._reopened(Patience(_OPEN_WITHIN_S, look=look))
        self._keeper = threading.Thread(
            target=self._keep, args=(self._closing,), name=f"dashboard of {self._host}", daemon=True
        )
        self._keeper.start()

    def _reopened(self, patience: Patience) -> _Line:
        """Return the open connection, or a new one if it has ended. Raises ``LinkLost``."""
        if not self._opening.acquire(timeout=_OPEN_WITHIN_S):
            raise LinkLost(f"{self._host}:{self._port}: no connection to the UR dashboard in time")
        try:
            line = self._line
            if line is None or line.ended:
                line = self._line = _Line(self._host, self._port, patience)
            return line
        finally:
            self._opening.release()

    def confirm(self, patience: Patience) -> None:
        """Ask a question that changes nothing; if the connection was closed, ask once more on a new one.

        Raises
        ------
        LinkLost
            If it was not answered.
        """
        line = self._reopened(patience)
        try:
            line.ask(_QUESTION, patience)
        except LinkLost:
            if not line.ended:
                raise
            self._reopened(patience).ask(_QUESTION, patience)

    def stop(self) -> None:
        """Stop the program with one line and wait for its answer; if the open connection fails, use a new one.

        Raises
        ------
        LinkLost
            If the controller did not confirm the stop; the message says if its pendant is in local control.
        """
        line, patience = self._line, Patience(_ANSWER_WITHIN_S)
        if line is not None and not line.ended:
            with suppress(LinkLost):
                return require_stopped(lambda text: line.ask(text, patience), self._host)
        stop_program(self._host, _RETRY_WITHIN_S, port=self._port)

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._closing.set()
        keeper, self._keeper = self._keeper, None
        line, self._line = self._line, None
        if line is not None:
            line.end()
        if keeper is not None and keeper is not threading.current_thread():
            keeper.join(_END_WITHIN_S)
        if line is not None:
            line.close()

    # -- the thread that keeps it -------------------------------------------------------------------------------------

    def _keep(self, closing: threading.Event) -> None:
        failures = 0
        while not closing.is_set():
            try:
                self._watch(self._reopened(Patience(_OPEN_WITHIN_S)), closing)
                failures = 0
                continue
            except LinkLost as error:
                why = cause(error)
            failures += 1
            if failures >= _TRIES and not closing.is_set():
                self._lost(why)
            closing.wait(_AGAIN_S)

    def _watch(self, line: _Line, closing: threading.Event) -> None:
        """Repeat the question until the connection ends. Report and end a silent connection.

        Raises ``LinkLost`` if it ended before any answer.
        """
        until_next, silence, answers = Patience(_ASK_EVERY_S), Patience(_SILENT_S), 0
        question: queue.SimpleQueue[str | None] | None = line.send(_QUESTION)
        while not (line.ended or closing.is_set()):
            line.pump(Patience(SLICE_S))
            if question is not None and not question.empty():
                question, until_next, answers = None, Patience(_ASK_EVERY_S), answers + (not line.ended)
            elif question is None and until_next.remaining_s < SLICE_S:
                question, silence = line.send(_QUESTION), Patience(_SILENT_S)
            elif question is not None and silence.over:
                line.end()
                self._lost(f"{line.where}: it left a question unanswered for {_SILENT_S:g} s")
        line.close()
        if not (answers or closing.is_set()):
            raise LinkLost(f"{line.where}: the controller closed the connection at once")


# ---------------------------------------------------------------------------------------------------------------------
# Translation of a UR worker's answers to the terms of the arm's protocol: errors with their remedies, and states.


REFUSALS: Mapping[str, tuple[type[ArmError], str]] = {
    "protective": (ProtectiveStop, ""),
    "emergency": (EmergencyStop, ""),
    "local": (NotInRemoteControl, ""),
    "link": (LinkLost, "see whether the controller is on and the network between works, then connect again"),
    "driver": (LinkLost, "possible: other programs take its time; close them, then connect again"),
    "ended": (LinkLost, "connect again; if it ends again, report it"),
    "nonsense": (LinkLost, "look at the pendant's log, restart the controller"),
    "timeout": (ArmTimeout, "see what the pendant shows"),
    "stopped": (MotionStopped, "connect again when it may move"),
    "stalled": (HostStalled, "nothing is wrong at the arm; close other programs on this computer"),
    "failed": (ArmError, "look at the arm and at the pendant's log, then connect again"),
    "advised": (ArmError, ""),
    "occupied": (ArmError, ""),
}
"""Exception and remedy for each kind of refusal of the worker. A kind without a remedy here has it in its text."""


def arm_error(name: str, kind: str, text: str) -> ArmError:
    """Return the exception for a refusal of arm ``name``; its message says what is wrong and what to do."""
    error, remedy = REFUSALS[kind]
    return error(f"arm {name}: {text}" + (f"; {remedy}" if remedy else ""))


def arm_state(answer: Mapping[str, Any], moving_rad_s: float) -> ArmState:
    """Return the state from a worker's answer; a joint faster than ``moving_rad_s`` counts as moving."""
    mode, safety, fault = str(answer["robot_mode"]), str(answer["safety_mode"]), answer["fault"]
    reason, problem = "", not_ready(mode, safety)
    if problem is not None:
        reason = ": ".join(problem)
    elif fault is not None:
        reason = f"{fault['text']}; connect again when the arm may move"
    qd = np.array(answer["qd"], dtype=np.float64)
    temperatures = answer["joints_c"]
    return ArmState(
        q=np.array(answer["q"], dtype=np.float64),
        time_s=float(answer["time_s"]),
        moving=bool(answer["moving"]) or float(np.abs(qd).max()) > moving_rad_s,
        ready=not reason,
        reason=reason,
        payload_kg=answer["payload_kg"],
        joint_temperature_c=np.array(temperatures, dtype=np.float64) if len(temperatures) == JOINTS else None,
        robot_mode=mode,
        safety_mode=safety,
        program=str(answer["program"]),
        speed_fraction=answer["speed_fraction"],
    )
