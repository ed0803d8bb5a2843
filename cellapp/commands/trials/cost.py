"""Cost of trials: processor time and memory of the tasks in a store, and thus of many more."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellapp.commands.view.table import Table, table_of
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.store import Cost, ResultStore


class TaskCost(Record):
    """Tasks of one job.

    Attributes
    ----------
    job : str
    tasks : int
    mean_s, median_s, longest_s : float
        Processor time of one task, in one thread [s].
    waited : float
        Wall time over processor time, of all tasks: more than 1 where processes waited for a core.
    peak_mb : float, optional
        Largest memory of a process that computed such tasks [MB]; None where the system does not say.
    core_hours : float
        One core's time for as many tasks as were asked for, by the mean [h].
    """

    job: str
    tasks: int
    mean_s: float
    median_s: float
    longest_s: float
    waited: float
    peak_mb: float | None
    core_hours: float


class CostResult(Result, schema="cellapp-trials-cost"):
    """``trials cost``: what ``tasks`` tasks of each job in a store would take."""

    tasks: int
    jobs: tuple[TaskCost, ...]


def cost_of(path: Path, tasks: int) -> CostResult:
    """Estimate the cost of ``tasks`` tasks of each job in a store. Raises ``InputError`` if it is no store or empty."""
    with ResultStore.open(path, new=False) as store:
        costs = store.costs()
    if not costs:
        raise InputError(f"{path} holds no results yet")
    by_job = grouped((cost.job, cost) for cost in costs)
    return CostResult(tasks=tasks, jobs=tuple(_cost(job, some, tasks) for job, some in sorted(by_job.items())))


def cost_table(result: CostResult) -> Table:
    """Show one line for each job."""
    return table_of(
        "Processor time of one core and memory of one process",
        result.jobs,
        ("job", "job"),
        ("tasks", "tasks", "d"),
        ("mean", "mean_s", ".3g", "s"),
        ("median", "median_s", ".3g", "s"),
        ("longest", "longest_s", ".3g", "s"),
        ("wall/processor", "waited", ".2f"),
        ("memory", "peak_mb", ".0f", "MB"),
        (f"{result.tasks:,} tasks", "core_hours", ".4g", "core hours"),
    )


def _cost(job: str, costs: list[Cost], tasks: int) -> TaskCost:
    seconds = np.array([cost.cpu_s for cost in costs])
    return TaskCost(
        job=job,
        tasks=len(costs),
        mean_s=float(seconds.mean()),
        median_s=float(np.median(seconds)),
        longest_s=float(seconds.max()),
        waited=sum(cost.wall_s for cost in costs) / max(float(seconds.sum()), 1e-9),
        peak_mb=max((cost.peak_mb for cost in costs if cost.peak_mb is not None), default=None),
        core_hours=float(seconds.mean()) * tasks / 3600.0,
    )
