"""Server loop for all controllers of a cell in one thread, and the functions that start it."""

from __future__ import annotations

import multiprocessing
import selectors
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Self

import numpy as np

from drivers.emulators.ur_controller import dashboard, primary
from drivers.emulators.ur_controller.control import Control, ControlSession, Emulated, execute
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.links import LinkService, Peer, Port
from drivers.emulators.ur_controller.motion import PacedCell
from drivers.emulators.ur_controller.personality import ControllerConfig, PortName
from drivers.emulators.ur_controller.rtde import RtdeServer, RtdeSession
from drivers.emulators.ur_controller.script import Upload
from drivers.plant import ArmConfig, Plant, PlantConfig, TrackerConfig
from drivers.priority import in_real_time, run_first

_LONGEST_LINE = 4096
_JOIN_S = 10.0
_START_S = 60.0
_NICENESS = -15
"""Niceness of the separate process: a real controller is a computer of its own, which no busy-waiting client delays."""
REAL_TIME = 1.0
"""Largest pace for real-time scheduling: up to it the controllers wait most of the time and block no other program."""
_MAX_BEHIND = 5
"""Missed control cycles that are executed late; more are skipped."""


@dataclass(frozen=True)
class Addresses:
    """Addresses (host, port) of the controllers and the control channel."""

    arms: Mapping[str, Mapping[PortName, tuple[str, int]]]
    control: tuple[str, int]


class _DashboardSession:
    def __init__(self, arm: Controller, link: Peer, received: deque[str]) -> None:
        self._arm, self._link, self._log = arm, link, received
        self._received = bytearray()
        self._opened_in_remote = arm.accepts_commands
        link.send(f"{dashboard.GREETING}\n".encode())

    def received(self, data: bytes) -> None:
        self._received += data
        while not (self._link.closing or self._link.gone) and (end := self._received.find(b"\n")) >= 0:
            line = self._received[:end].decode("utf-8", errors="replace").strip()
            del self._received[: end + 1]
            self._log.append(line)
            answer = dashboard.answer(self._arm, line, opened_in_remote=self._opened_in_remote)
            self._link.send(f"{answer}\n".encode())
            if line == "quit":
                self._link.close_after_send()
        if len(self._received) > _LONGEST_LINE:
            self._link.close_after_send()

    def closed(self) -> None:
        pass


class _ScriptSession:
    """Receives programs; with ``greet``, for the primary port, also sends the robot state."""

    def __init__(self, arm: Controller, link: Peer, *, greet: bool) -> None:
        self._arm, self._upload = arm, Upload()
        if greet:
            link.send(primary.version_message(arm) + primary.first_state(arm))

    def received(self, data: bytes) -> None:
        for program in self._upload.take(data):
            self._arm.upload(program)

    def closed(self) -> None:
        pass


class _Arm(Emulated):
    """One controller, its ports and the due times of its next cycle and robot state."""

    def __init__(self, controller: Controller, selector: selectors.BaseSelector) -> None:
        config = controller.config
        received: deque[str] = deque(maxlen=1000)
        self._streams: dict[Peer, RtdeSession] = {}
        sessions: dict[PortName, Callable[[Peer], LinkService]] = {
            "dashboard": lambda link: _DashboardSession(controller, link, received),
            "primary": lambda link: _ScriptSession(controller, link, greet=True),
            "script": lambda link: _ScriptSession(controller, link, greet=False),
            "rtde": self._open_rtde,
        }
        ports = {
            name: Port(selector, config.host, config.ports[name], open_session)
            for name, open_session in sessions.items()
        }
        super().__init__(controller, RtdeServer(controller), ports, received)
        self.due_s = 0.0
        self._state_due_s = 0.0

    def _open_rtde(self, link: Peer) -> RtdeSession:
        session = RtdeSession(self.rtde, link.send, link.stream, lambda: link.port.drop(link))
        self._streams[link] = session
        return session

    def cycle(self, now_s: float) -> None:
        """Execute one control cycle and stream the state."""
        controller = self.controller
        self.due_s += controller.period_s
        if now_s - self.due_s > _MAX_BEHIND * controller.period_s:
            self.due_s = now_s + controller.period_s
        controller.cycle(now_s)
        for link, session in list(self._streams.items()):
            if link.gone:
                del self._streams[link]
            else:
                session.cycle()
        if now_s >= self._state_due_s:
            self._state_due_s = now_s + primary.PERIOD_S
            port = self.ports["primary"]
            if port.links:
                state = primary.state(controller)
                for link in list(port.links):
                    link.stream(state)
        for port in self.ports.values():
            port.tick(now_s)


