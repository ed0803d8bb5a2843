"""How often runs of an unchanged cell are said to differ, and how widely their parameters scatter.

    python -m tests.benchmarks.unchanged_twins DIR...

Each DIR holds runs of one cell that differ in plan and noise alone. Every run is compared with every other one of its
folder. Printed are pairs, alarms with their reasons, and for each arm the rms of the differences in units of the
standard errors, without the factor and the temperatures that ``cellapp.estimation.monitoring.fleet.parameters`` adds.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellapp.commands.fleet.reading import read_record
from cellapp.commands.runs.history import run_folders
from cellapp.estimation.monitoring.fleet.histories import fleet_result
from cellapp.estimation.monitoring.fleet.parameters import determined_values, is_angle, is_installation
from cellapp.estimation.monitoring.fleet.record import GeometryRecord, RunRecord


def scatter(first: GeometryRecord, other: GeometryRecord) -> list[float]:
    """Differences of the arm's own parameters in combined standard errors."""
    a, b = determined_values(first, first), determined_values(other, first)
    return [
        (math.remainder(b[name].value - a[name].value, math.tau) if is_angle(name) else b[name].value - a[name].value)
        / math.hypot(a[name].standard_error, b[name].standard_error)
        for name in b
        if not is_installation(name)
    ]


def examine(records: Sequence[RunRecord]) -> None:
    """Print what all ordered pairs of runs say."""
    alarms, z = 0, dict[str, list[float]]()
    pairs = list(itertools.permutations(records, 2))
    for first, other in pairs:
        result = fleet_result([first, other])
        alarms += bool(result.complaints()) or any(pair.moved for pair in result.pairs)
        for name, arm in result.arms.items():
            for reason in arm.reasons:
                print(f"  {Path(first.run).name} {Path(other.run).name} {name}: {reason}")  # noqa: T201
        for name in first.arms.keys() & other.arms.keys():
            a, b = first.arms[name].geometry, other.arms[name].geometry
            if a is not None and b is not None:
                z.setdefault(name, []).extend(scatter(a, b))
    words = ", ".join(f"{name} {np.sqrt(np.mean(np.square(z[name]))):.2f}" for name in sorted(z))
    print(f"  {alarms} alarms in {len(pairs)} pairs; rms z: {words}")  # noqa: T201


def main(folders: Sequence[str]) -> None:
    """Examine the runs of each folder."""
    for folder in folders:
        print(folder)  # noqa: T201
        examine([read_record(run) for run in run_folders(Path(folder))])


if __name__ == "__main__":
    main(sys.argv[1:])
