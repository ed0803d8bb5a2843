"""Work done for each arm separately, in worker threads; the random numbers do not depend on the threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from cellapp.ground.threads import one_blas_thread

_AT_ONCE = 2
"""Number of threads: bounds the memory; more arms or cores are rare."""

Result = TypeVar("Result")


def of_each_arm(
    work: Callable[[str, np.random.Generator], Result], names: Iterable[str], rng: np.random.Generator
) -> dict[str, Result]:
    """Return arm -> ``work(arm, stream)``, each with a stream of its own that is spawned from ``rng``.

    The result is the same whichever arm is faster and however many cores there are. Matrix products and other work on
    long arrays run outside the interpreter lock. Raises what ``work`` raises for the first arm that fails.
    """
    names = tuple(names)
    # linear algebra keeps to one thread: its products are narrow, and the arms have a core each
    with one_blas_thread(), ThreadPoolExecutor(max_workers=_AT_ONCE) as threads:
        return dict(zip(names, threads.map(work, names, rng.spawn(len(names))), strict=True))
