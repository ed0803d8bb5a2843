"""The stops of a plan as a table of the screen Plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text
from textual.coordinate import Coordinate

from cellapp.interfaces.tui.widgets.tables import TextTable

if TYPE_CHECKING:
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.commands.plan.result import PlannedStop


class StopsTable(TextTable):
    """The stops in their order, with the person's marks; initially the frozen stops are marked."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id, cursor_type="row")
        self.tooltip = "Space marks the selected stop"
        self._stops: Sequence[PlannedStop] = ()
        self._ways: PlannedStops | None = None
        self.marked: set[int] = set()

    def on_mount(self) -> None:
        """Create the columns."""
        self.add_columns("stop", "marked", "frozen", "state", "part", "how")

    def show(self, stops: Sequence[PlannedStop], ways: PlannedStops | None) -> None:
        """Draw the stops of a plan, unless they are already shown; marks that were not stored are lost."""
        if stops is self._stops or (stops == self._stops and _same_ways(ways, self._ways)):
            return
        self._stops, self._ways = stops, ways
        self.marked = set() if ways is None else set(np.flatnonzero(ways.frozen).tolist())
        rows = [_stop_row(stop, ways) for stop in stops]
        texts = [text for _, text in rows]
        if texts != self.texts:  # the cursor stays if nothing changed
            self.texts = texts
            self.clear()
            for cells, _ in rows:
                self.add_row(*map(Text, cells))

    def mark(self) -> None:
        """Mark or unmark the selected stop, then go to the next one."""
        if self.cursor_row >= len(self._stops):
            return
        stop = self._stops[self.cursor_row].configuration
        self.marked ^= {stop}
        self.update_cell_at(Coordinate(self.cursor_row, 1), Text("●" if stop in self.marked else ""))
        self.action_cursor_down()


def _same_ways(one: PlannedStops | None, other: PlannedStops | None) -> bool:
    """Return whether the data of two plans with the same joint positions are equal, and so the ways to their stops."""
    if one is None or other is None:
        return one is other
    return bool((one.frozen == other.frozen).all() and (one.block == other.block).all())


def _stop_row(stop: PlannedStop, ways: PlannedStops | None) -> tuple[tuple[str, ...], str]:
    """Return cells and sentence of one stop, counted from 1."""
    from cellapp.commands.plan.check_view import stop_words

    number, state = stop.configuration + 1, "measured" if stop.measured else "planned"
    joints = "; ".join(
        f"arm {name} " + ", ".join(f"{math.degrees(angle):.0f}" for angle in q) + " deg" for name, q in stop.q.items()
    )
    if ways is None:
        return (str(number), "", "", state, "", ""), f"Stop {number}: {joints}."
    frozen, how = bool(ways.frozen[stop.configuration]), stop_words(ways, stop.configuration)
    cells = (
        str(number),
        "●" if frozen else "",
        "yes" if frozen else "",
        state,
        str(ways.block[stop.configuration] + 1),
        how,
    )
    words = f"{how}; frozen: a new design leaves it" if frozen else how
    return cells, f"Stop {number}: {joints}. {words[:1].upper()}{words[1:]}."