def ideal(arms: Sequence[ControllerConfig]) -> Plant:
    """Return a plant of ideal arms: exact, rigid, without weight, all at one place."""
    found = tuple(
        ArmConfig(
            name=arm.name,
            rows=np.array(arm.personality.rows),
            limits=np.array(arm.limits),
            speed=np.array(arm.speed),
            acceleration=np.array(arm.acceleration),
            T_C_B=np.eye(4),
            smr_offset=np.zeros(3),
            smr_normal=np.array([0.0, 0.0, 1.0]),
            smr_acceptance=np.pi,
            masses=np.zeros(6),
            centers_of_mass=np.zeros((6, 3)),
            home=np.array(arm.home),
        )
        for arm in arms
    )
    return Plant(PlantConfig(0, found, TrackerConfig(np.eye(4))))


class UrControllerServer:
    """Controllers of one cell. A ``with`` block serves them in a background thread; ``run`` serves in the foreground.

    Clients that hold the interpreter's lock while connecting, such as ur_rtde, must be in another process: see
    ``start_in_process``.

    Attributes
    ----------
    cell : PacedCell
        The motions, their clock and lock. Another server in this process, such as a tracker's, runs in a thread of its
        own, holds ``cell.lock`` while it accesses the plant, and waits with ``cell.wait``.
    failure : Exception or None
        The exception that ended the background thread early; all ports are closed then.
    """

    def __init__(
        self, arms: Sequence[ControllerConfig], plant: Plant | None = None, pace: float = 1.0, control_port: int = 0
    ) -> None:
        """Configure controllers for ``arms`` that move ``plant`` (None: ideal joints).

        Raises ``ValueError`` if an arm is not in the plant, has another number of joints, or two share a name.
        """
        names = [arm.name for arm in arms]
        if not arms or len(set(names)) != len(names):
            raise ValueError(f"arms: expected one or more, each with its own name; got {', '.join(names) or 'none'}")
        plant = ideal(arms) if plant is None else plant
        for name in names:
            if name not in plant.names:
                raise ValueError(f"arm {name}: not in the plant; its arms are {', '.join(plant.names)}")
            if len(plant.q(name)) != 6:
                raise ValueError(f"arm {name}: the plant gives it {len(plant.q(name))} joints, a UR arm has 6")
        self.cell = PacedCell(plant, pace)
        # select() takes microseconds; epoll would round a cycle of 2 ms up to the next millisecond
        self._selector = selectors.SelectSelector()
        self._arms = {arm.name: _Arm(Controller(arm, plant), self._selector) for arm in arms}
        self._control = Port(self._selector, "127.0.0.1", control_port, self._open_control)
        self._wake: tuple[socket.socket, socket.socket] | None = None
        self._thread: threading.Thread | None = None
        self._closing = False
        self.failure: Exception | None = None

    def _open_control(self, link: Peer) -> ControlSession:
        return ControlSession(link.send, lambda line: execute(line, self._arms, self.cell, time.monotonic()))

    # -- life --------------------------------------------------------------------------------------------------------

    def open(self) -> Addresses:
        """Open all ports. Raises ``OSError`` with the arm and the address; then nothing stays open."""
        if self._wake is not None:
            raise RuntimeError("the emulator was started already")
        self._closing = False
        self._wake = socket.socketpair()
        for end in self._wake:
            end.setblocking(False)
        self._selector.register(self._wake[1], selectors.EVENT_READ)
        try:
            for name, arm in self._arms.items():
                for port in arm.ports.values():
                    try:
                        port.listen()
                    except OSError as error:
                        raise OSError(error.errno, f"arm {name}: {error.strerror}") from error
            self._control.listen()
        except OSError:
            self._close()
            raise
        return self.addresses

    @property
    def addresses(self) -> Addresses:
        """Addresses of all ports, once they are open."""
        arms = {
            name: {known: (port.host, port.number) for known, port in arm.ports.items()}
            for name, arm in self._arms.items()
        }
        return Addresses(arms, (self._control.host, self._control.number))

    def __enter__(self) -> Self:
        self.open()
        self._thread = threading.Thread(target=self._run_in_thread, name="UR controllers", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
            self._thread = None

    def stop(self) -> None:
        """Make ``run`` return; from any thread."""
        self._closing = True
        if self._wake is not None:
            with suppress(OSError):  # full: the loop wakes anyway; closed: it has ended
                self._wake[0].send(b"!")

    def _run_in_thread(self) -> None:
        try:
            self.run()
        except Exception as error:  # noqa: BLE001 - reported by ``failure``
            self.failure = error

    def control(self) -> Control:
        """Return a new connection to the control channel; the caller closes it."""
        return Control(self.addresses.control)

    def _close(self) -> None:
        for arm in self._arms.values():
            for port in arm.ports.values():
                port.close()
        self._control.close()
        if self._wake is not None:
            self._selector.unregister(self._wake[1])
            for end in self._wake:
                end.close()
            self._wake = None

    # -- loop --------------------------------------------------------------------------------------------------------

    def run(self, stop_when_readable: Connection | None = None) -> None:
        """Serve until ``stop`` or until ``stop_when_readable`` closes, then close all ports; call ``open`` before."""
        if stop_when_readable is not None:
            self._selector.register(stop_when_readable.fileno(), selectors.EVENT_READ, self.stop)
        try:
            now_s = time.monotonic()
            self.cell.catch_up(now_s)
            for arm in self._arms.values():
                arm.due_s = now_s
            while not self._closing:
                due_s = min(arm.due_s for arm in self._arms.values())
                ready = self._selector.select(max(0.0, due_s - time.monotonic()))
                with self.cell.lock:
                    for key, events in ready:
                        self._handle(key, events)
                    now_s = time.monotonic()
                    if any(arm.due_s <= now_s for arm in self._arms.values()):
                        self.cell.catch_up(now_s)
                        for arm in self._arms.values():
                            if arm.due_s <= now_s:
                                arm.cycle(now_s)
        finally:
            self._close()
            if stop_when_readable is not None:
                self._selector.unregister(stop_when_readable.fileno())

    def _handle(self, key: selectors.SelectorKey, events: int) -> None:
        if isinstance(key.data, Peer):
            key.data.port.handle(key.data, events)
        elif isinstance(key.data, Port):
            key.data.accept()
        elif key.data is not None:
            key.data()
        else:
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.recv(_LONGEST_LINE)


# -- a separate process ---------------------------------------------------------------------------------------------


class EmulatorProcess:
    """Controllers in a separate process; ``close`` or ``with`` ends it. It also ends with its parent.

    Attributes
    ----------
    addresses : Addresses
    control : Control
        A client of the control channel.
    pid : int
    """

    def __init__(self, process: multiprocessing.process.BaseProcess, pipe: Connection, addresses: Addresses) -> None:
        self._process, self._pipe = process, pipe
        self.addresses = addresses
        self.control = Control(addresses.control)
        assert process.pid is not None
        self.pid = process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process; harmless when it has ended."""
        self.control.close()
        self._pipe.close()
        self._process.join(_JOIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()


def start_in_process(arms: Sequence[ControllerConfig], pace: float = 1.0) -> EmulatorProcess:
    """Start controllers in a separate process and return when all ports are open.

    Raises ``OSError`` if a port is in use, ``ValueError`` like ``UrControllerServer`` and ``Plant``, ``TimeoutError``
    if the process does not start.
    """
    context = multiprocessing.get_context("spawn")
    parent_end, child_end = context.Pipe()
    process = context.Process(
        target=_serve_in_process, args=(child_end, tuple(arms), pace), name="UR controllers", daemon=True
    )
    process.start()
    child_end.close()
    try:
        if not parent_end.poll(_START_S):
            raise TimeoutError(f"the emulator's process did not start within {_START_S:g} s")
        answer = parent_end.recv()
    except (EOFError, TimeoutError) as error:
        process.kill()
        process.join()
        parent_end.close()
        raise TimeoutError(f"the emulator's process did not start: {error or 'it ended'}") from error
    if not isinstance(answer, Addresses):
        process.join(_JOIN_S)
        parent_end.close()
        raise answer
    return EmulatorProcess(process, parent_end, answer)


def _serve_in_process(pipe: Connection, arms: Sequence[ControllerConfig], pace: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends when the parent closes the pipe
    run_first(_NICENESS)
    try:
        server = UrControllerServer(arms, None, pace)
        addresses = server.open()
    except (OSError, ValueError) as error:
        pipe.send(error)
        return
    pipe.send(addresses)
    with in_real_time(inherited=True) if pace <= REAL_TIME else nullcontext():
        server.run(stop_when_readable=pipe)
