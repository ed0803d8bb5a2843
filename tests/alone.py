"""Tests that need the computer for themselves, although others run in a second process: one lock for both processes."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ALONE = ("tests/tui/",)
"""The terminal application draws when it is idle, which a calculation in another process may delay too long."""

_LOCKED = (Path(__file__), Path(__file__).with_name("conftest.py"))
"""Files whose locks are turnstile and room: they are there, and nobody has to remove them."""


@contextmanager
def turn(place: str) -> Iterator[None]:
    """Hold the lock of this checkout: exclusively for a test file that needs to be alone, else shared with others.

    Everyone passes a turnstile first, so that one who waits for exclusive use is not overtaken for ever. Without
    several processes there is nothing to hold.
    """
    if "PYTEST_XDIST_TESTRUNUID" not in os.environ or sys.platform == "win32":
        yield
        return
    import fcntl

    mode = fcntl.LOCK_EX if place.startswith(ALONE) else fcntl.LOCK_SH
    with ExitStack() as stack:
        turnstile, room = (stack.enter_context(path.open("rb")) for path in _LOCKED)
        fcntl.flock(turnstile, fcntl.LOCK_EX)
        fcntl.flock(room, mode)
        fcntl.flock(turnstile, fcntl.LOCK_UN)
        yield
