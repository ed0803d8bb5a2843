"""Common base of the library's results: they print themselves as text, as HTML and as charts.

A view as an HTML fragment for a notebook: tables, preformatted lines, and charts on request.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from itertools import groupby
from pathlib import Path

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Parts, printed
from cellapp.commands.view.table import Table
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.page.figures import chart_svg
from cellapp.interfaces.render.chart import legend_of
from cellapp.interfaces.render.terminal import plain_text

_LONGEST = 190
"""Longest ``repr`` [characters]: one line of a wide screen or two of a narrow one."""


class Printed(ABC):
    """A result that prints itself, with ``print(result)`` or by its name at the end of a notebook cell."""

    @abstractmethod
    def view(self) -> Parts:
        """Return the full content as tables and lines, in reading order."""

    @abstractmethod
    def summary(self) -> str:
        """Return one line: what the result is, and its most important figures."""

    def report(self, width: int = 100) -> str:
        """Return the view as plain text; tables are at most ``width`` characters wide."""
        return plain_text(self.view(), width)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        text = f"{type(self).__name__}({self.summary()})"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]}...)"

    def _repr_html_(self) -> str:
        return html_view(self.view())


class Charted(Printed):
    """A result that can also draw itself."""

    @abstractmethod
    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return the available charts by name, most informative first; each value creates its charts when called."""

    def plot(self, what: str = "") -> Drawing:
        """Draw charts of one kind as HTML, which a notebook shows; without a name the first kind of ``charts()``.

        Raises
        ------
        InputError
            If there are no charts of that name.
        """
        known = self.charts()
        if what and what not in known:
            raise InputError(f"plot: nothing is called '{what}'; known are {', '.join(known)}")
        drawn = known[what or next(iter(known))]()
        if not drawn:
            raise InputError(f"plot: there is nothing to draw of '{what}' in {self.summary()}")
        return draw_charts(drawn)


def html_view(view: Parts) -> str:
    """Return tables and lines in their order as one ``div``, with all content escaped."""
    parts = []
    for are_lines, group in groupby(printed(view), lambda part: isinstance(part, str)):
        members = list(group)
        if are_lines:
            lines = "\n".join(str(line) for line in members).strip("\n")
            parts.append(f"<pre>{escape(lines)}</pre>")
        else:
            parts += [_table(table) for table in members if isinstance(table, Table)]
    return f"<div>{''.join(parts)}</div>"


def _table(table: Table) -> str:
    sides = ["right" if column.is_number else "left" for column in table.columns]
    head = _row("th", table.headings, sides)
    rows = "".join(_row("td", row, sides) for row in table.text_rows())
    return f"<table><caption>{escape(table.title)}</caption><thead>{head}</thead><tbody>{rows}</tbody></table>"


def _row(tag: str, cells: tuple[str, ...], sides: list[str]) -> str:
    inside = (
        f'<{tag} style="text-align: {side}">{escape(cell)}</{tag}>' for cell, side in zip(cells, sides, strict=True)
    )
    return f"<tr>{''.join(inside)}</tr>"


@dataclass(frozen=True)
class Drawing:
    """Charts as an HTML fragment, which a notebook shows and any browser opens."""

    html: str

    def _repr_html_(self) -> str:
        return self.html

    def save(self, path: str | Path) -> None:
        """Write the charts into a file, as ``steps.html``; it is replaced if it is there."""
        RENEWED.write_text(Path(path), self.html)


def draw_charts(charts: Sequence[Chart]) -> Drawing:
    """Draw every chart as the page does."""
    style = resources.files("cellapp.interfaces.page").joinpath("page.css").read_text("utf-8")
    colours = re.search(r":root \{(.*?)\}", style, re.DOTALL)
    assert colours is not None
    return Drawing(f"<div style='{' '.join(colours[1].split())}'>{''.join(map(_figure, charts))}</div>")


def _figure(chart: Chart) -> str:
    names = (
        f'<span style="color: {"inherit" if look is None else look.css_colour}">{escape(text)}</span>'
        for look, text in (() if chart.is_empty else legend_of(chart))
    )
    svg = "" if chart.is_empty else chart_svg(chart)
    words = f"<figcaption>{escape(chart.title)}</figcaption>{svg}<p>{' · '.join(names)}</p>"
    return f'<figure style="max-width: 44rem">{words}<p>{escape(chart.message)}</p></figure>'
