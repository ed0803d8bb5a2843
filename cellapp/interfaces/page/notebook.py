"""A view as an HTML fragment for a notebook: tables, preformatted lines, and charts on request."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from itertools import groupby
from pathlib import Path

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Parts, printed
from cellapp.commands.view.table import Table
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.page.drawn import chart_figure


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
    drawn = chart_figure("", chart)
    names = (
        f'<span style="color: {"inherit" if one.look is None else one.look.css_colour}">{escape(one.text)}</span>'
        for one in drawn.legend
    )
    words = f"<figcaption>{escape(drawn.caption)}</figcaption>{drawn.svg}<p>{' · '.join(names)}</p>"
    return f'<figure style="max-width: 44rem">{words}<p>{escape(drawn.note)}</p></figure>'
