"""The result of ``touch`` as a table and sentences."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.touch.result import TouchResult
from cellapp.commands.view.table import Column, Table, number_column
from cellapp.ground.counting import counted


def view(result: TouchResult, request: Request | None = None) -> View:
    """Show the touches of each socket, and notes."""
    words = f"{counted(len(result.recorded), 'touch', 'touches')} recorded" if result.recorded else ""
    sentences = tuple(filter(None, (words, *result.notes)))
    return View((*([touches_table(result)] if result.points else []), *sentences), refused=result.refused, held=words)


def touches_table(result: TouchResult) -> Table:
    """Build a row for each socket: number of touches, their agreement, and the range of the joints."""
    columns = (
        Column("socket"),
        number_column("touches", "d"),
        number_column("worst", ".1f", "mm"),
        *(number_column(f"q{joint + 1}", ".0f") for joint in range(len(result.points[0].turned_deg))),
    )
    rows = tuple((one.point, one.touches, one.worst_mm, *one.turned_deg) for one in result.points)
    return Table(f"Arm {result.arm}: touches by socket; joints turned [deg]", columns, rows)
