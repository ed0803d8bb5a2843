"""An arm of the simulated cell."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.arms.path_checks import checked_move, checked_path
from drivers.arms.path_end import slowed
from drivers.arms.protocol import (
    ArmError,
    ArmState,
    ArmTimeout,
    EmergencyStop,
    FaultListener,
    JointLimits,
    LinkLost,
    LiveArm,
    MotionStopped,
    ProtectiveStop,
    Tool,
)
from drivers.arms.recording import JointRecord
from drivers.findings import ArmIdentity
from drivers.plant import Plant
from drivers.plant.factory import factory_calibration
from drivers.plant.servo import GAIN, LOOKAHEAD_S, servo_rate

CYCLE_S = 0.008
"""Control cycle: every query takes one, so that simulated time passes while a caller polls."""
SETTLE_S = 0.2
"""An arm counts as settled after this time at rest."""

_Sample = tuple[float, NDArray[np.float64], NDArray[np.float64]]
"""Time [s], joint positions [rad] and speeds [rad/s] of a control cycle."""


class SimulatedArm:
    """One arm of a ``Plant``. Faults: ``protective_stop``, ``emergency_stop``, ``cut_link``; cleared by ``release``."""

    def __init__(self, plant: Plant, name: str) -> None:
        if name not in plant.names:
            raise ValueError(f"the simulated cell has no arm '{name}'; it has {', '.join(plant.names)}")
        self._plant = plant
        self._name = name
        self._config = next(arm for arm in plant.config.arms if arm.name == name)
        self._connected = False
        self._fault: ProtectiveStop | EmergencyStop | None = None
        self._link_cut = False
        self._refusals = 0
        """Number of calls of ``refuse_motion``; each refuses motion until the next ``connect``."""
        self._released = 0
        self._cut_short = False
        """Whether the last motion was stopped before its goal."""
        self._listener: FaultListener = lambda error: None
        self._stream: NDArray[np.float64] | None = None
        """The positions that are being streamed. ``_send`` stops when this is another array or None."""
        self._sent = 0
        self._reached = math.inf
        self._record: list[_Sample] | None = None
        self._stream_end_s = 0.0

    @property
    def name(self) -> str:
        """Name of the arm in the cell."""
        return self._name

    def connect(self) -> None:
        """Open the link. Raises ``LinkLost`` while it is cut, ``MotionStopped`` if motion was refused meanwhile."""
        refusals = self._refusals
        if self._link_cut:
            raise LinkLost(f"arm {self._name}: the simulated link is cut")
        self._connected = True
        self._released = refusals
        self._may_move()

    def watch(self, listener: FaultListener) -> None:
        """Report faults and lost links to ``listener`` when they occur."""
        self._listener = listener

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return all False: a simulated arm has no safety configuration."""
        self._link()
        return np.zeros(len(q), dtype=np.bool_)

    def _link(self) -> None:
        if self._link_cut or not self._connected:
            why = "cut" if self._link_cut else "not open; connect first"
            raise LinkLost(f"arm {self._name}: the simulated link is {why}")

    def _no_fault(self) -> None:
        if self._fault is not None:
            raise type(self._fault)(*self._fault.args)

    def identify(self) -> ArmIdentity:
        """Return the identity of a simulated arm."""
        self._link()
        model = f"simulated, {self._config.joints} joints"
        own = factory_calibration(self._plant, self._name)
        return ArmIdentity(
            model=model,
            serial=f"SIM-{self._name}",
            software="simulated",
            dh_rows=None if own is None else tuple((theta, d, a, alpha) for theta, d, a, alpha in own.rows.tolist()),
            dh_checksum="" if own is None else own.checksum,
        )

    def limits(self) -> JointLimits:
        """Return the limits of the arm in the plant."""
        self._link()
        return JointLimits(self._config.limits.copy(), self._config.speed.copy(), self._config.acceleration.copy())

    def tool(self) -> Tool:
        """Return the payload; a simulated arm has no tool centre point."""
        self._link()
        mass, center = self._plant.payload(self._name)
        return Tool(payload_kg=mass, payload_center_m=center, tcp=None)

    def warnings(self) -> tuple[str, ...]:
        """Return no warnings: no hardware is checked."""
        return ()

    def state(self) -> ArmState:
        """Return the state after one control cycle."""
        self._link()
        self._plant.advance(CYCLE_S)
        return self._now()

    def live(self) -> LiveArm:
        """Return whether the arm moves. The age is 0 while it is linked, else infinite."""
        linked = self._connected and not self._link_cut
        return LiveArm(0.0 if linked else math.inf, self._moving)

    def confirm(self) -> None:
        """Raise ``LinkLost`` while the link is cut or closed, or the fault of the arm."""
        self._link()
        self._no_fault()

    @property
    def _moving(self) -> bool:
        return self._plant.moving(self._name) or self._stream is not None

    def _now(self) -> ArmState:
        return ArmState(
            q=self._plant.q(self._name),
            time_s=self._plant.clock_s,
            moving=self._moving,
            ready=self._fault is None,
            reason="" if self._fault is None else str(self._fault),
            payload_kg=self._plant.payload(self._name)[0],
            joint_temperature_c=self._plant.joints_c(self._name),
            rest_since_s=None if self._moving else self._plant.rest_s(self._name),
            speed_fraction=1.0,
        )

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion, straight in joint space: all joints start and end together.

        Raises ``LimitExceeded``, ``ProtectiveStop``, ``EmergencyStop``, ``LinkLost``, ``MotionStopped`` after a brake,
        or ``ArmError`` while it moves.
        """
        self._may_start()
        goal, speeds, accelerations = checked_move(self._name, q, speed, acceleration, self.limits())
        self._cut_short = False
        self._plant.start_move(self._name, goal, speeds, accelerations)

    def _may_move(self) -> None:
        if self._refusals > self._released:
            raise MotionStopped(f"arm {self._name}: it was stopped; connect again when it may move")

    def _may_start(self) -> None:
        """Raise the reason why the arm cannot begin a motion: its link, a fault, a refusal, a motion in progress."""
        self._link()
        self._no_fault()
        self._may_move()
        if self._moving:
            raise ArmError(f"arm {self._name} is still moving; wait until it rests, or stop it")

    # -- paths --------------------------------------------------------------------------------------------------------

    @property
    def path_period_s(self) -> float:
        """Control cycle [s]."""
        return CYCLE_S

    def start_path(self, q: NDArray[np.float64], period_s: float) -> None:
        """Stream joint positions; the arm follows them with the lag of ``drivers.plant.servo``."""
        self._may_start()
        here = self._plant.q(self._name)
        limits = JointLimits(self._config.limits, self._config.speed, self._config.acceleration)
        path = checked_path(self._name, q, period_s, CYCLE_S, limits, here)
        self._cut_short = False
        self._stream, self._reached = path, math.inf
        self._stream_end_s = self._plant.clock_s + len(path) * CYCLE_S
        self._send(path, 0, self._plant.clock_s)

    def _send(self, path: NDArray[np.float64], row: int, began_s: float) -> None:
        """Send one position and schedule the next in the plant; do nothing if the stream has ended."""
        if self._stream is not path:
            return
        self._sent = row
        if row == len(path):
            self._stream = None
            return
        self._plant.servo(self._name, path[row], servo_rate(LOOKAHEAD_S, GAIN))
        self._plant.schedule.at(began_s + (row + 1) * CYCLE_S, lambda: self._send(path, row + 1, began_s))

    def end_path(self) -> None:
        """Slow down along the path; harmless when none is being followed."""
        path = self._stream
        if path is None or math.isfinite(self._reached):
            return
        sent = self._sent + 1  # the row of this cycle was sent
        tail, self._reached = slowed(path.tolist(), sent, CYCLE_S)
        began_s = self._stream_end_s - len(path) * CYCLE_S
        rest = np.concatenate([path[:sent], np.array(tail)])
        self._stream, self._stream_end_s = rest, began_s + len(rest) * CYCLE_S
        self._plant.schedule.at(began_s + sent * CYCLE_S, lambda: self._send(rest, sent, began_s))

    def reached(self) -> float:
        """Return the row at which ``end_path`` ended the last path; inf if it did not."""
        return self._reached

    # -- recording ----------------------------------------------------------------------------------------------------

    def start_recording(self) -> None:
        """Record the joints in each control cycle while other calls advance the plant's time."""
        self._link()
        record: list[_Sample] = []
        self._record = record
        self._keep(record, self._plant.clock_s, 0)

    def _keep(self, record: list[_Sample], began_s: float, number: int) -> None:
        """Record one sample and schedule the next in the plant."""
        if self._record is not record:
            return
        record.append((self._plant.clock_s, self._plant.q(self._name), self._plant.speeds(self._name)))
        self._plant.schedule.at(began_s + (number + 1) * CYCLE_S, lambda: self._keep(record, began_s, number + 1))

    def end_recording(self) -> JointRecord:
        """Return all samples."""
        self._link()
        record, self._record = self._record or [], None
        shape = (len(record), self._config.joints)
        q, qd = (np.array([one[place] for one in record]).reshape(shape) for place in (1, 2))
        return JointRecord(np.array([one[0] for one in record]), q, qd, CYCLE_S)

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Advance until the arm has been at rest for ``SETTLE_S``, or until the plant's schedule brings a fault.

        Raises ``ArmTimeout``, or what stopped it: a fault, or ``MotionStopped``.
        """
        self._link()
        remaining = max(timeout_s, 0.0)
        while (needed := self._rest_due_s() + SETTLE_S - self._plant.clock_s) > 0.0:
            step = min(needed, remaining, self._plant.undisturbed_s)
            self._plant.advance(step)
            self._link()
            self._no_fault()
            if self._cut_short or step == needed:
                break
            if step == remaining:
                raise ArmTimeout(f"arm {self._name} needs {needed:.2f} s to come to rest, {timeout_s:g} s were allowed")
            remaining -= step
        self._no_fault()
        if self._cut_short:
            raise MotionStopped(f"arm {self._name}: its motion was stopped before the goal")
        return self._now()

    def _rest_due_s(self) -> float:
        """Return when the arm comes to rest, as far as known [s]."""
        rest_s = self._plant.rest_s(self._name)
        return rest_s if self._stream is None else max(rest_s, self._stream_end_s)

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``."""
        self._refusals += 1

    def brake(self) -> None:
        """Brake at full deceleration; no motion until ``connect``. The simulated brake needs no link."""
        self.refuse_motion()
        self._brake()

    def stop(self) -> None:
        """Brake now and advance until the arm is at rest; harmless at rest."""
        self._link()
        self._brake()
        self._plant.advance(max(self._plant.rest_s(self._name) - self._plant.clock_s, 0.0))

    def _brake(self) -> None:
        self._cut_short = self._cut_short or self._moving
        self._halt()

    def _halt(self) -> None:
        """End the stream, if any, and brake."""
        self._stream = None
        self._plant.stop(self._name)

    def disconnect(self) -> None:
        """Stop the arm and close the link; harmless when closed."""
        if self._connected and not self._link_cut:
            self.stop()
        self._connected = False

    # -- faults, for tests --------------------------------------------------------------------------------------------

    def protective_stop(self, reason: str = "a force limit was exceeded") -> None:
        """Stop the arm as its controller would; it accepts motions again after ``release``."""
        text = f"protective stop, {reason}; look at the arm, then release it"
        self._fail(ProtectiveStop(f"arm {self._name}: {text}"))

    def emergency_stop(self) -> None:
        """Press the emergency stop; the arm accepts motions again after ``release``."""
        self._fail(EmergencyStop(f"arm {self._name}: the emergency stop is pressed; clear the cell, then release it"))

    def _fail(self, fault: ProtectiveStop | EmergencyStop) -> None:
        self._fault = fault
        self._halt()
        self._listener(fault)

    def cut_link(self) -> None:
        """Block all calls until ``release`` and ``connect``. The arm continues a motion; a stream ends."""
        if self._stream is not None:  # its controller gets no more positions
            self._halt()
        self._link_cut = True
        self._connected = False
        self._listener(LinkLost(f"arm {self._name}: the simulated link is cut"))

    def release(self) -> None:
        """Clear every fault."""
        self._fault = None
        self._link_cut = False
