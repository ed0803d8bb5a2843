"""The RTDE client of one UR arm, inside its worker process: connection, control program, motion, stop.

Only one thread may use ur_rtde's control object. After a broken link it busy-waits for the controller, up to minutes.
Therefore every call that could hang ends the process after a time limit.
"""

from __future__ import annotations

import faulthandler
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.arms.ur_links import LOCAL_CONTROL, in_local_control, printable
from drivers.arms.ur_motion import VARIABLES, read_worker_sample
from drivers.arms.ur_rtde_reader import UrSample
from drivers.patience import Patience

_FREQUENCY_HZ = 125.0
_STARTS_WATCHED_HZ = 1.0
"""Rate of the watchdog in the program's first line: a program without its client ends itself. The rate of the settings
follows when the arm is looked at: before, a busy computer would miss it."""
_CLIENTS_NAME = "rtde_control"
_MARKS = ("# float register offset\n", "# int register offset\n")
"""Lines of the client's program after which it writes the offset of its registers."""
_PROGRAM_WITHIN_S = 5.0
_COMMAND_WITHIN_S = 5.0
"""Time limit of a command. The client itself gives up after 4 s if the control program does not take the command."""
_STOP_WITHIN_S = 1.0
_DECELERATION = 10.0
"""Deceleration of the leading joint in a stop [rad/s^2]: ur_rtde itself uses it to stop a motion at a given speed."""
_READY_AFTER_S = 0.03
"""Time from a command until its program is ready for the next one: some control cycles. If the program is stopped
before, the client waits for it in vain, for 4 s."""
_ASK_AGAIN_S = 0.002
_LONG_S = 0.1
_ASKED_WITHIN_S = 0.15
"""Time limit of the question for local control; shorter than the silence that makes a worker doubtful."""


class Refusal(Exception):
    """A request that the worker does not serve: its kind, one of ``drivers.arms.ur_supervised_link.REFUSALS``, and a
    sentence.

    The sentence says what to do, unless there is a remedy for the kind.
    """

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


def failed(text: str) -> Refusal:
    """Return a refusal without a special kind."""
    return Refusal("failed", text)


def advised(text: str) -> Refusal:
    """Return a refusal whose text says what to do."""
    return Refusal("advised", text)


