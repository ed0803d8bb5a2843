"""What the readings of a run lack, and how its reference measurements drifted; nothing is written."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.run.collection_rows import select_late
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.records import MissingReading, ReferenceDrift


def missing_readings(run: RunFile) -> tuple[MissingReading, ...]:
    """List the planned readings that a run lacks, with reasons; reserve stops that were not needed are not missing."""
    plan = run.read_plan()
    total = len(next(iter(plan.values()))) if plan else 0
    outcomes = {(one.stop, one.arm): one for one in run.outcomes()}
    stored = {name: set(run.rows(name).configuration.tolist()) for name in plan}
    reserves = run.profile.plan.reserves(total)
    missing = []
    for stop in range(total):
        for name in plan:
            outcome = outcomes.get((stop, name))
            if stop in stored[name] or (outcome is None and stop in reserves):
                continue
            if outcome is None:
                missing.append(MissingReading(stop=stop, arm=name, kind="not tried", reason="the session ended before"))
            else:
                missing.append(MissingReading.like(outcome))
    return tuple(missing)


def missing_share(run: RunFile, missing: Sequence[MissingReading]) -> float:
    """Return the share of the required readings that is missing; a measured reserve stop replaces a missing one."""
    asked = sum(len(q) - len(run.profile.plan.reserves(len(q))) for q in run.read_plan().values())
    counts = run.split_counts()
    measured = sum(sum(counts.get(name, {}).values()) for name in run.read_plan())
    return max(asked - measured, 0) / asked if asked and missing else 0.0


def reference_drifts(run: RunFile) -> tuple[ReferenceDrift, ...]:
    """Compute the distance of every reference measurement from the first one of its name in the run."""
    first: dict[str, NDArray[np.float64]] = {}
    return tuple(
        ReferenceDrift(
            name=row.name,
            stops_done=row.stops_done,
            drift_mm=float(np.linalg.norm(row.p_M - first.setdefault(row.name, row.p_M))) * 1e3,
        )
        for row in run.references()
    )


def late_readings(run: RunFile) -> set[tuple[int, str]]:
    """Return the stops and arms that were only measured at a later visit; the number of visits is not stored."""
    with run.look() as connection:
        return select_late(connection)
