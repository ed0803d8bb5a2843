"""When the terminal application has drawn everything: what Textual's pilot waits for after a key or a click.

Textual's own ``wait_for_idle`` takes an application for idle that used no processor for 20 ms. Beside another process
that uses all processors this holds too early, and on a free computer every key costs 40 ms. Here the application is
idle if its event loop has nothing to do now or soon and none of its threads computes or waits for a processor.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from pathlib import Path
from time import monotonic, process_time
from typing import Any

from textual._context import active_app
from textual.pilot import Pilot

_WINDOW_S = 0.005
"""Between two looks; a thread that waits for the interpreter gets it meanwhile."""
_BUSY_S = 0.0005
"""Processor time within a window that the looks themselves do not need."""
_SOON_S = 0.02
"""Timers due within this time count as work: Textual draws by one of them, 60 times a second."""
_THREADS = Path("/proc/self/task")
_MOST_TURNS = 200
"""Turns of the event loop that are waited for where a job says more and more."""


async def wait_for_idle(min_sleep: float = 0.0, max_sleep: float = 5.0) -> None:
    """Wait until the application has nothing to do, at least ``min_sleep`` and at most ``max_sleep`` [s].

    One that was told to end draws on until its test leaves it: it is not waited for.
    """
    app, began_s = active_app.get(None), monotonic()
    while monotonic() - began_s < max_sleep and (app is None or app.return_code is None):
        used_s = process_time()
        await asyncio.sleep(_WINDOW_S)
        used_s = process_time() - used_s
        if used_s < _BUSY_S and _loop_is_idle() and not _threads_compute() and monotonic() - began_s >= min_sleep:
            return


async def wait_for_screen(pilot: Pilot[None], timeout: float = 0.0) -> bool:
    """Wait until no widget has a message left, in place of a pilot's message to each of a hundred widgets; raise what
    the application has raised."""
    loop: Any = asyncio.get_running_loop()
    for _ in range(_MOST_TURNS):
        await asyncio.sleep(0)
        if pilot.app._exception is not None:
            raise pilot.app._exception
        if not loop._ready:
            return True
    return False


def _loop_is_idle() -> bool:
    """Whether no callback is ready and no timer of the loop is due soon."""
    loop: Any = asyncio.get_running_loop()
    soon_s = loop.time() + _SOON_S
    return not loop._ready and all(timer.when() > soon_s for timer in loop._scheduled if not timer.cancelled())


def _threads_compute() -> bool:
    """Whether another thread runs, waits for a processor or waits for a disk."""
    if sys.platform != "linux":
        return False
    own = threading.get_native_id()
    return any(_state(place) in "RD" for place in _THREADS.iterdir() if place.name != str(own))


def _state(place: Path) -> str:
    """State of a thread as Linux gives it: R runs or could, S sleeps, D waits for a disk."""
    try:
        return (place / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "S"  # it ended meanwhile