class UrControl:
    """The client's two connections: ``receive`` for states, ``control`` for commands to its control program."""

    def __init__(self, host: str, control: Any, receive: Any, optional: Sequence[str] = (), program: str = "") -> None:
        self.host = host
        self._control, self._receive, self._optional, self._program = control, receive, optional, program
        self._commanded_s = 0.0
        self._asked_s: float | None = None
        self.waited_s = 0.0
        """How long the last answer of the controller took that came late [s]; 0 if none did."""

    @classmethod
    def open(
        cls, host: str, optional: Sequence[str], timeout_s: float, program: str, version: tuple[int, int]
    ) -> UrControl:
        """Connect and start nothing; add the ``optional`` variables to the states.

        ``program`` will be the name of the control program, ``version`` is the controller's. Nothing is sent to a
        controller on which a program runs. Raises ``Refusal``.
        """
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        # the constructors hold the interpreter's lock, so no thread of this process could end a constructor that hangs
        with exit_after(timeout_s):
            try:
                receive = RTDEReceiveInterface(host, _FREQUENCY_HZ, [*VARIABLES, *optional])
                if not receive.isConnected():
                    raise Refusal("link", "the controller accepts RTDE connections but sends no state")
                if receive.getRuntimeState() != _STOPPED:
                    raise Refusal("occupied", OCCUPIED)
                control = RTDEControlInterface(host, -1.0, int(RTDEControlInterface.FLAG_NO_WAIT))
                return cls(host, control, receive, optional, program_text(program, version))
            except (RuntimeError, ValueError) as error:
                raise _open_refusal(str(error)) from error

    @property
    def waits_s(self) -> float:
        """How long the controller has been asked for something without an answer [s]; from any thread."""
        asked_s = self._asked_s
        return 0.0 if asked_s is None else time.monotonic() - asked_s

    # -- state ---------------------------------------------------------------------------------------------------------

    @property
    def connected(self) -> bool:
        """Whether both connections are open."""
        return bool(self._control.isConnected() and self._receive.isConnected())

    @property
    def program_runs(self) -> bool:
        """Whether the control program runs, according to the command connection."""
        return bool(self._control.isProgramRunning())

    @property
    def time_s(self) -> float:
        """Controller time of the newest state [s]."""
        return float(self._receive.getTimestamp())

    def sample(self) -> UrSample:
        """Return the newest state."""
        return read_worker_sample(self._receive, self._optional)

    def operation(self) -> tuple[int, bool]:
        """Return the number of the last motion that the program began, and whether that motion runs."""
        status = self._control.getAsyncOperationProgressEx()
        return int(status.operationId()), bool(status.isAsyncOperationRunning())

    # -- the control program -------------------------------------------------------------------------------------------

    def upload(self, meanwhile: Callable[[], None], opening: Callable[[bool], None]) -> None:
        """Upload the control program and wait until it runs; ``meanwhile`` is called often and may raise.

        ``opening(True)`` is called just before it may run on the controller, ``opening(False)`` when it does. Raises
        ``Refusal``.
        """
        patience = Patience(_PROGRAM_WITHIN_S)
        while self.program_runs:  # the client learns of a stop one period later than the state shows it
            if patience.over:
                raise failed("its control program was stopped but still runs")
            meanwhile()
            time.sleep(_ASK_AGAIN_S)
        with self.waiting():
            local = in_local_control(self.host, _ASKED_WITHIN_S)
        if local:  # the program would not start, and no message would say why
            raise Refusal("local", f"{LOCAL_CONTROL}, so it accepts no program; switch it to Remote")
        meanwhile()
        opening(True)
        try:
            with exit_after(_COMMAND_WITHIN_S), _as_file(self._program) as name:
                self._control.setCustomScriptFile(name)  # which clears the last command and uploads
        except (RuntimeError, OSError) as error:
            raise failed(f"its control program could not be uploaded: {error}") from error
        while not self.program_runs:
            if patience.over:
                raise Refusal("timeout", f"its control program did not start within {_PROGRAM_WITHIN_S:g} s")
            meanwhile()
            time.sleep(_ASK_AGAIN_S)
        self.kick_watchdog()
        opening(False)

    def rename(self) -> None:
        """Give the control program the name that the client itself gives it, from the next upload on."""
        self._program = self._program.replace(self._program.partition("(")[0], f"def {_CLIENTS_NAME}", 1)

    def set_watchdog(self, hertz: float) -> None:
        """Start the controller's watchdog: it stops the program if it receives nothing for 1 / ``hertz`` [s]."""
        if not self._asked(lambda: self._control.setWatchdog(hertz)):
            raise failed("the control program does not respond (it refused the watchdog)")

    def kick_watchdog(self) -> None:
        """Restart the watchdog's period."""
        with self.waiting():
            self._control.kickWatchdog()

    def tcp(self) -> tuple[float, ...] | None:
        """Return the tool centre point that the program sees, position [m] and rotation vector [rad]; None if not set.

        Raises ``Refusal``.
        """
        tcp = self._asked(self._control.getTCPOffset)
        return tuple(tcp) if len(tcp) == 6 else None

    def within_safety_limits(self, q: Sequence[float]) -> bool:
        """Return whether the controller's safety configuration allows the joint positions. Raises ``Refusal``."""
        allowed = self._asked(lambda: self._control.isJointsWithinSafetyLimits(q))
        # the client also returns False for a question that was not answered
        if not allowed and not (self.connected and self.program_runs):
            raise failed("its control program ended while it was asked about safety limits")
        return bool(allowed)

    def _asked(self, question: Callable[[], Any]) -> Any:
        """Return the control program's answer. Raises ``Refusal``, also for exceptions that the client raises."""
        with self._commanding():
            try:
                return question()
            except (RuntimeError, ValueError) as error:
                raise failed(f"its control program did not answer: {printable(str(error))}") from error

    # -- motion --------------------------------------------------------------------------------------------------------

    def move(self, goal: Sequence[float], speed: float, acceleration: float) -> bool:
        """Begin a joint motion; return whether the program accepted it. Raises ``Refusal``."""
        with self._commanding():
            try:
                return bool(self._control.moveJ(goal, speed, acceleration, True))
            except (RuntimeError, ValueError) as error:
                raise failed(f"the RTDE client refused the motion: {error}") from error

    def servo(self, goal: Sequence[float], period_s: float, lookahead_s: float, gain: float) -> bool:
        """Send one position of a stream, effective in the next control cycle; return whether it was sent."""
        with self.waiting(), exit_after(_COMMAND_WITHIN_S):
            try:
                return bool(self._control.servoJ(goal, 0.0, 0.0, period_s, lookahead_s, gain))
            except (RuntimeError, ValueError) as error:
                raise failed(f"the RTDE client refused a position of the path: {error}") from error

    def end_servo(self) -> bool:
        """End a stream; the arm rests at its last position. Return whether the program accepted it."""
        with self._commanding():
            return bool(self._control.servoStop(_DECELERATION))

    def brake(self) -> None:
        """Stop a motion at full deceleration; do nothing if the program has ended or has just received a command."""
        if time.monotonic() - self._commanded_s < _READY_AFTER_S or not (self.connected and self.program_runs):
            return
        with self._commanding(_STOP_WITHIN_S):
            self._control.stopJ(_DECELERATION, True)

    @contextmanager
    def _commanding(self, within_s: float = _COMMAND_WITHIN_S) -> Iterator[None]:
        with self.waiting(), exit_after(within_s):
            yield
        self._commanded_s = time.monotonic()

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Note, while this context is open, that the controller is asked for something."""
        self._asked_s = began_s = time.monotonic()
        try:
            yield
        finally:
            self._asked_s, took_s = None, time.monotonic() - began_s
            if took_s > _LONG_S:
                self.waited_s = took_s


OCCUPIED = "another program runs on its controller; nothing was sent to it: end that program first"
_STOPPED = 1


def program_text(name: str, version: tuple[int, int]) -> str:
    """Return the RTDE client's control program for a controller's version, with a name and a watchdog of its own."""
    from script_client import ScriptClient

    text: str = ScriptClient("", *version).getScript()
    for mark in _MARKS:
        text = text.replace(mark, f"{mark}0")
    watchdog = f'rtde_set_watchdog("input_int_register_0", {_STARTS_WATCHED_HZ}, "stop")'
    return f"def {name}():\n  {watchdog}\n{text}end\n"


@contextmanager
def _as_file(text: str) -> Iterator[str]:
    """Yield the name of a file with a text; in memory where the system can: a full disk must not keep an arm."""
    if hasattr(os, "memfd_create"):
        with os.fdopen(os.memfd_create("control program"), "w") as file:
            file.write(text)
            file.flush()
            yield f"/proc/self/fd/{file.fileno()}"
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "control.script")
            path.write_text(text)
            yield str(path)


def _open_refusal(text: str) -> Refusal:
    """Return a refusal for an exception of the RTDE client's constructor; reword texts that are unclear."""
    if "enable remote control" in text:
        return Refusal("local", "not in remote control; switch the pendant from Local to Remote")
    if "already in use" in text:
        return Refusal("occupied", "another RTDE client (a fieldbus, another program) holds its inputs; end that")
    return Refusal("link", f"the RTDE client could not connect: {' '.join(text.split())[:200]}")


@contextmanager
def exit_after(seconds: float) -> Iterator[None]:
    """End the process if the block hangs, even while it holds the interpreter's lock."""
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
