"""How often a check with a 6-D probe is right: an unchanged arm, and changed zeros of joints, beside positions alone.

    python -m tests.trials.probed_check --cells 5 --unchanged 100 --changed 10

A simulated UR10 is calibrated from 150 stops, tracker 15 µm, probe 0.04 mrad; 20 stops are chosen and measured.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check import choose_stops
from cellapp.estimation.monitoring.check.conclusion import judgement
from cellapp.estimation.monitoring.check.linear import stop_rows
from cellapp.estimation.monitoring.check.naming import Design
from cellapp.estimation.monitoring.check.sequential import decided_prefix, design_of
from cellapp.robot.kinematics.chain import Geometry, parameter_names
from tests.arms import OFF_AXIS, UR10, at_station
from tests.estimation.monitoring.check.conftest import SimulatedCell, cell_of, with_parameter

STOPS, CHANGE_RAD = 20, 1e-4
PROBE = np.array([0.1, -0.3, 0.4])
app = typer.Typer(add_completion=False)


def outcome(
    cell: SimulatedCell, design: Design, stops: NDArray[np.intp], seed: int, true: Geometry
) -> tuple[str, list[str]]:
    """Verdict of one check, and the first change with its rivals."""
    readings = cell.measured(stops, seed, only=true)
    measured, state = decided_prefix(design, stop_rows(cell.belief, readings, design.directions))
    verdict, found, _, _ = judgement(design, measured, state)
    if not found.causes:
        return verdict, []
    return verdict, [design.name_of(found.causes[0].alternative), *found.causes[0].rivals]


def of_cell(kind: str, seed: int, unchanged: int, changed: int) -> dict[str, Counter[str]]:
    """Outcomes of the checks of one calibrated arm: verdicts without a change, and what each change was called."""
    nominal = at_station(UR10, OFF_AXIS)
    cell = cell_of({"only": replace(nominal, probe=PROBE) if kind == "6-D probe" else nominal}, seed)
    design = design_of(cell.belief)
    stops, true = choose_stops(cell.belief, cell.candidates, STOPS).order, cell.true["only"]
    found = {"unchanged": Counter(outcome(cell, design, stops, 1000 * seed + k, true)[0] for k in range(unchanged))}
    for joint in range(2, 7):
        what = f"zero of joint {joint}"
        other = with_parameter(true, parameter_names(6).index(f"theta{joint}"), CHANGE_RAD)
        counts = found[what] = Counter[str]()
        for k in range(changed):
            verdict, names = outcome(cell, design, stops, 5000 * seed + 100 * joint + k, other)
            counts["named" if names[:1] == [what] else "beside a rival" if what in names else verdict] += 1
    return found


@app.command()
def main(
    cells: Annotated[int, typer.Option(min=1)] = 5,
    unchanged: Annotated[int, typer.Option(min=1)] = 100,
    changed: Annotated[int, typer.Option(min=1)] = 10,
    first: Annotated[int, typer.Option(min=0)] = 1,
) -> None:
    """Print a line for each kind and change."""
    for kind in ("6-D probe", "positions"):
        total: dict[str, Counter[str]] = {}
        for seed in range(first, first + cells):
            for what, counts in of_cell(kind, seed, unchanged, changed).items():
                total[what] = total.get(what, Counter()) + counts
        for what, counts in total.items():
            typer.echo(f"{kind} | {what} | {', '.join(f'{word} {n}' for word, n in counts.most_common())}")


if __name__ == "__main__":
    app()
