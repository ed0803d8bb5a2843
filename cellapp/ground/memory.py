"""Memory of this process."""

from __future__ import annotations

import ctypes


def give_back() -> None:
    """Return what was freed to the operating system, where the C library can do that (glibc).

    Between the stages of a long job: the pages of one stage would else stay beside those of the next.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # another C library; Windows takes no None
        return
    trim(0)
