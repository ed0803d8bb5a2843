"""Script port: extracts programs from uploaded text and passes them to the controller.

Only complete blocks from ``def name():`` to an ``end`` in the first column count. URScript is not interpreted: the
control script of ur_rtde is recognised by its markers and emulated; any other program starts and ends at once. A real
controller also streams its state here; this one sends nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.emulators.ur_controller import poses
from drivers.emulators.ur_controller.controller import Controller, Program, ScriptError
from drivers.plant.servo import servo_rate

_MAX_BYTES = 1 << 20
_HEAD = re.compile(rb"^def[ \t]+([A-Za-z_]\w*)[ \t]*\([^)\n]*\)[ \t]*:", re.MULTILINE)
_TAIL = re.compile(rb"^end[ \t]*\r?\n", re.MULTILINE)
_FLOAT_OFFSET = re.compile(rb"# ?float register offset\s*\n?\s*(\d{1,9})\b")
_FIRST_WATCHDOG = re.compile(rb'^def .*\n\s*rtde_set_watchdog\("input_int_register_(?:0|24)", ([0-9.]{1,9}), "stop"\)')
_INT_OFFSET = re.compile(rb"# ?int register offset\s*\n?\s*(\d{1,9})\b")


@dataclass
class UnknownProgram:
    """A program that is not emulated: it starts and ends at once."""

    name: str

    def begin(self, controller: Controller) -> None:
        """Do nothing."""

    def cycle(self, controller: Controller) -> bool:
        """End."""
        return False


@dataclass
class ForeignProgram:
    """A program that a person loaded and started on the pendant; it moves nothing and does not end by itself."""

    name: str = "palletizing.urp"

    def begin(self, controller: Controller) -> None:
        """Do nothing."""

    def cycle(self, controller: Controller) -> bool:
        """Continue."""
        return True


def program_of(name: str, block: bytes) -> Program[Controller]:
    """Return the program of a block of text."""
    offsets = [pattern.search(block) for pattern in (_INT_OFFSET, _FLOAT_OFFSET)]
    numbers = [int(found.group(1)) for found in offsets if found is not None]
    if len(numbers) == 2 and all(number in (0, 24) for number in numbers):
        first = _FIRST_WATCHDOG.search(block)
        return ControlScript(numbers[0], numbers[1], name, 0.0 if first is None else float(first.group(1)))
    return UnknownProgram(name)


class Upload:
    """Collects the text of one connection and extracts programs."""

    def __init__(self) -> None:
        self._received = bytearray()

    def take(self, data: bytes) -> list[Program[Controller]]:
        """Return the programs that ``data`` completes, in order; text outside a program is discarded."""
        self._received += data
        found: list[Program[Controller]] = []
        while (head := _HEAD.search(self._received)) is not None:
            tail = _TAIL.search(self._received, head.end())
            if tail is None:
                break
            block = bytes(self._received[head.start() : tail.end()])
            found.append(program_of(head.group(1).decode(), block))
            del self._received[: tail.end()]
        if head is None:
            del self._received[: self._received.rfind(b"\n") + 1]
        if len(self._received) > _MAX_BYTES:
            self._received.clear()
        return found


# -- The control script of ur_rtde, emulated by its effect on a controller through registers --------------------------
#
# A client writes a command and its arguments into input registers. Once per control period the script executes it and
# reports that in output registers. Its state stays READY during a blocking motion, like that of the real script.


_READY, _DONE = 1, 2
_RUNNING_BIT = 1 << 15
_IMMEDIATE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands that are executed in every cycle while they are in the register; the script stays READY."""
_SERVO = 11
_STOP = 255
_KG_MOST = 50.0
_LEAST_DECELERATION = 1e-6
_MOST = 1e6
"""Largest argument of a command: angles, lengths, times and rates are far smaller."""
_NO_TOOL = (0.0,) * 6


