"""Tables for a terminal of any width: no word and no number is ever broken, and nothing is omitted.

A table is drawn unchanged if it fits. Otherwise its text columns are wrapped between words. If that is not enough, it
is printed in parts, each with the columns that name the rows. If not even one column fits beside those, each row
becomes a group of lines.

A view as plain text, formatted as in a terminal of a given width without colours.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, OverflowMethod, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.style import Style
from rich.table import Table as RichTable
from rich.text import Text

from cellapp.commands.view.parts import Parts, Section, printed
from cellapp.commands.view.table import Cell, Column, Table

_NARROWEST = 16
"""Narrowest column of sentences: table parts are easier to read than a column of single words."""
_TITLE = Style(italic=True)
_MOST_LINES = 40
"""Lines with which a command ends on a terminal, whose results are stored: about a screen."""


@dataclass(frozen=True)
class TerminalTable:
    """A table that Rich draws to fit the available width. Cells are plain text: Rich would take a unit for markup.

    ``cut``: the output device cuts lines at its width, as a screen does. Then a word longer than a line continues on
    the next one, and no line is left blank. Otherwise it stays whole, so that it can be copied.
    """

    table: Table
    cut: bool = True

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        measured = _measured(self.table)
        parts = _parts(self.table, measured, width)
        yield from _wrapped(self.table.title, width, "fold", _TITLE)
        if parts is None:
            yield from _as_lines(self.table, width, "fold" if self.cut else "ignore")
            return
        for number, part in enumerate(parts):
            if part.spacing is _TIGHT and (number or not self.cut):
                yield Text("")
            drawn = _drawn(self.table, part)
            drawn.show_edge &= not self.cut
            yield Padding(drawn, (0, 0, 0, 1)) if self.cut and part.spacing is _LOOSE else drawn
        if parts and parts[-1].spacing is _TIGHT and not self.cut:
            yield Text("")

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        whole = _LOOSE.width([column.natural for column in _measured(self.table)])
        title = cell_len(self.table.title)
        return Measurement(min(whole, options.max_width), min(max(whole, title), options.max_width))


@dataclass(frozen=True)
class _Spacing:
    """Blanks around the cells of a drawn table: ``edge`` in total at its two ends, ``gap`` between two columns."""

    edge: int
    gap: int

    def width(self, columns: Sequence[int]) -> int:
        """Return the width of a table with columns of these widths."""
        return sum(columns) + self.edge + self.gap * (len(columns) - 1)


_LOOSE = _Spacing(edge=4, gap=3)
_TIGHT = _Spacing(edge=1, gap=2)


@dataclass(frozen=True)
class _Sized:
    """Widths of a column: that of its longest cell or heading, and the smallest that breaks no word."""

    natural: int
    least: int


@dataclass(frozen=True)
class _Piece:
    """Columns of a table that are drawn side by side, by their indices, with their widths."""

    places: tuple[int, ...]
    widths: tuple[int, ...]
    spacing: _Spacing


def _measured(table: Table) -> list[_Sized]:
    texts = table.text_rows()
    return [
        _measured_column(column, [row[place] for row in table.rows], [row[place] for row in texts])
        for place, column in enumerate(table.columns)
    ]


def _measured_column(column: Column, cells: Sequence[Cell], texts: Sequence[str]) -> _Sized:
    every = [column.heading, *texts]
    natural = max(map(cell_len, every))
    words = max((cell_len(word) for text in every for word in text.split()), default=0)
    # "0.1 to 0.2" and "5.0 mm" are read as one
    numbers = max(
        (cell_len(text) for cell, text in zip(cells, texts, strict=True) if not isinstance(cell, str)), default=0
    )
    sentences = 0 if column.is_number else min(natural, _NARROWEST)
    heading = math.ceil(cell_len(column.heading) / 2)  # "U (k = 2)" in two lines, not in four
    return _Sized(natural, max(words, numbers, sentences, heading))


def _parts(table: Table, measured: Sequence[_Sized], width: int) -> list[_Piece] | None:
    """Return the table whole or in parts that each fit; None if not even one column fits beside the row names."""
    every = tuple(range(len(measured)))
    for spacing in (_LOOSE, _TIGHT):
        whole = _fitted(every, measured, width, spacing)
        if whole is not None:
            return [whole]
    names = _names(table, measured, width)
    part = _fitted(names, measured, width, _TIGHT)
    parts: list[_Piece] = []
    for place in every[len(names) :]:
        if part is None:
            return None
        wider = _fitted((*part.places, place), measured, width, _TIGHT)
        if wider is None:
            parts.append(part)
            wider = _fitted((*names, place), measured, width, _TIGHT)
        part = wider
    return None if part is None else [*parts, part]


def _names(table: Table, measured: Sequence[_Sized], width: int) -> tuple[int, ...]:
    """Return the first columns that tell all rows apart, if they take at most half of the width; else the first."""
    rows = table.text_rows()
    for count in range(1, len(table.columns)):
        if _TIGHT.width([column.least for column in measured[:count]]) > width // 2:
            break
        if len({row[:count] for row in rows}) == len(rows):
            return tuple(range(count))
    return (0,)


def _fitted(places: tuple[int, ...], measured: Sequence[_Sized], width: int, spacing: _Spacing) -> _Piece | None:
    """Return the columns with widths that fit, or None. The widest shrink first, the row names last."""
    widths = [measured[place].natural for place in places]
    surplus = spacing.width(widths) - width
    for own in (range(1, len(places)), range(1)):
        while surplus > 0:
            spare = [at for at in own if widths[at] > measured[places[at]].least]
            if not spare:
                break
            widths[max(spare, key=lambda at: widths[at])] -= 1
            surplus -= 1
    return None if surplus > 0 else _Piece(places, tuple(widths), spacing)


def _drawn(table: Table, part: _Piece) -> RichTable:
    loose = part.spacing is _LOOSE
    drawn = RichTable(box=box.SIMPLE_HEAD, show_edge=loose, padding=(0, 1) if loose else (0, 1, 0, 0))
    for place, width in zip(part.places, part.widths, strict=True):
        column = table.columns[place]
        side: Literal["left", "right"] = "right" if column.is_number else "left"
        drawn.add_column(Text(column.heading), justify=side, width=width, overflow="fold")
    for row in table.text_rows():
        drawn.add_row(*(Text(row[place]) for place in part.places))
    return drawn


def _as_lines(table: Table, width: int, overflow: OverflowMethod) -> Iterator[Text]:
    """Yield each row as its name, followed by one line per cell; a word longer than a line stays whole."""
    first, *others = table.headings
    for name, *cells in table.text_rows():
        yield from _wrapped(f"  {first}: {name}", width, overflow)
        for heading, cell in zip(others, cells, strict=True):
            if cell:
                yield from _wrapped(f"    {heading}: {cell}", width, overflow)
        yield Text("")


def _wrapped(text: str, width: int, overflow: OverflowMethod, style: Style | str = "") -> Iterator[Text]:
    """Yield the lines of a text, broken only between words; lines after the first are indented by two more."""
    indent = " " * (len(text) - len(text.lstrip()))
    for line in textwrap.wrap(
        text.strip(),
        width,
        initial_indent=indent,
        subsequent_indent=f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    ):
        yield Text(line, style, overflow=overflow, no_wrap=overflow == "ignore")


def shortened(view: Parts, said: Callable[[str], str], width: int, rest: str) -> list[Table | str]:
    """Return what is printed of a view; of a long one what fits, sentences first and sections last, and ``rest``.

    ``rest`` says which command shows everything; ``said`` is as in ``printed``.
    """

    def height(part: Table | str) -> int:
        lines = plain_text([part], width).split("\n")
        return isinstance(part, Table) + sum(max(1, -(-cell_len(line) // width)) for line in lines)

    whole = list(printed(view, said))
    if sum(map(height, whole)) <= _MOST_LINES:
        return whole
    ranked: list[tuple[int, Table | str]] = []
    for part in view:
        inside = isinstance(part, Section)
        if isinstance(part, Section):
            part = replace(part, parts=[one for one in part.parts if not isinstance(one, Section)])
        for one in printed([part], said):
            if isinstance(one, str) and one.startswith(" ") and ranked and ranked[-1][0] == 2:
                one = f"{ranked.pop()[1]}\n{one}"  # all sentences of a section, or none
            ranked.append((1 + 2 * inside if isinstance(one, Table) else 2 * one.startswith(" "), one))
    rest = said(rest)
    room, shown = _MOST_LINES - height(rest), set[int]()
    for place in sorted(range(len(ranked)), key=lambda place: ranked[place][0]):
        if (needed := height(ranked[place][1])) <= room:
            room -= needed
            shown.add(place)
    return [*(part for place, (_, part) in enumerate(ranked) if place in shown), rest]


def plain_text(view: Parts, width: int = 100) -> str:
    """Return tables and lines in their order as text; tables are at most ``width`` characters wide."""
    text = io.StringIO()
    console = Console(file=text, width=width, color_system=None, force_terminal=False, legacy_windows=False)
    for part in printed(view):
        if isinstance(part, str):
            text.write(f"{part}\n")
        else:
            console.print(TerminalTable(part, cut=False), crop=False)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n")
