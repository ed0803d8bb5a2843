"""A figure of the page."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Drawing:
    """A figure as SVG with its caption; ``legend`` pairs the name of a colour of the style sheet with a text.

    ``note`` says what one sees in it.
    """

    svg: str
    caption: str
    legend: tuple[tuple[str, str], ...]
    width: str = ""
    note: str = ""
