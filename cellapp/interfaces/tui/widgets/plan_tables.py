"""Tables of the screen Plan: constraints, joint ranges, effects, expected errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from rich.text import Text
from textual.coordinate import Coordinate

from cellapp.interfaces.tui.widgets.tables import TextTable

if TYPE_CHECKING:
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.cell.planning.records import ArmForecast
    from cellapp.commands.plan.result import PlannedStop

_BAR_CELLS = 24
"""Width of the bar of a joint's range: 15 degrees per cell over one turn."""


class _RowTable(TextTable):
    """A table with a sentence for the row under the cursor."""

    COLUMNS: ClassVar[tuple[str, ...]]
    TIP: ClassVar[str]

    def on_mount(self) -> None:
        """Create the columns."""
        self.cursor_type = "row"
        self.tooltip = self.TIP
        self._texts: list[str] = []
        self.add_columns(*self.COLUMNS)

    def draw(self, rows: Sequence[tuple[tuple[str, ...], str]]) -> None:
        """Draw rows of cells, each with its sentence; the cursor stays if nothing changed."""
        texts = [text for _, text in rows]
        if texts == self._texts:
            return
        self._texts = texts
        self.clear()
        for cells, _ in rows:
            self.add_row(*map(Text, cells))

    @property
    def selected_text(self) -> str:
        """The sentence of the row under the cursor."""
        return self._texts[self.cursor_row] if self.cursor_row < len(self._texts) else ""


class PairsTable(_RowTable):
    """Names with texts."""

    COLUMNS = ("what", "how")
    TIP = "The selected row stands below in full"

    def show(self, rows: Sequence[tuple[str, str]]) -> None:
        """Draw names with texts."""
        self.draw([((name, words), f"{name}: {words}") for name, words in rows])


class StopsTable(_RowTable):
    """The stops in their order, with the person's marks; initially the frozen stops are marked."""

    COLUMNS = ("stop", "marked", "frozen", "state", "part", "how")
    TIP = "Space marks the selected stop"

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id)
        self._stops: Sequence[PlannedStop] = ()
        self._ways: PlannedStops | None = None
        self.marked: set[int] = set()

    def show(self, stops: Sequence[PlannedStop], ways: PlannedStops | None) -> None:
        """Draw the stops of a plan, unless they are already shown; marks that were not stored are lost."""
        if stops is self._stops or (stops == self._stops and _same_ways(ways, self._ways)):
            return
        self._stops, self._ways = stops, ways
        self.marked = set() if ways is None else set(np.flatnonzero(ways.frozen).tolist())
        self.draw([_stop_row(stop, ways) for stop in stops])

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


class CoverageTable(_RowTable):
    """The used part of each joint's range as a bar."""

    COLUMNS = ("arm", "joint", "allowed range, used part", "share", "largest gap")
    TIP = "Full: the part of the allowed range that stops use"

    def show(self, arms: Mapping[str, ArmForecast]) -> None:
        """Draw the joints of all arms."""
        from cellapp.commands.plan.check_view import coverage_bar

        rows = []
        for name, arm in arms.items():
            for one in arm.coverage:
                allowed, used = (tuple(map(math.degrees, pair)) for pair in (one.allowed, one.used))
                gap = math.degrees(one.largest_gap)
                cells = (name, str(one.joint), coverage_bar(one, _BAR_CELLS), f"{one.share:.0%}", f"{gap:.0f}°")
                text = (
                    f"Arm {name}, joint {one.joint}: allowed {allowed[0]:.0f} to {allowed[1]:.0f} deg, used"
                    f" {used[0]:.0f} to {used[1]:.0f} deg; the largest part without a stop is {gap:.0f} deg."
                )
                rows.append((cells, text))
        self.draw(rows)


class EffectsTable(_RowTable):
    """For each effect, whether the plan can show it."""

    COLUMNS = ("arm", "visible", "from mm", "scatter", "effect")
    TIP = "Smallest rms displacement of the SMR that would be seen: tracker alone, and with 0.1 mm scatter"

    def show(self, arms: Mapping[str, ArmForecast]) -> None:
        """Draw the effects of all arms, invisible ones first."""
        from cellapp.commands.plan.check_view import effect_sentence, effect_title

        entries = [(name, one) for name, arm in arms.items() for one in arm.effects]
        entries.sort(key=lambda entry: entry[1].visible)
        rows = []
        for name, one in entries:
            sizes = (one.smallest_seen_rms_mm, one.with_scatter_rms_mm) if one.visible else (None, None)
            shown = ["" if size is None else f"{size:.3f}" for size in sizes]
            cells = (name, "yes" if one.visible else "no", *shown, effect_title(one))
            rows.append((cells, f"Arm {name}: {effect_sentence(one)}"))
        self.draw(rows)


class AccuracyTable(_RowTable):
    """Expected standard errors."""

    COLUMNS = ("arm", "standard error of", "tracker alone", "0.1 mm scatter", "unit")
    TIP = "Standard errors that the planned stops will give"

    def show(self, arms: Mapping[str, ArmForecast]) -> None:
        """Draw predicted positions and parameters of all arms."""
        from cellapp.commands.plan.check_view import accuracy_table

        rows = []
        for name, arm in arms.items():
            for cells in accuracy_table(name, arm).text_rows():
                what, alone, scattered, unit = cells
                text = f"Arm {name}, {what}: {alone or '-'} {unit} with the tracker's noise alone"
                rows.append(((name, *cells), f"{text}, {scattered or '-'} {unit} with 0.1 mm scatter."))
        self.draw(rows)
