"""What a computer needs for work that any other can repeat: the measure for the times of the handbook.

    python -m tests.benchmarks.reference_time

Printed are the processor and the median processor time of three jobs of one thread: a least-squares problem of the
size of one arm's calibration (1200 x 27), a product of matrices, and a loop in Python. A time of the handbook that is a
number of *loops* is that number times the last one here.
"""

from __future__ import annotations

import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

_ROUNDS = 15
_LOOPS = 1_000_000


def processor() -> str:
    """Name of the processor, as the system states it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def median_s(job: Callable[[], object]) -> float:
    """Median processor time of a job [s]: what others do on the computer counts little in it."""
    times = []
    for _ in range(_ROUNDS):
        began = time.process_time()
        job()
        times.append(time.process_time() - began)
    return statistics.median(times)


def loop_s() -> float:
    """The reference that ratios are of: processor time of a million rounds of a loop in Python [s]."""
    return median_s(_loop)


def _loop() -> int:
    total = 0
    for number in range(_LOOPS):
        total += number & 7
    return total


def main() -> None:
    """Print processor and times."""
    rng = np.random.default_rng(0)
    columns, wanted, square = rng.normal(size=(1200, 27)), rng.normal(size=1200), rng.normal(size=(600, 600))
    jobs: dict[str, Callable[[], object]] = {
        "numpy.linalg.lstsq, 1200 x 27": lambda: np.linalg.lstsq(columns, wanted, rcond=None),
        "product of matrices, 600 x 600": lambda: square @ square,
        f"loop in Python, {_LOOPS} rounds": _loop,
    }
    sys.stdout.write(f"{processor()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    with threadpool_limits(1):
        for name, job in jobs.items():
            sys.stdout.write(f"{name:32} {1e3 * median_s(job):8.2f} ms\n")


if __name__ == "__main__":
    main()
