"""What a view is made of: sentences, tables, charts, and sections that hold such parts under a title.

A view lists them in the order in which a terminal prints them. The page and the terminal application have room beside
and below: within a section they show sentences, then charts, then tables, then the sections inside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Union

from cellapp.commands.view.table import Table

if TYPE_CHECKING:
    from cellapp.commands.view.charts import Chart

Part = Union[Table, "Chart", str, "Section"]
"""A line is a text without a line's end; charts load numpy, which a terminal that draws none needs not."""
Parts = Sequence[Part]


@dataclass(frozen=True)
class Section:
    """Parts that belong together.

    Attributes
    ----------
    parts : sequence of Part
        What it shows.
    message : str
        The section in one sentence, shown while it is folded, too.
    about : str
        What it shows and how it is to be read, for those who do not know.
    folded : bool
        Whether it holds details, which an interface shows when they are asked for.
    key : str
        Its anchor on a page; empty: none.
    """

    title: str
    parts: Parts
    message: str = ""
    about: str = ""
    folded: bool = False
    key: str = ""


def printed(parts: Parts) -> Iterator[Table | str]:
    """Lines and tables in their order, as plain text shows them: titles and messages of sections, no chart."""
    for part in parts:
        if isinstance(part, Section):
            yield from filter(None, (part.title, part.message, part.about))
            yield from printed(part.parts)
        elif isinstance(part, str | Table):
            yield part
