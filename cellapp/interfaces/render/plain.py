"""A view as plain text, formatted as in a terminal of a given width without colours."""

from __future__ import annotations

import io

from rich.console import Console

from cellapp.commands.view.parts import Parts, printed
from cellapp.interfaces.render.terminal import rich_table


def plain_text(view: Parts, width: int = 100) -> str:
    """Return tables and lines in their order as text; tables are at most ``width`` characters wide."""
    text = io.StringIO()
    console = Console(file=text, width=width, color_system=None, force_terminal=False, legacy_windows=False)
    for part in printed(view):
        if isinstance(part, str):
            text.write(f"{part}\n")
        else:
            console.print(rich_table(part, cut=False), crop=False)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n")
