"""Scheduling priority over other programs of this computer, as far as the system permits.

On Linux and macOS ordinary users may not raise it, on Linux unless they have a limit ``nice`` or ``rtprio``; then
nothing changes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_LEAST_REAL_TIME = 1


def run_first(niceness: int) -> None:
    """Raise the priority of this thread and of threads and processes that it starts later; on macOS of the process.

    If Linux shares the processors among sessions first (``sched_autogroup``), this counts only within a session.
    """
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)


@contextmanager
def in_real_time(*, inherited: bool = False) -> Iterator[bool]:
    """Give this thread real-time scheduling while this context is open; yield whether that is permitted.

    For emulations of another computer and for time measurements. Neither may compute for long, as everything else waits
    meanwhile. ``inherited``: threads and processes started meanwhile get it too, and keep it.
    """
    flags = () if inherited else ("SCHED_RESET_ON_FORK",)
    permitted = _schedule("SCHED_RR", *flags)
    try:
        yield permitted
    finally:
        if permitted:
            _schedule("SCHED_OTHER", *flags)  # lowering that flag needs a privilege


def _schedule(*flags: str) -> bool:
    if sys.platform != "linux":
        return False
    policy = sum(getattr(os, flag) for flag in flags)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(_LEAST_REAL_TIME if "SCHED_RR" in flags else 0))
    except OSError:
        return False
    return True
