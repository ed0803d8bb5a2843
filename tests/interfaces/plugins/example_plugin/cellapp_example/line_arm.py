"""The driver of the kind ``line``.

The controller sends ``state TIME MOVING Q1 ... QN`` every 20 ms and takes ``move V A Q1 ... QN`` and ``stop``; seconds,
radians, MOVING is 0 or 1, V and A are the speed and acceleration of the slowest joint.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import (
    ArmError,
    ArmState,
    ArmTimeout,
    FaultListener,
    JointLimits,
    LimitExceeded,
    LinkLost,
    LiveArm,
    MotionStopped,
    Tool,
)
from drivers.arms.settings import ArmContext
from drivers.findings import ArmIdentity

SILENCE_S = 0.3
"""The protocol of arms asks for a fault after this time without a state."""
REACTION_S = 0.1
"""After this time the controller acts on a command, and its states show it."""
STOP_S = 5.0
"""Any arm of this maker stops within this time."""
NEAR_RAD = 1e-4
"""An arm at rest this near to its goal has arrived."""


class LineArm:
    """A link with one controller; a thread of its own reads the states. Any thread may call ``brake`` and its like."""

    def __init__(self, arm: ArmContext, host: str, port: int) -> None:
        self._arm, self._address = arm, (host, port)
        self._listener: FaultListener = lambda error: None
        self._changed = threading.Condition()
        self._socket: socket.socket | None = None
        self._state: ArmState | None = None
        self._heard_s = -math.inf
        self._commanded_s = -math.inf
        self._fault: ArmError | None = None
        self._goal = np.zeros(arm.joints)
        self._refusals = self._released = 0

    @property
    def name(self) -> str:
        """Name of the arm in the profile."""
        return self._arm.name

    def connect(self) -> None:
        """Open the link and wait for the first state. Raises ``LinkLost``, ``MotionStopped``."""
        refusals = self._refusals
        self.disconnect()
        try:
            link = socket.create_connection(self._address, SILENCE_S)  # its time limit holds for every read as well
        except OSError as error:
            raise LinkLost(f"arm {self.name}: {error}; check power, cable and address") from error
        with self._changed:
            self._socket, self._state, self._fault, self._commanded_s = link, None, None, -math.inf
        threading.Thread(target=self._read, args=(link,), name=f"arm {self.name}", daemon=True).start()
        with self._changed:
            self._changed.wait_for(lambda: self._state is not None or self._fault is not None)
        self._released = refusals  # one that came meanwhile stays in force
        try:
            self.state()
            self._require_permission()
        except ArmError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Close the link."""
        with self._changed:
            link, self._socket = self._socket, None
        if link is not None:
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            link.close()

    def _read(self, link: socket.socket) -> None:
        """Keep the newest state; push a fault as soon as there is none, so that the other arms brake at once."""
        try:
            for line in link.makefile(encoding="ascii"):
                _, time_s, moving, *q = line.split()
                if len(q) != self._arm.joints:
                    raise ValueError(f"{len(q)} joints, expected {self._arm.joints}")
                state = ArmState(np.array(q, dtype=float), float(time_s), moving == "1", True, "", None, None)
                with self._changed:
                    self._state, self._heard_s = state, time.monotonic()
                    self._changed.notify_all()
            reason = "the controller closed the link"
        except (OSError, ValueError) as error:
            reason = str(error)
        with self._changed:
            if self._socket is not link:  # disconnected on purpose
                return
            self._fault = LinkLost(f"arm {self.name}: {reason}; look at the arm, it may still move")
            self._changed.notify_all()
        self._listener(self._fault)

    def watch(self, listener: FaultListener) -> None:
        """Report the first fault after each ``connect`` to ``listener``."""
        self._listener = listener

    def state(self) -> ArmState:
        """The newest state, at most ``SILENCE_S`` old. Raises ``LinkLost``."""
        with self._changed:
            if self._fault is not None:
                raise self._fault
            if self._state is None or self._socket is None:
                raise LinkLost(f"arm {self.name}: not connected")
            return replace(self._state, moving=self._moves(self._state))

    def _moves(self, state: ArmState) -> bool:
        """Whether the arm moves; a state from before the last command took effect shows no rest."""
        return state.moving or state.time_s <= self._commanded_s + REACTION_S

    def live(self) -> LiveArm:
        """Age of the newest state, and whether the arm moves; asks nothing."""
        state = self._state
        if state is None or self._socket is None:
            return LiveArm(math.inf, moving=True)
        return LiveArm(time.monotonic() - self._heard_s, self._moves(state))

    def confirm(self) -> None:
        """Wait for a state that comes after this call. Raises ``LinkLost``."""
        with self._changed:
            before = self._state
            self._changed.wait_for(lambda: self._state is not before or self._fault is not None, SILENCE_S)
            self.state()
            if self._state is before:
                raise LinkLost(f"arm {self.name}: no state for {SILENCE_S} s; look at the arm, it may still move")

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Start a joint motion; the safety gate of cellapp has checked the way, the limits are checked here again."""
        limits = self._arm.limits
        inside = (q >= limits.position[:, 0]) & (q <= limits.position[:, 1])  # False for what is not a number
        if not np.all(inside & (speed <= limits.speed) & (acceleration <= limits.acceleration)):
            raise LimitExceeded(f"arm {self.name}: a joint would leave its limits; nothing has moved")
        with self._changed:  # no brake between the question and the motion
            state = self.state()
            self._require_permission()
            if state.moving:
                raise ArmError(f"arm {self.name} is still moving; wait until it rests, or stop it")
            self._goal, self._commanded_s = q, state.time_s
            self._send(f"move {speed.min()} {acceleration.min()} {' '.join(map(str, q.tolist()))}")

    def _require_permission(self) -> None:
        if self._refusals > self._released:
            raise MotionStopped(f"arm {self.name}: it was braked; connect again before it moves")

    def wait_settled(self, timeout_s: float) -> ArmState:
        """Wait until the arm rests at its goal. Raises ``ArmTimeout``, or what ended the motion."""

        def arrived() -> bool:
            state = self.state()
            return not state.moving and bool(np.abs(state.q - self._goal).max() < NEAR_RAD)

        with self._changed:
            if not self._changed.wait_for(lambda: self._refusals > self._released or arrived(), timeout_s):
                raise ArmTimeout(f"arm {self.name}: not at its goal after {timeout_s:g} s")
        self._require_permission()
        return self.state()

    def refuse_motion(self) -> None:
        """Accept no motion until the next ``connect``; takes no lock, so that it never waits."""
        self._refusals += 1

    def brake(self) -> None:
        """Stop, and accept no motion until the next ``connect``. Raises ``LinkLost``."""
        self.refuse_motion()
        with self._changed:
            self._changed.notify_all()
            self._send("stop")

    def stop(self) -> None:
        """Stop and wait for rest. Raises ``LinkLost``."""
        with self._changed:
            self._commanded_s = self.state().time_s
            self.brake()
            if not self._changed.wait_for(lambda: not self.state().moving, STOP_S):
                raise LinkLost(f"arm {self.name}: it was not seen at rest; look at the arm")

    def _send(self, line: str) -> None:
        try:
            if self._socket is None:
                raise LinkLost(f"arm {self.name}: not connected")
            self._socket.sendall(f"{line}\n".encode("ascii"))
        except OSError as error:
            raise LinkLost(f"arm {self.name}: {error}") from error

    def identify(self) -> ArmIdentity:
        """What the controller says of itself; a real one says more."""
        return ArmIdentity(self._arm.model, f"{self._address[0]}:{self._address[1]}", "line 1.0")

    def limits(self) -> JointLimits:
        """Limits of the joints in the controller: this one has none of its own."""
        return self._arm.limits

    def tool(self) -> Tool:
        """Payload and TCP in the controller: not reported."""
        return Tool(None, None, None)

    def warnings(self) -> tuple[str, ...]:
        """Nothing that a person should know."""
        return ()

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        """No position: the controller has no safety configuration that could be asked."""
        return np.zeros(len(q), dtype=np.bool_)
