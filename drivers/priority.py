"""Running before other programs of this computer, as far as the system permits.

On Linux and macOS usual users may not, on Linux without a limit ``nice`` or ``rtprio`` for them; then nothing changes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_LEAST_REAL_TIME = 1
_AUTOGROUP = Path("/proc/self/autogroup")


def run_first(niceness: int) -> None:
    """Prefer this thread, and the threads and processes that it starts from now on; on macOS the whole process."""
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)


def session_first(niceness: int) -> None:
    """Prefer the session of this process, which must be its own.

    Linux may share the processors among sessions first, so that a niceness counts only within one.
    """
    with suppress(OSError):  # no such sharing, or not permitted
        if os.getsid(0) == os.getpid():
            _AUTOGROUP.write_text(str(niceness), "ascii")


def run_in_real_time() -> bool:
    """Run this thread, and what it starts, as soon as it has something to do; return whether that is permitted.

    For what stands for another computer. It must not compute for long: everything else waits meanwhile.
    """
    return _schedule("SCHED_RR")


@contextmanager
def in_real_time() -> Iterator[bool]:
    """Run this thread alone so while this context is open, to measure times; whether that is permitted."""
    permitted = _schedule("SCHED_RR", "SCHED_RESET_ON_FORK")
    try:
        yield permitted
    finally:
        if permitted:
            _schedule("SCHED_OTHER", "SCHED_RESET_ON_FORK")  # who may not lower that flag may keep it


def _schedule(*flags: str) -> bool:
    if sys.platform != "linux":
        return False
    policy = sum(getattr(os, flag) for flag in flags)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(_LEAST_REAL_TIME if "SCHED_RR" in flags else 0))
    except OSError:
        return False
    return True
