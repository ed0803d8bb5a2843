"""Tracker bridge that serves the simulated tracker over the real protocol, with faults on command.

    plant = Plant(config)
    with TrackerBridgeEmulator(plant) as bridge:
        tracker = BridgeTracker(bridge.url, preparation=Preparation())
        tracker.connect()
        bridge.fault("garbage")      # the next answer comes damaged

On its own, the emulator advances the plant's clock itself, without waiting. If controllers move the plant (``cell``),
the tracker waits for their clock, with their lock released, instead.

Another process requests faults on a separate connection to the same port, before any ``hello``:
``1 fault kind=garbage*CRC``; from loopback addresses only.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from drivers.emulators.ur_controller import PacedCell
from drivers.plant import Plant
from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_links import Link
from drivers.trackers.bridge_server import Reply, TrackerService, is_loopback
from drivers.trackers.bridge_wire import BadField, WireLine
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import TrackerTimeout
from drivers.trackers.simulated import SimulatedTracker

Fault = Literal["beam", "slow", "garbage", "truncate", "silence", "drop", "repeat", "reboot", "tracker-reboot"]
FAULTS: tuple[Fault, ...] = get_args(Fault)

_MOST_FAULTS = 1000
_WATCH_S = 0.1
"""Plant time between two checks of the beam and the SMR during a measurement on a shared plant."""


class TrackerBridgeEmulator(TrackerService):
    """A ``TrackerService`` for the tracker of a ``Plant``, with faults on command.

    Attributes
    ----------
    tracker : SimulatedTracker
        Has faults of its own; change it only while no measurement runs.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        cell: PacedCell | None = None,
        imperfections: Imperfections | None = None,
        nests: Mapping[str, NDArray[np.float64]] | None = None,
        wrong_target_m: float | None = None,
        reboot_s: float = 0.5,
        slow_s: float = 3.0,
        **options: Any,
    ) -> None:
        """Configure a service for the tracker of ``plant``.

        ``cell`` is that of the controllers that move the plant, see the module docstring. A restart takes ``reboot_s``:
        real time for the bridge, plant time for the tracker. A slow answer is ``slow_s`` late. ``options`` are those of
        ``TrackerService``.
        """
        self._cell = cell
        self.tracker = SimulatedTracker(
            plant,
            imperfections or Imperfections(),
            nests=nests,
            wrong_target_m=wrong_target_m,
            pass_time=None if cell is None else self._wait,
            watch_s=float("inf") if cell is None else _WATCH_S,
        )
        super().__init__(self.tracker, lock=None if cell is None else cell.lock, **options)
        self._plant_names = (*plant.names, *(nests or {}))
        self._reboot_s, self._slow_s = reboot_s, slow_s
        # without other emulators, only measuring advances the clock
        self._tracker_down_s = 0.0 if cell is None else reboot_s
        self._faults: deque[Fault] = deque()
        self._late: deque[tuple[float, Link, int, Reply]] = deque()
        self._down_until = 0.0
        self._covered: frozenset[str] = frozenset()

    def _wait(self, duration_s: float) -> None:
        """Wait until the controllers have advanced the plant by ``duration_s`` [s]."""
        assert self._cell is not None
        try:
            self._cell.wait(duration_s)
        except TimeoutError as error:
            raise TrackerTimeout(f"tracker: {error}") from error

    def fault(self, kind: str) -> None:
        """Inject a fault into the next measurement; repeated calls queue faults for the following ones.

        Parameters
        ----------
        kind
            ``beam``: the beam is blocked during this measurement. ``slow``, ``garbage``, ``truncate``, ``silence``,
            ``repeat``: the answer is delayed, damaged, cut, lost or sent twice. ``drop``: the connection ends instead
            of an answer. ``reboot``: the bridge's computer restarts and forgets all results. ``tracker-reboot``: the
            tracker restarts.

        Raises ``ValueError`` for any other kind, and where too many wait.
        """
        known = next((fault for fault in FAULTS if fault == kind), None)
        if known is None:
            raise ValueError(f"unknown fault '{kind}'; known are {', '.join(FAULTS)}")
        if len(self._faults) >= _MOST_FAULTS:
            raise ValueError(f"{_MOST_FAULTS} faults wait already; measure first")
        self._faults.append(known)

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle all links once and send delayed answers."""
        super().poll(min(timeout_s, 0.05) if self._late else timeout_s)
        while self._late and time.monotonic() > self._late[0][0]:
            _, link, sequence, reply = self._late.popleft()
            if link in self._links.links:
                self._answer(link, sequence, reply)

    def accepts_connections(self) -> bool:
        """Return whether the emulated computer runs; during a restart, connections are closed at once."""
        return time.monotonic() >= self._down_until

    def line_received(self, link: Link, raw: bytes) -> None:
        """Execute a line; ignore it during a restart of the emulated computer."""
        if self.accepts_connections():
            super().line_received(link, raw)

    def _without_session(self, link: Link, line: WireLine) -> None:
        if line.word != "fault":
            super()._without_session(link, line)
            return
        if not link.permanent and not is_loopback(link.peer.rpartition(":")[0]):
            self._error(link, line.sequence, "refused", "only clients on this machine may request faults")
            return
        try:
            self.fault(line.fields.get("kind", ""))
        except ValueError as error:
            raise BadField(str(error)) from error
        self._answer(link, line.sequence, ("ok", {}))

    def _command(self, link: Link, line: WireLine) -> None:
        measuring = line.word == "measure" and line.fields.get("id", "") not in self._results
        if measuring and self._faults and self._active is None:
            if self._faults[0] == "tracker-reboot":
                self._faults.popleft()
                self.tracker.reboot(self._tracker_down_s)
            elif self._faults[0] == "beam":
                self._faults.popleft()
                self._covered = frozenset(self._plant_names) - self.tracker.covered
                self.tracker.covered |= self._covered
        super()._command(link, line)

    def _keep_result(self, id_: str, reply: Reply) -> None:
        self.tracker.covered -= self._covered
        self._covered = frozenset()
        super()._keep_result(id_, reply)

    def _deliver(self, link: Link, sequence: int, reply: Reply) -> None:
        measured = reply[0] == "ok" and any(key.endswith("averaging") for key in reply[1])
        kind = self._faults.popleft() if self._faults and measured else ""
        line = wire.encode(sequence, *reply)
        match kind:
            case "slow":
                self._late.append((time.monotonic() + self._slow_s, link, sequence, reply))
            case "garbage":
                damaged = bytes(byte ^ 0x15 if k % 7 == 3 else byte for k, byte in enumerate(line[:-1]))
                self._links.send(link, damaged + b"\n")
            case "truncate":
                self._links.send(link, line[: len(line) // 2])
            case "silence":
                pass
            case "drop":
                self._links.drop(link, "the fault 'drop' was requested", at_once=True)
            case "repeat":
                self._links.send(link, line + line)
            case "reboot":
                self._down_until = time.monotonic() + self._reboot_s
                self.restart()
            case _:
                super()._deliver(link, sequence, reply)
