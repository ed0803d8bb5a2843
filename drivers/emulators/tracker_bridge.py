"""A tracker bridge with the simulated tracker behind it, on the real wire, and faults on command.

    plant = Plant(config)
    with TrackerBridgeEmulator(plant) as bridge:
        tracker = BridgeTracker(bridge.url, preparation=Preparation())
        tracker.connect()
        bridge.fault("garbage")      # the next answer comes damaged

Alone it passes the plant's time itself, at once. Where other emulators share the plant, one of them advances its clock
and all hold one lock: give that lock as a ``threading.Condition`` (``clock``), and the tracker waits for the plant's
clock, with the lock released, instead of advancing it.

From another process, faults are asked for on a connection of their own to the same port, before any ``hello``:
``1 fault kind=garbage*CRC``; loopback clients only.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_server import Link, Reply, TrackerService, is_loopback
from drivers.trackers.bridge_wire import BadField, Line
from drivers.trackers.protocol import TrackerTimeout
from drivers.trackers.simulated import Imperfections, SimulatedTracker

Fault = Literal["beam", "slow", "garbage", "truncate", "silence", "drop", "repeat", "reboot", "tracker-reboot"]
FAULTS: tuple[Fault, ...] = get_args(Fault)

_STANDSTILL_S = 30.0
_POLL_S = 0.005
_WATCH_S = 0.1


class WaitingClock:
    """Lets the plant's time pass by waiting for whoever advances it; called with ``clock`` held.

    Raises ``TrackerTimeout`` where the plant's clock has stood still for half a minute.
    """

    def __init__(self, plant: Plant, clock: threading.Condition) -> None:
        self._plant, self._clock = plant, clock

    def __call__(self, duration_s: float) -> None:
        """Wait until ``duration_s`` [s] of the plant have passed; ``clock`` is released meanwhile."""
        until_s = self._plant.clock_s + duration_s
        seen_s, last = self._plant.clock_s, time.monotonic()
        while self._plant.clock_s < until_s:
            self._clock.wait(_POLL_S)
            if self._plant.clock_s != seen_s:
                seen_s, last = self._plant.clock_s, time.monotonic()
            elif time.monotonic() - last > _STANDSTILL_S:
                raise TrackerTimeout("tracker: the simulated cell's clock stands still; nobody advances the plant")


class TrackerBridgeEmulator(TrackerService):
    """A bridge that serves the tracker of a ``Plant``; otherwise as ``TrackerService``, whose options it takes.

    Attributes
    ----------
    tracker : SimulatedTracker
        With faults of its own; touch it only while nothing is measured.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        clock: threading.Condition | None = None,
        imperfections: Imperfections | None = None,
        nests: Mapping[str, NDArray[np.float64]] | None = None,
        wrong_target_m: float | None = None,
        reboot_s: float = 0.5,
        slow_s: float = 3.0,
        **options: Any,
    ) -> None:
        """Prepare to serve the tracker of ``plant``.

        ``clock`` is the lock of a shared plant, see above. A restart takes ``reboot_s`` of real time for the bridge,
        and of the plant's for the tracker; a slow answer is ``slow_s`` late. ``options`` are those of the service.
        """
        pass_time: Callable[[float], None] | None = None if clock is None else WaitingClock(plant, clock)
        self.tracker = SimulatedTracker(
            plant,
            imperfections or Imperfections(),
            nests=nests,
            wrong_target_m=wrong_target_m,
            pass_time=pass_time,
            watch_s=float("inf") if clock is None else _WATCH_S,
        )
        super().__init__(self.tracker, lock=clock, **options)
        self._plant_names = (*plant.names, *(nests or {}))
        self._reboot_s, self._slow_s = reboot_s, slow_s
        self._tracker_down_s = 0.0 if clock is None else reboot_s  # alone, only measuring passes time
        self._faults: deque[Fault] = deque()
        self._late: deque[tuple[float, Link, int, Reply]] = deque()
        self._down_until = 0.0
        self._covered: frozenset[str] = frozenset()

    def fault(self, kind: str) -> None:
        """Let something go wrong with the next measurement; several of them one after the other.

        Parameters
        ----------
        kind
            ``beam``: something stands in the beam, for this measurement alone. ``slow``, ``garbage``, ``truncate``,
            ``silence``, ``repeat``: what happens to its answer on the way. ``drop``: the link goes when the answer
            should come. ``reboot``: the bridge's computer restarts, and forgets. ``tracker-reboot``: the tracker does.

        Raises ``ValueError`` for any other word.
        """
        known = next((fault for fault in FAULTS if fault == kind), None)
        if known is None:
            raise ValueError(f"there is no fault '{kind}'; there are {', '.join(FAULTS)}")
        self._faults.append(known)

    def poll(self, timeout_s: float = 0.0) -> None:
        """Look after all links once; late answers go out."""
        super().poll(min(timeout_s, 0.05) if self._late else timeout_s)
        while self._late and time.monotonic() > self._late[0][0]:
            _, link, sequence, reply = self._late.popleft()
            if link in self._links:
                self._answer(link, sequence, reply)

    def _accept(self) -> None:
        if time.monotonic() >= self._down_until:
            super()._accept()
        elif self._listening is not None:  # as a computer that is starting: nobody is home
            self._listening.accept()[0].close()

    def _hear(self, link: Link, raw: bytes) -> None:
        if time.monotonic() >= self._down_until:
            super()._hear(link, raw)

    def _stranger(self, link: Link, line: Line) -> None:
        if line.word != "fault":
            super()._stranger(link, line)
            return
        if not link.permanent and not is_loopback(link.peer.rpartition(":")[0]):
            self._error(link, line.sequence, "refused", "faults are for clients on this machine")
            return
        try:
            self.fault(line.fields.get("kind", ""))
        except ValueError as error:
            raise BadField(str(error)) from error
        self._answer(link, line.sequence, ("ok", {}))

    def _command(self, link: Link, line: Line) -> None:
        measuring = line.word in ("measure", "two-face") and line.fields.get("id", "") not in self._kept
        if measuring and self._faults and self._job is None:
            if self._faults[0] == "tracker-reboot":
                self._faults.popleft()
                self.tracker.reboot(self._tracker_down_s)
            elif self._faults[0] == "beam":
                self._faults.popleft()
                self._covered = frozenset(self._plant_names) - self.tracker.covered
                self.tracker.covered |= self._covered
        super()._command(link, line)

    def _keep(self, id_: str, reply: Reply) -> None:
        self.tracker.covered -= self._covered
        self._covered = frozenset()
        super()._keep(id_, reply)

    def _finish(self, link: Link, sequence: int, reply: Reply) -> None:
        measured = reply[0] == "ok" and any(key.endswith("averaging") for key in reply[1])
        kind = self._faults.popleft() if self._faults and measured else ""
        line = wire.encode(sequence, *reply)
        match kind:
            case "slow":
                self._late.append((time.monotonic() + self._slow_s, link, sequence, reply))
            case "garbage":
                self._send(link, bytes(byte ^ 0x15 if k % 7 == 3 else byte for k, byte in enumerate(line[:-1])) + b"\n")
            case "truncate":
                self._send(link, line[: len(line) // 2])
            case "silence":
                pass
            case "drop":
                self._drop(link, "a dropped link was asked for", forever=True)
            case "repeat":
                self._send(link, line + line)
            case "reboot":
                self._down_until = time.monotonic() + self._reboot_s
                self.forget()
            case _:
                super()._finish(link, sequence, reply)
