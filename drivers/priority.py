"""Running before other programs of this computer, as far as the system permits.

On Linux and macOS usual users may not, on Linux without a limit ``nice`` or ``rtprio`` for them; then nothing changes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_LEAST_REAL_TIME = 1


def run_first(niceness: int) -> None:
    """Prefer this thread, and the threads and processes that it starts from now on; on macOS the whole process.

    Where Linux shares the processors among sessions first (``sched_autogroup``), this counts within a session only.
    """
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)


@contextmanager
def in_real_time(*, inherited: bool = False) -> Iterator[bool]:
    """Run this thread as soon as it has something to do while this context is open; whether that is permitted.

    For what stands for another computer, and for what measures times: neither may compute for long, as all else waits
    meanwhile. ``inherited``: threads and processes that are started meanwhile run so, too, and keep it.
    """
    flags = () if inherited else ("SCHED_RESET_ON_FORK",)
    permitted = _schedule("SCHED_RR", *flags)
    try:
        yield permitted
    finally:
        if permitted:
            _schedule("SCHED_OTHER", *flags)  # not everybody may lower that flag


def _schedule(*flags: str) -> bool:
    if sys.platform != "linux":
        return False
    policy = sum(getattr(os, flag) for flag in flags)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(_LEAST_REAL_TIME if "SCHED_RR" in flags else 0))
    except OSError:
        return False
    return True
