"""A view as an HTML fragment for a notebook: tables, and preformatted lines."""

from __future__ import annotations

from html import escape
from itertools import groupby

from cellapp.commands.view.parts import Parts, printed
from cellapp.commands.view.table import Table


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
