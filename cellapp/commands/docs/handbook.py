"""Chapters of the handbook, sections of single effects, and anchors of headings."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import chain
from typing import TYPE_CHECKING

from cellapp.commands.docs.keys import filled_keys
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError

if TYPE_CHECKING:
    from cellapp.robot.effects import Effect

PARTS: Mapping[str, tuple[str, ...]] = {
    "begin here": ("tutorial", "readings", "cell", "instruments", "faults", "glossary"),
    "measure and calibrate": (
        "install",
        "commands",
        "terminal",
        "planning",
        "motion",
        "discovery",
        "effects",
        "files",
        "frames",
        "limits",
    ),
    "use what was calibrated": ("targets", "exports", "check", "iso9283", "report", "python"),
    "for developers": ("validation", "extend", "emulator", "scale", "architecture", "decisions"),
}
"""Names of the chapters, Markdown files of ``cellapp.docs``, by part of the handbook."""
CHAPTERS = tuple(chain.from_iterable(PARTS.values()))
"""Names of the chapters, in the order of the parts."""
_SECTION = re.compile(r"^## (\w+)$", re.MULTILINE)
_MARKER = re.compile(r"<!--.*?-->\n")
_FOR_TESTS = re.compile(r"^([ ]*```\w+) .*$", re.MULTILINE)
"""Words after the language on the first line of an example: they tell the tests how to run it."""


WIDTH = 120
"""Line width of the Markdown files."""
_GENERAL_PLACE = {"link_bending": "the link", "unknown": "a part of the cell"}


def topics() -> list[str]:
    """Return the names of the chapters and of the effects that have a section."""
    return [*CHAPTERS, *effect_sections()]


def topic_text(topic: str) -> str:
    """Return the Markdown of a chapter or of one effect's section with its keys, without markers and words for tests.

    Raises
    ------
    InputError
        If there is no such topic.
    """
    kept = chapter_text(topic) if topic in CHAPTERS else effect_sections().get(topic)
    if kept is None:
        meant = did_you_mean(topic, topics(), "did you mean '{}'? Topics", otherwise="topics")
        where = ", ".join(one.address for one in search(topic)[:3])
        where = f"; sections with this word: {where}" if where else ""
        raise InputError(f"docs: '{topic}' is not a topic; {meant} are {', '.join(topics())}{where}")
    return filled_keys(_FOR_TESTS.sub(r"\1", _MARKER.sub("", kept)))


def chapter_text(chapter: str) -> str:
    """Return a chapter as stored, with the markers around parts that repeat declarations."""
    return resources.files("cellapp.docs").joinpath(f"{chapter}.md").read_text("utf-8")


def effect_sections() -> dict[str, str]:
    """Return each effect's section by slug: from the chapter on effects, or a plug-in effect's declaration."""
    from cellapp.robot.effects import EFFECTS  # late: chapters do not need it

    text = chapter_text("effects")
    found = list(_SECTION.finditer(text))
    ends = [*(match.start() for match in found[1:]), len(text)]
    sections = {match[1]: text[match.start() : end] for match, end in zip(found, ends, strict=True)}
    added = (one for slug, one in EFFECTS.items() if slug not in sections)
    return sections | {one.slug: f"## {one.slug}\n\n*{one.title}.*\n\n{declared_part(one)}" for one in added}


def declared_part(effect: Effect) -> str:
    """Return an effect's declaration as Markdown, between markers: cause, usual size, checks, further stops."""
    meaning = effect.meaning.at(_GENERAL_PLACE.get(effect.slug, "the joint"))
    known = "" if meaning.size_source == "none" else f" ({meaning.size_source})"
    parts = [
        _wrapped(f"**Cause.** {meaning.cause}"),
        _wrapped(f"**Usual size**{known}. {meaning.size}."),
        _wrapped(f"**Check or mend.** {' '.join(meaning.check)}"),
        *([_wrapped(f"**What settles it.** {' '.join(meaning.settle)}")] if meaning.settle else []),
    ]
    return f"<!--declared:{effect.slug}-->\n" + "\n\n".join(parts) + "\n<!--end-->\n"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as Markdown readers form it."""
    return re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-")


_CODE_OR_HEADING = re.compile(r"^```.*?^```|^(#+) ([^\n]+)$", re.MULTILINE | re.DOTALL)
_PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)]+)\)")
_CAPTION = re.compile(r"(!\[([^\]]+)\]\([^)]+\)\n)\n\*\2\.?\*\n")
"""A picture followed by a caption that repeats its words."""


@dataclass(frozen=True)
class ChapterSection:
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

    def line_with(self, words: str) -> str:
        """Return the first line below its heading with one of the words; empty if only the heading has them."""
        lines = (line.strip() for line in self.text.splitlines()[1:] if line.strip())
        return next((line for line in lines if any(word in line.lower() for word in words.lower().split())), "")


@cache
def sections(chapter: str) -> tuple[ChapterSection, ...]:
    """Build the sections of a chapter in order.

    Raises
    ------
    InputError
        If there is no such chapter.
    """
    text = topic_text(chapter)
    found = [match for match in _CODE_OR_HEADING.finditer(text) if match[1]]
    ends = [*(match.start() for match in found[1:]), len(text)]
    return tuple(
        ChapterSection(chapter, anchor_of(match[2]), match[2], len(match[1]), text[match.start() : end])
        for match, end in zip(found, ends, strict=True)
    )


def search(words: str) -> list[ChapterSection]:
    """Find the sections with all of some words, ignoring case; first those with all words in the heading."""
    wanted = words.lower().split()
    hits = [
        one
        for chapter in CHAPTERS
        for one in sections(chapter)
        if wanted and all(word in f"{one.heading}\n{one.text}".lower() for word in wanted)
    ]
    return sorted(hits, key=lambda one: not all(word in one.heading.lower() for word in wanted))
