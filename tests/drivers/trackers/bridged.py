"""An emulated bridge and its client, over TCP or a serial cable without hardware."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.plant import Plant
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import Preparation

NEST = np.array([1.5, 2.0, -0.3])
"""Where an SMR rests that no arm carries."""


@contextmanager
def client(url: str, **options: Any) -> Iterator[BridgeTracker]:
    """A connected client, disconnected at the end."""
    tracker = BridgeTracker(url, **({"preparation": Preparation()} | options))
    tracker.connect()
    try:
        yield tracker
    finally:
        tracker.disconnect()


@contextmanager
def over(
    kind: str, plant: Plant, timeout_s: float, **options: Any
) -> Iterator[tuple[TrackerBridgeEmulator, BridgeTracker]]:
    """An emulated bridge with a nest, and a client, over ``tcp`` or a ``serial`` cable."""
    with ExitStack() as stack:
        url = ""
        if kind == "serial":
            theirs, url = stack.enter_context(serial_cable())
            options |= {"port": None, "serial_url": theirs}
        bridge = stack.enter_context(TrackerBridgeEmulator(plant, nests={"n": NEST}, **options))
        yield bridge, stack.enter_context(client(url or bridge.url, timeout_s=timeout_s))


@contextmanager
def serial_cable() -> Iterator[tuple[str, str]]:
    """The device names of two pseudo terminals, between which a thread copies bytes."""
    masters, slaves = [], []
    for _ in range(2):
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        masters.append(master)
        slaves.append(slave)
    stop_read, stop_write = os.pipe()

    def carry() -> None:
        while True:
            ready, _, _ = select.select([*masters, stop_read], [], [])
            if stop_read in ready:
                return
            for source, sink in (masters, masters[::-1]):
                if source in ready and not deliver(os.read(source, 4096), sink):
                    return

    def deliver(data: bytes, sink: int) -> bool:
        """Write all bytes, however long the reader takes; return False when the cable is taken away meanwhile."""
        while data:
            stop, _, _ = select.select([stop_read], [sink], [])
            if stop:
                return False
            data = data[os.write(sink, data) :]
        return True

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()
    try:
        # the slaves stay open here: a terminal that nobody holds open would read as hung up
        yield os.ttyname(slaves[0]), os.ttyname(slaves[1])
    finally:
        os.write(stop_write, b"!")
        thread.join(10.0)
        for descriptor in (*masters, *slaves, stop_read, stop_write):
            os.close(descriptor)
