"""A controller as a state machine: power, safety, program and registers. No sockets; the caller passes the time.

It uses two clocks. The cell's (the plant's) is for everything that happens to the arm, so that it scales with the pace.
Wall time is for what a client times with its own clock: the start of an uploaded program and the watchdog.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from drivers.arms.ur_rtde_reader import ProgramState, RobotMode, SafetyMode
from drivers.emulators.ur_controller import poses
from drivers.emulators.ur_controller.motion import Array, Brakes, StopTrigger
from drivers.emulators.ur_controller.personality import ControllerConfig, Rows
from drivers.emulators.ur_controller.variables import zeros
from drivers.plant import Plant

# -- Values of the RTDE variables that depend on a controller's modes and settings ------------------------------------


Values = tuple[float, ...]


def initial_values(q: Values) -> dict[str, Values]:
    """Return every variable of a controller whose arm rests at ``q`` (6,) [rad]."""
    return zeros() | {
        "actual_q": q,
        "target_q": q,
        "actual_main_voltage": (48.0,),
        "speed_scaling": (1.0,),
        "target_speed_fraction": (1.0,),
        "actual_tool_accelerometer": (0.0, 0.0, 9.82),
    }


def of_modes(robot_mode: RobotMode, safety_mode: SafetyMode, runtime: ProgramState) -> dict[str, Values]:
    """Return the variables that show the modes."""
    powered = robot_mode not in (RobotMode.POWER_OFF, RobotMode.DISCONNECTED)
    running = runtime in (ProgramState.PLAYING, ProgramState.RESUMING)
    return {
        "robot_mode": (int(robot_mode),),
        "safety_mode": (int(safety_mode),),
        "safety_status": (int(safety_mode),),
        "runtime_state": (int(runtime),),
        "robot_status_bits": (powered * 1 | running * 2 | powered * 8,),
        "safety_status_bits": (SAFETY_BITS[safety_mode],),
        "joint_mode": (JOINT_MODE.get(robot_mode, JOINT_POWER_OFF),) * 6,
        "actual_robot_voltage": (48.0 * powered,),
    }


def of_tool(rows: Rows, q: Values, qd: Values, tcp: Values) -> dict[str, Values]:
    """Return the variables that show pose and speed of the TCP, at joint positions and speeds (6,) [rad, rad/s]."""
    frames = poses.chain(rows, q)
    tool = poses.composed(frames[-1], poses.frame(tcp))
    pose = poses.pose(tool)
    return {"actual_TCP_pose": pose, "target_TCP_pose": pose, "actual_TCP_speed": poses.speed(frames, qd, tool.p)}


_TEMPERATURE_EVERY_S = 0.5
_MAX_PAUSE_S = 0.05
"""Largest pause of this process that the watchdog counts: during a longer one the client was not silent."""
_STEADY_S = 0.1
_LEAST_RATE = 1e-6
"""Joint speeds [rad/s] or accelerations [rad/s^2] below this count as 0: the motion would take days."""
_ZERO6: Values = (0.0,) * 6
_PUSH_RAD_S2 = 1e4
"""Acceleration of an arm that is pushed: it has its speed at once."""
_COMMAND_REGISTERS = ("input_int_register_0", "input_int_register_24")
_STOPPING: Mapping[float, str] = {15: "stopl", 16: "stopj", 33: "stopl", 34: "stopj", 255: "end of the script"}
"""Commands of ur_rtde that stop the arm."""


class Controller:
    """One controller. Call ``cycle`` once per control period, with the cell's lock held.

    Attributes
    ----------
    values : dict
        Every variable that RTDE can stream, as a tuple of numbers.
    brakes : Brakes
        The stops so far, and the one in progress.
    slider : SpeedSlider
        The speed slider of the pendant.
    log : deque of str
        Events, newest last; shows the reasons of refusals.
    moves : int
        Number of motions started; resumed ones count again.
    journal : Journal
        All stops received, and the motions begun and ended.
    start_delay_s : float
        Wall time from an uploaded program to its start.
    """

    def __init__(self, config: ControllerConfig, motions: Plant, clock: Callable[[], float] = time.monotonic) -> None:
        """``clock`` gives the timestamps of stops, also between two cycles."""
        self.config = config
        self.motions = motions
        self.name = config.name
        self.period_s = 1.0 / config.personality.rate_hz
        self.robot_mode = RobotMode[config.robot_mode]
        self.safety_mode = SafetyMode.NORMAL
        self.runtime = ProgramState.STOPPED
        self.remote_control = config.remote_control
        self.start_delay_s = config.start_delay_s
        self.boot_s = config.boot_s
        self.payload_mass = config.payload_mass
        self.payload_center: Values = tuple(config.payload_center)
        self.payload_inertia: Values = _ZERO6
        self.tcp: Values = tuple(config.tcp)
        self.slider = SpeedSlider()
        self.brakes = Brakes(config.name, motions, config.braking, config.speed, config.acceleration, clock)
        self.program: Program[Controller] | None = None
        self.log: deque[str] = deque(maxlen=200)
        self.moves = 0
        self.journal = Journal(clock)
        self.now_s = 0.0
        self._uploaded: tuple[float, Program[Controller]] | None = None
        self._was_moving = False
        self._goal: tuple[Array, Array, Array] | None = None
        self._protective_stop_s = -math.inf
        self._release_s = math.inf
        self._mode_due: list[tuple[float, RobotMode]] = []
        self._stop_trigger = StopTrigger()
        self._move_from = np.zeros(6)
        self._rest_since_s = -math.inf
        self._temperature_due_s = -math.inf
        self._watchdog = Watchdog()
        self._pose_inputs: tuple[Values, Values, Values] | None = None
        self._q: Values = tuple(float(v) for v in motions.q(self.name))
        self._qd: Values = _ZERO6
        self._clock_s = motions.clock_s
        self.values = initial_values(self._q)
        self.publish_load()
        self._publish_modes()

    # -- state -------------------------------------------------------------------------------------------------------

    @property
    def starting(self) -> bool:
        """Whether an uploaded program has not started yet."""
        return self._uploaded is not None

    @property
    def q(self) -> Values:
        """Joint positions at the last cycle [rad]."""
        return self._q

    @property
    def clock_s(self) -> float:
        """Cell time at the last cycle [s]."""
        return self._clock_s

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress; at speed slider 0 it is, although the arm stands still."""
        return self.motions.moving(self.name)

    @property
    def at_rest(self) -> bool:
        """Whether the joints stand still."""
        return not self.moving or (self.slider.scaling == 0.0 and not self.brakes.braking)

    @property
    def steady(self) -> bool:
        """Whether the arm has rested for a tenth of a second."""
        return not self.moving and self._clock_s - self._rest_since_s >= _STEADY_S

    @property
    def running(self) -> bool:
        """Whether a program runs or is resuming."""
        return self.runtime in (ProgramState.PLAYING, ProgramState.RESUMING)

    @property
    def accepts_commands(self) -> bool:
        """Whether it accepts commands over the network."""
        return self.remote_control or self.config.personality.series == "CB3"

    # -- registers ---------------------------------------------------------------------------------------------------

    def input_int(self, number: int) -> int:
        """Return an integer register that clients write."""
        return int(self.values[f"input_int_register_{number}"][0])

    def input_double(self, number: int) -> float:
        """Return a float register that clients write."""
        return self.values[f"input_double_register_{number}"][0]

    def input_doubles(self, first: int, count: int) -> Values:
        """Return consecutive float registers that clients write."""
        return tuple(self.input_double(first + i) for i in range(count))

    def set_output_int(self, number: int, value: int) -> None:
        """Write an integer register that clients read."""
        self.values[f"output_int_register_{number}"] = (value,)

    def set_output_doubles(self, first: int, values: Sequence[float]) -> None:
        """Write float registers that clients read."""
        for i, value in enumerate(values):
            self.values[f"output_double_register_{first + i}"] = (float(value),)

    def write_input(self, name: str, value: Values) -> None:
        """Store an input that a client wrote, and its time for the watchdog."""
        if name == "speed_slider_fraction":
            if self.values["speed_slider_mask"][0]:
                self.set_slider(value[0])
            return
        before, self.values[name] = self.values[name], value
        if name in _COMMAND_REGISTERS and value != before and value[0] in _STOPPING:
            self.journal.note("stop", f"rtde: {_STOPPING[value[0]]}")
        if name.startswith("input_int_register_"):
            self._watchdog.written(int(name[19:]))

    def set_slider(self, fraction: float) -> None:
        """Move the speed slider; a value that is not a finite number is refused and logged."""
        if not self.slider.set(fraction):
            self.log.append(f"speed slider: {fraction} is not a finite number; refused")
        self._publish_speed()

    def set_watchdog(self, least_hz: float, register: int) -> None:
        """Stop the program if an input register is written less often than ``least_hz``; 0 switches this off."""
        self._watchdog.watch(least_hz, register)

    # -- motion ------------------------------------------------------------------------------------------------------

    def move(self, q: Sequence[float], speed: float, acceleration: float) -> None:
        """Start a joint motion like ``movej``: no joint exceeds ``speed`` or its own limit. The slider scales it.

        All values are finite. Raises ``ScriptError`` for a goal outside the limits.
        """
        config = self.config
        self.require_inside("movej", q)
        if speed < _LEAST_RATE or acceleration < _LEAST_RATE:
            raise ScriptError("movej: speed and acceleration must be above 0")
        goal = np.array(q, dtype=np.float64)
        self._start(goal, np.minimum(speed, config.speed), np.minimum(acceleration, config.acceleration))

    def require_inside(self, command: str, q: Sequence[float]) -> None:
        """Raise ``ScriptError`` for a goal (6,) outside the limits."""
        for joint, (value, (low, high)) in enumerate(zip(q, self.config.limits, strict=True), start=1):
            if not low - 1e-9 <= value <= high + 1e-9:
                raise ScriptError(f"{command}: {value:.4f} rad of joint {joint} is outside [{low:.4f}, {high:.4f}] rad")

    def _start(self, goal: Array, speed: Array, acceleration: Array) -> None:
        self._note_start("move" if self._goal is None else "resume")
        self._goal = (goal, speed, acceleration)
        self.motions.start_move(self.name, goal, speed, acceleration)
        self.motions.scale_speed(self.name, self.slider.scaling)
        self._was_moving = True  # at a high pace the motion may end before the next cycle

    def _note_start(self, how: str) -> None:
        self.journal.note("begun", how)
        self._move_from = self.motions.q(self.name)
        self.moves += 1

    def follow(self, q: Sequence[float], rate: float) -> None:
        """Follow a position of a stream with the lag ``rate`` [1/s]; ignore it while the arm brakes."""
        if not self.brakes.braking:
            if not self.moving:
                self._note_start("stream")
            self.motions.servo(self.name, np.array(q), rate)
            self._was_moving = True

    def push(self, joint: int, by: float, speed: float) -> None:
        """Turn a joint of the arm at rest by ``by`` [rad] at ``speed`` [rad/s], as a force from outside does."""
        goal = self.motions.q(self.name)
        goal[joint] += by
        self.motions.start_move(self.name, goal, np.full(6, speed), np.full(6, _PUSH_RAD_S2))
        self._was_moving = True

    def brake(self, deceleration: float | None = None) -> None:
        """Stop the arm like ``stopj`` at ``deceleration`` [rad/s^2], and forget its goal."""
        self._goal = None
        self.brakes.request("stopj", deceleration)

    # -- program -----------------------------------------------------------------------------------------------------

    def upload(self, program: Program[Controller]) -> bool:
        """Accept an uploaded program, which replaces a running one after a delay; return whether it was accepted."""
        if not self.accepts_commands:
            self.log.append(f"program {program.name} ignored: not in remote control")
            return False
        if self.robot_mode is not RobotMode.RUNNING or self.safety_mode is not SafetyMode.NORMAL:
            self.log.append(f"program {program.name} ignored: {self.robot_mode.name}, {self.safety_mode.name}")
            return False
        self.stop_program()
        self._uploaded = (self.now_s + self.start_delay_s, program)
        return True

    def start_locally(self, program: Program[Controller]) -> None:
        """Start a program as a person does on the pendant. Raises ``ValueError`` if one runs, or without power."""
        if self.runtime is not ProgramState.STOPPED or not self._can_move():
            raise ValueError(f"arm {self.name}: {self.runtime.name}, {self.robot_mode.name}: no program can start")
        self.program = program
        self._set_runtime(ProgramState.PLAYING)

    def stop_program(self, reason: str = "") -> None:
        """End a program that runs or is paused, not one that was uploaded and is about to start; the arm brakes."""
        if reason or self.runtime is not ProgramState.STOPPED:
            self.journal.note("stop", reason or "a new program")
        self._watchdog.watch(0.0, 0)
        if self.runtime in (ProgramState.STOPPED, ProgramState.STOPPING):
            return
        if reason:
            self.log.append(f"program stopped: {reason}")
        self._goal = None
        self.brakes.request("program")
        self.program = None
        self._set_runtime(ProgramState.STOPPING)

    def pause_program(self, how: str = "dashboard: pause") -> bool:
        """Pause the program; return whether one was running."""
        self.journal.note("stop", how)
        if not self.running:
            return False
        self.brakes.request("program")
        self._set_runtime(ProgramState.PAUSING)
        return True

    def resume_program(self) -> bool:
        """Resume a paused program; return whether one was paused and the arm can move."""
        if self.runtime is not ProgramState.PAUSED or not self._can_move():
            return False
        self._set_runtime(ProgramState.RESUMING)
        return True

    def _can_move(self) -> bool:
        return self.robot_mode is RobotMode.RUNNING and self.safety_mode is SafetyMode.NORMAL

    # -- safety and power --------------------------------------------------------------------------------------------

    def protective_stop(self, reason: str = "commanded") -> None:
        """Trigger a protective stop; without effect if the arm is stopped already or has no power."""
        if not self._can_move():
            return
        self.log.append(f"protective stop: {reason}")
        self.journal.note("stop", f"protective stop: {reason}")
        self.safety_mode = SafetyMode.PROTECTIVE_STOP
        self._protective_stop_s = self.motions.clock_s
        self._release_s = math.inf
        self._uploaded = None
        self._stop_trigger = StopTrigger()
        self.brakes.request("protective")
        if self.running:
            self._set_runtime(ProgramState.PAUSING)
        self._publish_modes()

    def arm_protective_stop(self, *, speed: float = math.inf, travel: float = math.inf) -> None:
        """Trigger a stop when the arm reaches ``speed`` [rad/s] or has moved by ``travel`` [rad]; inf: never."""
        self._stop_trigger = StopTrigger(speed, travel)

    def unlock(self, *, at_once: bool = False) -> bool:
        """Release a protective stop as the operator does; return False if too early (unless ``at_once``)."""
        if self.safety_mode is SafetyMode.PROTECTIVE_STOP:
            if not at_once and self.motions.clock_s - self._protective_stop_s < self.config.unlock_after_s:
                return False
            self._release_s = self.motions.clock_s
        return True

    def emergency_stop(self) -> None:
        """Press the emergency stop: the program ends, the arm brakes and loses power."""
        self.log.append("emergency stop")
        self.brakes.request("emergency")
        self.stop_program("emergency stop")
        self._goal = self._uploaded = None
        self._stop_trigger = StopTrigger()
        self.safety_mode = SafetyMode.ROBOT_EMERGENCY_STOP
        self.robot_mode = RobotMode.POWER_OFF
        self._mode_due.clear()
        self._publish_modes()

    def release_emergency_stop(self) -> None:
        """Release the emergency stop; power stays off."""
        if self.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety_mode = SafetyMode.NORMAL
            self._publish_modes()

    def power_on(self) -> bool:
        """Boot the joints; return False in an emergency stop."""
        if self.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            return False
        if self.robot_mode is RobotMode.POWER_OFF:
            self.robot_mode = RobotMode.BOOTING
            self._mode_due = [(self.motions.clock_s + self.boot_s, RobotMode.IDLE)]
            self._publish_modes()
        return True

    def release_brakes(self) -> bool:
        """Switch to RUNNING, with power on if needed; return False in an emergency stop."""
        if not self.power_on():
            return False
        if self.robot_mode is not RobotMode.RUNNING and not any(m is RobotMode.RUNNING for _, m in self._mode_due):
            idle_s = self._mode_due[-1][0] if self._mode_due else self.motions.clock_s
            self._mode_due.append((idle_s + self.config.brake_release_s, RobotMode.RUNNING))
        return True

    def power_off(self, how: str = "power off") -> None:
        """End the program and switch power off."""
        self.brakes.request("program")
        self.stop_program(how)
        self._goal = self._uploaded = None
        self._mode_due.clear()
        self.robot_mode = RobotMode.POWER_OFF
        self._publish_modes()

    # -- time --------------------------------------------------------------------------------------------------------

    def cycle(self, now_s: float) -> None:
        """Execute one control period at ``now_s`` (``time.monotonic``), after the cell's time has advanced."""
        self._watchdog.run_s += min(now_s - self.now_s, _MAX_PAUSE_S)
        self.now_s = now_s
        self.brakes.cycle(now_s)
        if self.slider.follow(self.motions.clock_s - self._clock_s) and not self.brakes.braking:
            self.motions.scale_speed(self.name, self.slider.scaling)
        self._publish_speed()
        self._read_drives()
        switched(self.values)
        while self._mode_due and self._clock_s >= self._mode_due[0][0]:
            self.robot_mode = self._mode_due.pop(0)[1]
            self._publish_modes()
        if self._clock_s >= self._release_s:
            self._release_s = math.inf
            self.safety_mode = SafetyMode.NORMAL
            self.log.append("protective stop released")
            self._publish_modes()
        if self.runtime is ProgramState.PLAYING and (silent := self._watchdog.complaint()):
            self.stop_program(silent)
        self._step_program()

    def _read_drives(self) -> None:
        clock_s = self.motions.clock_s
        elapsed_s = clock_s - self._clock_s
        moving = self.moving
        if moving or self._was_moving or self._qd != _ZERO6:
            q: Values = tuple(self.motions.q(self.name).tolist())
            if elapsed_s > 0.0:
                qd = tuple((a - b) / elapsed_s for a, b in zip(q, self._q, strict=True))
                self._qd = qd if moving else _ZERO6
            self._q = q
            values = self.values
            values["actual_q"] = values["target_q"] = q
            values["actual_qd"] = values["target_qd"] = self._qd
        if self._was_moving and not moving:
            self.journal.note("ended", "at rest")
        self._was_moving = moving
        if moving:
            self._rest_since_s = clock_s
        self._clock_s = clock_s
        self.values["timestamp"] = (clock_s,)
        if clock_s >= self._temperature_due_s:
            self._temperature_due_s = clock_s + _TEMPERATURE_EVERY_S
            self.values["joint_temperatures"] = tuple(self.motions.joints_c(self.name).tolist())
        if moving and (self._stop_trigger.speed < math.inf or self._stop_trigger.travel < math.inf):
            travel = max(abs(a - b) for a, b in zip(self._q, self._move_from, strict=True))
            if max(map(abs, self._qd)) >= self._stop_trigger.speed or travel >= self._stop_trigger.travel:
                self.protective_stop("armed for this motion")

    def _step_program(self) -> None:
        moving = self.moving
        if self.runtime is ProgramState.STOPPING and not moving:
            self._set_runtime(ProgramState.STOPPED)
        elif self.runtime is ProgramState.PAUSING and not moving:
            self._set_runtime(ProgramState.PAUSED)
        elif self.runtime is ProgramState.RESUMING and not moving:
            if self._goal is not None:
                self._start(*self._goal)
            self._set_runtime(ProgramState.PLAYING)
        elif self.runtime is ProgramState.STOPPED and self._uploaded is not None and self.now_s >= self._uploaded[0]:
            if not moving:
                program, self._uploaded = self._uploaded[1], None
                self._watchdog.watch(0.0, 0)
                self.program = program
                self._set_runtime(ProgramState.PLAYING)
                self._run_step(program.begin)
        elif self.runtime is ProgramState.PLAYING and self.program is not None:
            self._run_step(self.program.cycle)

    def _run_step(self, step: Callable[[Controller], bool | None]) -> None:
        try:
            if step(self) is False:
                self.stop_program("it ended")
        except ScriptError as error:
            self.stop_program(str(error))

    def motion_ended(self) -> bool:
        """Return whether the last motion has ended."""
        if self.moving:
            return False
        self._goal = None
        return True

    # -- streamed values ---------------------------------------------------------------------------------------------

    def _set_runtime(self, state: ProgramState) -> None:
        self.runtime = state
        self._publish_modes()

    def _publish_modes(self) -> None:
        self.values |= of_modes(self.robot_mode, self.safety_mode, self.runtime)

    def _publish_speed(self) -> None:
        self.values["target_speed_fraction"] = (self.slider.fraction,)
        self.values["speed_scaling"] = (self.slider.scaling,)

    def publish_load(self) -> None:
        """Update the streamed payload and TCP."""
        self.values |= {"payload": (self.payload_mass,), "payload_cog": self.payload_center}
        self.values |= {"payload_inertia": self.payload_inertia, "tcp_offset": self.tcp}
        self._pose_inputs = None

    def tool_pose(self, q: Sequence[float], tcp: Sequence[float]) -> Values:
        """Return the pose in B of a tool centre point ``tcp`` given in the flange frame."""
        flange = poses.chain(self.config.personality.rows, q)[-1]
        return poses.pose(poses.composed(flange, poses.frame(tcp)))

    def refresh_poses(self) -> None:
        """Update the streamed TCP pose and speed; called only if they are streamed, because it takes time."""
        now = (self._q, self._qd, self.tcp)
        if self._pose_inputs == now:
            return
        self._pose_inputs = now
        self.values |= of_tool(self.config.personality.rows, *now)


