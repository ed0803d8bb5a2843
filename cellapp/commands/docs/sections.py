"""The handbook by sections, for reading in a terminal: headings, links, captions of pictures, search."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from cellapp.commands.docs.handbook import CHAPTERS, anchor_of, topic_text

_FENCE = re.compile(r"^```")
_HEADING = re.compile(r"^(#+) (.+)$")
_PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)]+)\)")
_CAPTION = re.compile(r"(!\[([^\]]+)\]\([^)]+\)\n)\n\*\2\.?\*\n")
"""A picture followed by a caption that repeats its words."""
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Section:
    """A heading of a chapter with the Markdown up to the next heading; ``level`` 1 is the chapter's own."""

    chapter: str
    anchor: str
    heading: str
    level: int
    text: str

    @property
    def address(self) -> str:
        """Address of a link to it."""
        return f"{self.chapter}.md#{self.anchor}"

    @property
    def terminal_text(self) -> str:
        """Its Markdown with each picture replaced by its words."""
        return _PICTURE.sub(r"*Picture: \1*", _CAPTION.sub(r"\1", self.text))

    @property
    def links(self) -> tuple[tuple[str, str], ...]:
        """Words and address of each link, without repetition."""
        found = dict((place, words) for words, place in reversed(_LINK.findall(_without_fences(self.text))))
        return tuple((words, place) for place, words in reversed(found.items()))


@dataclass(frozen=True)
class Found:
    """A section that contains all searched words, and its first line with one of them."""

    section: Section
    line: str


@cache
def sections(chapter: str) -> tuple[Section, ...]:
    """Build the sections of a chapter in order.

    Raises
    ------
    InputError
        If there is no such chapter.
    """
    return tuple(_split(chapter, topic_text(chapter)))


def section_at(address: str, present: str) -> Section | None:
    """Return the section that a link in the chapter ``present`` leads to; None for other files and pages."""
    file, _, anchor = address.partition("#")
    chapter = file.removesuffix(".md") if file else present
    if chapter not in CHAPTERS or "://" in address:
        return None
    its = sections(chapter)
    return next((one for one in its if one.anchor == anchor), its[0])


def search(words: str) -> tuple[Found, ...]:
    """Find the sections with all of some words, ignoring case; first those with all words in the heading."""
    wanted = words.lower().split()
    if not wanted:
        return ()
    hits = [
        one
        for chapter in CHAPTERS
        for one in sections(chapter)
        if all(word in f"{one.heading}\n{one.text}".lower() for word in wanted)
    ]
    hits.sort(key=lambda one: not all(word in one.heading.lower() for word in wanted))  # stable sort
    return tuple(Found(one, _line_with(one.text, wanted)) for one in hits)


def _split(chapter: str, text: str) -> Iterator[Section]:
    fenced, started = False, (1, chapter)
    lines: list[str] = []
    for line in text.splitlines():
        fenced ^= _FENCE.match(line) is not None
        heading = None if fenced else _HEADING.match(line)
        if heading is not None:
            if lines:
                yield _section(chapter, started, lines)
            started, lines = (len(heading[1]), heading[2]), []
        lines.append(line)
    yield _section(chapter, started, lines)


def _section(chapter: str, started: tuple[int, str], lines: list[str]) -> Section:
    level, heading = started
    return Section(chapter, anchor_of(heading), heading, level, "\n".join(lines) + "\n")


def _without_fences(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def _line_with(text: str, words: list[str]) -> str:
    lines = [line for line in text.splitlines()[1:] if line.strip()]
    return next((line.strip() for line in lines if any(word in line.lower() for word in words)), "")
