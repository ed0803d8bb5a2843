"""A serial cable without hardware: two pseudo terminals and a thread that copies bytes between them."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def serial_cable() -> Iterator[tuple[str, str]]:
    """The device names of the two ends."""
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