# -- Timestamped record of what a controller received and did: stops in any way, motions begun and ended --------------


EventKind = Literal["stop", "begun", "ended"]
_MOST = 5000


class Journal:
    """The last events of one controller, oldest first, each at ``at_s`` (``time.monotonic`` of this process) [s].

    ``how`` is the way in which a stop arrived, or the cause of a motion: "move", "resume" or "stream".
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._events: deque[dict[str, Any]] = deque(maxlen=_MOST)

    def note(self, kind: EventKind, how: str) -> None:
        """Record an event at the current time."""
        self._events.append({"at_s": self._clock(), "kind": kind, "how": how})

    def since(self, at_s: float) -> list[dict[str, Any]]:
        """Return the events from ``at_s`` on, for the control channel."""
        return [event for event in self._events if event["at_s"] >= at_s]


# -- Digital outputs of a controller, which clients set ----------------------------------------------------------------


_BITS, _MASK, _LEVELS = "actual_digital_output_bits", "standard_digital_output_mask", "standard_digital_output"


def switched(values: dict[str, Values]) -> None:
    """Set the outputs to the values that clients wrote since the last control cycle."""
    if mask := int(values[_MASK][0]):
        values[_BITS], values[_MASK] = ((int(values[_BITS][0]) & ~mask) | (int(values[_LEVELS][0]) & mask),), (0,)


# -- The speed slider of a controller: it scales every motion, also one in progress, but not the braking of a stop ----


_FULL_RANGE_S = 0.5
"""Time in which the scaling follows the slider over its full range [s]; an assumption, no faster than a stop."""


class SpeedSlider:
    """The slider and the speed scaling that follows it, both from 0 to 1. At 0 the arm stands; the program runs."""

    def __init__(self) -> None:
        self.fraction = 1.0
        self.scaling = 1.0

    def set(self, fraction: float) -> bool:
        """Move the slider, limited to its range; return False for a value that is not a finite number."""
        if not math.isfinite(fraction):
            return False
        self.fraction = min(max(fraction, 0.0), 1.0)
        return True

    def follow(self, elapsed_s: float) -> bool:
        """Update the scaling for ``elapsed_s`` [s]; return whether it has changed."""
        if self.scaling == self.fraction:
            return False
        step = elapsed_s / _FULL_RANGE_S
        self.scaling = min(max(self.fraction, self.scaling - step), self.scaling + step)
        return True


# -- The watchdog of a control program: it ends a program whose client stops writing a register -----------------------


class Watchdog:
    """Monitor of how often one input register is written; ``run_s`` [s] is the time that the controller has run."""

    def __init__(self) -> None:
        self.run_s = 0.0
        self._register = 0
        self._period_s = math.inf
        self._begun_s = 0.0
        self._written_s: dict[int, float] = {}

    def watch(self, least_hz: float, register: int) -> None:
        """Monitor from now on that ``register`` is written at least at ``least_hz``; 0 monitors nothing."""
        self._period_s = 1.0 / least_hz if least_hz > 0.0 else math.inf
        self._register, self._begun_s = register, self.run_s

    def written(self, register: int) -> None:
        """Note that a register was written now."""
        self._written_s[register] = self.run_s

    def complaint(self) -> str:
        """Return what is wrong, in words; empty while the register is written in time."""
        silent_s = self.run_s - max(self._written_s.get(self._register, -math.inf), self._begun_s)
        if silent_s <= self._period_s:
            return ""
        return f"watchdog: input_int_register_{self._register} not written for {silent_s:.3f} s"


# -- Bits and joint modes by which the primary interface and RTDE show the modes ---------------------------------------


SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
_JOINT_RUNNING, _JOINT_IDLE, _JOINT_BOOTING, JOINT_POWER_OFF = 253, 255, 247, 239
JOINT_MODE = {
    RobotMode.RUNNING: _JOINT_RUNNING,
    RobotMode.IDLE: _JOINT_IDLE,
    RobotMode.POWER_ON: _JOINT_IDLE,
    RobotMode.BOOTING: _JOINT_BOOTING,
}


# -- Interface of the programs that a controller executes, one control cycle at a time --------------------------------


C = TypeVar("C", contravariant=True)
"""The controller that executes a program."""


class ScriptError(Exception):
    """A program requested something impossible; the program ends."""


class Program(Protocol[C]):
    """A program on a controller, executed one cycle at a time."""

    name: str

    def begin(self, controller: C) -> None:
        """Execute the first step. Raises ``ScriptError``."""

    def cycle(self, controller: C) -> bool:
        """Execute one control cycle; return whether the program continues. Raises ``ScriptError``."""
