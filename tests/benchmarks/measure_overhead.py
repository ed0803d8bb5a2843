"""What a task costs beside its own time, by command: ``python -m tests.benchmarks.measure_overhead``.

Tasks that only square a number run on two local processes, then on two Dask workers on loopback.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from cellapp.ground.scale.executor import Resources
from cellapp.ground.scale.gather import gather
from tests.ground.scale.dask_processes import scheduler, workers
from tests.ground.scale.kinds import Number, Shared, squares

_TASKS, _WARM = 400, 10
"""Tasks, and those of them before time counts: processes have started then."""


def measured(folder: Path, resources: Resources) -> str:
    """Wall time and processor time of this process for one task, in words."""
    times: list[tuple[float, float]] = []
    gather(
        squares(Shared(folder=str(folder)), *(Number(value=value) for value in range(_TASKS))),
        "squares",
        resources,
        lambda event: times.append((time.perf_counter(), time.process_time())),
    )
    wall_ms, cpu_ms = ((times[-1][k] - times[_WARM][k]) / (_TASKS - _WARM) * 1e3 for k in (0, 1))
    return f"{wall_ms:.2f} ms a task, {cpu_ms:.2f} ms of them work of this process\n"


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sys.stdout.write(f"two local processes: {measured(folder, Resources(jobs=2))}")
        with scheduler(folder) as (_, address), workers(address, folder, 2):
            sys.stdout.write(f"two Dask workers: {measured(folder, Resources(scheduler=address))}")


if __name__ == "__main__":
    main()