class ControlScript:
    """The program that ur_rtde uploads; its registers begin at ``int_offset`` and ``double_offset``."""

    def __init__(
        self, int_offset: int, double_offset: int, name: str = "rtde_control", watchdog_hz: float = 0.0
    ) -> None:
        """``watchdog_hz``: rate of a watchdog that it sets in its first line; 0: none."""
        self._i, self._d, self.name, self._watchdog_hz = int_offset, double_offset, name, watchdog_hz
        self._blocked = False
        self._answered = False
        self._next_move: tuple[Sequence[float], float, float] | None = None
        self._asynchronous = False
        self._thread = "none"
        self._writes = 0
        self._operation = 0
        self._streamed: tuple[float, ...] | None = None
        """The streamed position that the arm follows; None after any other command."""

    def begin(self, controller: Controller) -> None:
        """Report that the script is ready and no asynchronous motion runs."""
        controller.set_watchdog(self._watchdog_hz, self._i)
        self._progress(controller, running=False)
        controller.set_output_int(self._i, _READY)

    def cycle(self, controller: Controller) -> bool:
        """Execute the command register once; return False if it asks the script to end."""
        self._advance(controller)
        if self._blocked:
            return True
        command = controller.input_int(self._i)
        if self._answered:
            if command == 0:
                self._answered = False
                controller.set_output_int(self._i, _READY)
            return True
        if command == 0:
            return True
        if command == _STOP:
            return False
        if command != _SERVO:
            self._streamed = None
        if command in _IMMEDIATE:
            self._immediate(controller, command)
            controller.set_output_int(self._i, _READY)
            return True
        self._execute(controller, command)
        if not self._blocked:
            self._done(controller)
        return True

    # -- current motion ----------------------------------------------------------------------------------------------

    def _advance(self, controller: Controller) -> None:
        """Update the state of a motion: start one that waits for rest, detect the end of a running one."""
        if self._thread == "starting":  # the thread runs from the cycle after the answer to the command
            self._thread = "running"
            self._operation = (self._operation + 1) % 128
            self._progress(controller, running=True)
        if not controller.motion_ended():
            return
        if self._next_move is not None:
            if self._asynchronous and self._thread != "running":
                return
            goal, self._next_move = self._next_move, None
            controller.move(*goal)
            if controller.moving:
                return
        if self._blocked:
            self._blocked = False
            self._done(controller)
        elif self._thread == "running":
            self._end_thread(controller)

    def _done(self, controller: Controller) -> None:
        controller.set_output_int(self._i, _DONE)
        self._answered = True

    def _progress(self, controller: Controller, *, running: bool) -> None:
        """Write the progress word: count of writes, operation number, and whether it runs."""
        self._writes = (self._writes + 1) % 128
        word = self._writes << 16 | self._operation << 24 | (_RUNNING_BIT if running else 0)
        controller.set_output_int(self._i + 2, word)

    def _end_thread(self, controller: Controller) -> None:
        if self._thread != "none":
            self._thread = "none"
            self._progress(controller, running=False)

    # -- commands ----------------------------------------------------------------------------------------------------

    def _doubles(self, controller: Controller, first: int, count: int) -> tuple[float, ...]:
        values = controller.input_doubles(self._d + first, count)
        wrong = [value for value in values if not abs(value) <= _MOST]
        if wrong:
            raise ScriptError(f"an argument is {wrong[0]!r}: not a finite number between -{_MOST:g} and {_MOST:g}")
        return values

    def _answer_int(self, controller: Controller, value: int) -> None:
        controller.set_output_int(self._i + 1, value)

    def _answer_doubles(self, controller: Controller, values: Sequence[float]) -> None:
        controller.set_output_doubles(self._d, values)

    def _immediate(self, controller: Controller, command: int) -> None:
        match command:
            case 11:
                self._servo(controller)
            case 26:
                self._answer_doubles(controller, [controller.period_s])
            case 27:
                self._answer_doubles(controller, controller.q)
            case 38:
                self._answer_doubles(controller, (0.0,) * 6)
            case 58:
                self._answer_doubles(controller, controller.tool_pose(controller.q, _NO_TOOL))
            case _:
                raise ScriptError(f"command {command} of ur_rtde is not emulated")

    def _execute(self, controller: Controller, command: int) -> None:
        d = self._doubles
        match command:
            case 1:
                self._move(controller)
            case 8 | 20 | 21 | 56 | 57 | 59:
                pass  # force sensor and direction of gravity: not emulated
            case 15 | 16 | 33:
                self._stop(controller, None, asynchronous=command == 33 and controller.input_int(self._i + 1) == 1)
            case 34:
                self._stop(controller, d(controller, 0, 1)[0], asynchronous=controller.input_int(self._i + 1) == 1)
            case 17 | 65:
                mass, *center = d(controller, 0, 4)
                self._payload(controller, mass, center, d(controller, 4, 6) if command == 65 else None)
            case 29:
                controller.tcp = d(controller, 0, 6)
                controller.publish_load()
            case 31:
                controller.protective_stop("requested by the program")
            case 35:
                controller.set_watchdog(d(controller, 0, 1)[0], self._i)
            case 37:
                q = d(controller, 0, 6)
                inside = all(low <= v <= high for v, (low, high) in zip(q, controller.config.limits, strict=True))
                self._answer_int(controller, int(inside))
            case 39:
                product = poses.composed(poses.frame(d(controller, 0, 6)), poses.frame(d(controller, 6, 6)))
                self._answer_doubles(controller, poses.pose(product))
            case 40:
                self._answer_doubles(controller, controller.tcp)
            case 43:
                self._answer_doubles(controller, controller.tool_pose(controller.q, controller.tcp))
            case 44:
                self._answer_doubles(controller, controller.tool_pose(d(controller, 0, 6), d(controller, 6, 6)))
            case 47:
                self._answer_int(controller, int(controller.steady))
            case _:
                raise ScriptError(f"command {command} of ur_rtde is not emulated")

    def _move(self, controller: Controller) -> None:
        """Execute ``moveJ``, blocking or in a thread of the script. A running asynchronous motion is stopped first."""
        *goal, speed, acceleration = self._doubles(controller, 0, 8)
        self._asynchronous = controller.input_int(self._i + 1) == 1
        if self._thread != "none" or controller.moving:
            controller.brake()
            self._end_thread(controller)
        self._next_move = (goal, speed, acceleration)
        if self._asynchronous:
            self._thread = "starting"
            return
        self._blocked = True
        self._advance(controller)

    def _servo(self, controller: Controller) -> None:
        """Execute ``servoj``: follow the position in the registers; repeating it in the next cycle changes nothing."""
        *goal, _, _, _, lookahead_s, gain = self._doubles(controller, 0, 11)
        controller.require_inside("servoj", goal)
        try:
            rate = servo_rate(lookahead_s, gain)
        except ValueError as error:
            raise ScriptError(str(error)) from None
        if controller.moving and self._streamed is None:  # another motion is still in progress
            return
        if tuple(goal) != self._streamed:
            self._streamed = tuple(goal)
            controller.follow(goal, rate)

    def _stop(self, controller: Controller, deceleration: float | None, *, asynchronous: bool) -> None:
        if deceleration is not None and not _LEAST_DECELERATION <= deceleration < math.inf:
            raise ScriptError(f"stopj: a deceleration of {deceleration!r} rad/s^2 is not above 0")
        self._next_move = None
        self._end_thread(controller)
        controller.brake(deceleration)
        if asynchronous:
            self._asynchronous = True
            self._thread = "starting"
        elif controller.moving:
            self._blocked = True

    def _payload(
        self, controller: Controller, mass: float, center: Sequence[float], inertia: tuple[float, ...] | None
    ) -> None:
        if not 0.0 <= mass <= _KG_MOST:
            raise ScriptError(f"set_payload: a mass of {mass!r} kg is not between 0 and {_KG_MOST:g} kg")
        controller.payload_mass = mass
        if any(center):  # all zero: the centre stays, as in the real script
            controller.payload_center = tuple(center)
        if inertia is not None:
            controller.payload_inertia = inertia
        controller.publish_load()
