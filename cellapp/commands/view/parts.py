"""Parts of a view: sentences, tables, charts, and sections that hold such parts under a title.

A view lists them in the order of a terminal. The page and the terminal application have room beside and below: they
show the sentences of a section first, then its charts, tables and inner sections.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Union

from cellapp.commands.view.table import Table

if TYPE_CHECKING:
    from cellapp.commands.view.charts import Chart


Part = Union[str, "Facts", "Chart", Table, "Section"]
"""Charts load numpy, which a terminal without charts does not need."""
Parts = Sequence[Part]
_WIDTH = 80
"""Columns of a terminal."""


@dataclass(frozen=True)
class Facts:
    """Pairs of a title and a text; an empty title continues the pair before."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Section:
    """Parts that belong together, under a title if it has one.

    Attributes
    ----------
    parts : sequence of Part
        Its contents.
    message : str
        The section in one sentence, also shown while it is folded.
    about : str
        What it shows and how to read it, for newcomers.
    folded : bool
        Whether it holds details, which an interface shows on request.
    on_record : bool
        Whether paper shows it although it is folded.
    key : str
        Its anchor on a page; none if empty.
    outdated : str
        Why its results no longer hold; empty if they do.
    """

    parts: Parts
    message: str = ""
    about: str = ""
    title: str = ""
    folded: bool = False
    on_record: bool = False
    key: str = ""
    outdated: str = ""


def printed(parts: Parts, said: Callable[[str], str] = str, depth: int = 0) -> Iterator[Table | str]:
    """Yield lines and tables in their order for plain text: without charts, details and explanations.

    ``said`` changes each text, as one that holds commands.

    The contents of a section are indented below its title and wrapped for a terminal of 80 columns.
    """
    for part in parts:
        if isinstance(part, Section):
            inside = [] if part.folded else [*filter(None, [part.message]), *part.parts]
            body = list(printed(inside, said, depth + 1))
            yield from (*_indented(part.title, depth), *body, *([] if depth else [""])) if body else ()
        elif isinstance(part, Facts):
            for title, text in part.rows:
                yield from _indented(said(f"{title}: {text}" if title else f"  {text}"), depth)
        elif isinstance(part, str):
            yield from _indented(said(part), depth) if depth else [said(part)]
        elif isinstance(part, Table):
            yield part.with_texts(said)


def _indented(text: str, depth: int) -> list[str]:
    """Wrap a text; a quoted command stays on one line, as people copy it."""
    first = "  " * depth + text[: len(text) - len(text.lstrip())]
    whole = re.sub(r"'cellapp [^']+'", lambda found: found[0].translate({ord(" "): "\0", ord("-"): "\1"}), text.strip())
    lines = textwrap.wrap(whole, _WIDTH, initial_indent=first, subsequent_indent=f"{first}  ", break_long_words=False)
    return [line.translate({0: " ", 1: "-"}) for line in lines]


def sentence(text: str) -> str:
    """Make a sentence of words: add a capital letter and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")


def section_of(parts: Parts, *, message: str = "", about: str = "") -> Section:
    """Build a section without a title; its default message is the first sentence of its parts."""
    if not message:
        first = next(place for place, part in enumerate(parts) if isinstance(part, str))
        message, parts = str(parts[first]), [*parts[:first], *parts[first + 1 :]]
    return Section(parts, message=sentence(message), about=about)
