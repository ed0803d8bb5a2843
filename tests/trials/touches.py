"""Error rates of a check by touches of one socket: of an unchanged arm, and of one with a changed joint zero.

    python -m tests.trials.touches --unchanged 150 --changed 30

Each check has a socket of its own place and ten postures of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Annotated

import typer

from cellapp.robot.kinematics.chain import parameter_names
from tests.estimation.monitoring.check.conftest import SimulatedCell, one_ur5, with_parameter
from tests.estimation.monitoring.check.test_touches import checked

app = typer.Typer(add_completion=False)
SHIFT_RAD = 1.5e-4


def unchanged(cell: SimulatedCell, checks: int, first: int) -> Counter[str]:
    """Verdict -> number of checks of an unchanged arm."""
    return Counter(checked(cell, cell.true["only"], first + seed).conclusion.verdict for seed in range(checks))


def changed(cell: SimulatedCell, joint: int, checks: int, first: int, shift_rad: float = SHIFT_RAD) -> Counter[str]:
    """How many checks named the joint whose zero had changed, named another cause, or ended by their verdict."""
    place = parameter_names(6).index(f"theta{joint}")
    true = with_parameter(cell.true["only"], place, shift_rad)
    found: Counter[str] = Counter()
    for seed in range(checks):
        conclusion = checked(cell, true, first + seed).conclusion
        named = [one.what for one in conclusion.changes]
        if f"zero of joint {joint}" in named:
            found["named"] += 1
        else:
            found["another cause" if named else conclusion.verdict] += 1
    return found


def rates(cell: SimulatedCell, checks: int, changes: int, first: int) -> Iterator[str]:
    """A line for the unchanged arm, and one for each joint."""
    yield f"unchanged: {_words(unchanged(cell, checks, first))}"
    for joint in (2, 3, 4):
        yield f"zero of joint {joint} by {1e3 * SHIFT_RAD:g} mrad: {_words(changed(cell, joint, changes, first))}"


def _words(found: Counter[str]) -> str:
    return ", ".join(f"{what} {number}" for what, number in found.most_common())


@app.command()
def main(
    checks: Annotated[int, typer.Option("--unchanged", min=1)] = 150,
    changes: Annotated[int, typer.Option("--changed", min=1)] = 30,
    first: Annotated[int, typer.Option(help="first seed")] = 1000,
) -> None:
    """Simulate, check and count."""
    for line in rates(one_ur5(), checks, changes, first):
        typer.echo(line)


if __name__ == "__main__":
    app()
