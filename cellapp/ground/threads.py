"""How many threads linear algebra has."""

from __future__ import annotations

import ctypes
from contextlib import AbstractContextManager

from threadpoolctl import threadpool_limits


def one_blas_thread() -> AbstractContextManager[object]:
    """Linear algebra in one thread: the matrices are small, and threads that wait for one another on a busy computer
    made a search eight times slower than one thread is."""
    import scipy.linalg  # noqa: F401  # it has a BLAS of its own; only one that is loaded can be limited

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits


# -- Memory of this process -------------------------------------------------------------------------------------------


def give_back() -> None:
    """Return what was freed to the operating system, where the C library can do that (glibc).

    Between the stages of a long job: the pages of one stage would else stay beside those of the next.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # another C library; Windows takes no None
        return
    trim(0)
