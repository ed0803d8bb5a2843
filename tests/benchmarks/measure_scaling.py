"""Efficiency from one worker to two, by command: ``python -m tests.benchmarks.measure_scaling [TASKS]``.

The same tasks of the trial ``parameter-sets`` (a quarter of a second each) are computed by one local process, by two,
and by a Dask cluster of one and of two workers on loopback. Time counts from the end of the first tasks on, when all
workers have started. Efficiency is the time of one worker over twice the time of two; ``busy`` is the share of the
workers' time in which they had a task. On a computer that others use, efficiency falls with their load; ``busy`` and
the processor time of a task hardly do.
"""

from __future__ import annotations

import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.parameter_sets import IDENTIFY_STOPS, SETS, VALIDATE_STOPS
from cellapp.commands.trials.planned_cell import ArmSeed, PlannedCell, planned_cell
from cellapp.ground.scale.executor import Resources
from cellapp.ground.scale.gather import gather
from cellapp.ground.scale.store import ResultStore
from cellapp.ground.scale.task import Batch
from tests.ground.scale.dask_processes import scheduler, workers

ROOT = Path(__file__).parents[2]
_TASKS = 40
_WARM = 4
"""Tasks before time counts: two for each of two workers."""


def timed(planned: PlannedCell, tasks: int, resources: Resources) -> tuple[float, str]:
    """Time of one task [s], and the results as text; printed, too."""
    drawn = [ArmSeed(arm="left", seed=seed) for seed in range(tasks)]
    times: list[float] = []
    gathered = gather(
        Batch(SETS, planned, drawn, [f"seed {seed}" for seed in range(tasks)]),
        "sets",
        resources,
        lambda event: times.append(time.perf_counter()),
    )
    assert resources.store is not None
    with ResultStore.open(resources.store) as store:
        task_s = sum(cost.wall_s for cost in store.costs()) / tasks
        work_s = sum(cost.cpu_s for cost in store.costs()) / tasks
    each_s = (times[-1] - times[_WARM]) / (tasks - _WARM)
    busy = task_s / (gathered.workers * each_s)
    say(f"{resources.store.stem}: {each_s:.3f} s a task, {work_s:.3f} s of processor, workers busy {busy:.1%}")
    return each_s, "".join(one.model_dump_json() for one in gathered.found)


def main(tasks: int) -> None:
    """Measure and print."""
    planned = planned_cell(load_profile(ROOT / "profiles" / "twin.yaml"), IDENTIFY_STOPS + VALIDATE_STOPS)
    found: dict[tuple[str, int], tuple[float, str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for place in ("local", "dask"):
            for count in (1, 2):
                with ExitStack() as stack:
                    address = None
                    if place == "dask":
                        _, address = stack.enter_context(scheduler(folder))
                        stack.enter_context(workers(address, folder, count))
                    jobs = count if address is None else None
                    where = Resources(jobs, address, folder / f"{place}-{count}.sqlite")
                    found[place, count] = timed(planned, tasks, where)
    for place in ("local", "dask"):
        say(f"{place}: efficiency from 1 to 2 workers {found[place, 1][0] / (2.0 * found[place, 2][0]):.1%}")
    say(f"the same results everywhere: {len({text for _, text in found.values()}) == 1}")


def say(text: str) -> None:
    """Print a line."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else _TASKS)
