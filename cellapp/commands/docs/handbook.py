"""Chapters of the handbook, sections of single effects, and anchors of headings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from cellapp.commands.docs.keys import filled_keys
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.removed import removed_command

PARTS: Mapping[str, Mapping[str, str]] = {
    "begin here": {
        "tutorial": "from an empty folder to a certificate, on the simulated twin",
        "readings": "readings that you measured elsewhere: any table, any arm, in ten minutes",
        "cell": "connecting the real cell step by step, with its risks; writing a profile",
        "instruments": "tracker, bridge, 6-D probe, weather station",
        "faults": "stopping, going on after a fault, and what each message asks of you",
        "glossary": "the terms of the field as this program uses them",
    },
    "measure and calibrate": {
        "install": "a wheel, extras, completion in the shell, Windows, a container",
        "commands": "every command, JSON, exit codes",
        "terminal": "the terminal application: a day, its screens and its keys",
        "planning": "which stops are measured, obstacles, editing a plan",
        "motion": "sweeps instead of stops: recordings of joints and points, each with its own clock",
        "discovery": "how discovery decides, and what its words mean",
        "effects": "the physical effects that discovery knows",
        "files": "every file that goes in or comes out: columns, units, frames, examples",
        "frames": "frames and conventions: where each frame sits, signs, D-H rows, order of rotations",
        "limits": "what was never tried on real hardware, and what the program does not do",
    },
    "use what was calibrated": {
        "targets": "targets, paths and UR programs for the calibrated arms: lists, verdicts, uncertainty, measuring",
        "exports": "calibrated arms for other programs, and what their files cannot hold",
        "check": "whether a calibration still holds, what moved or changed; calibrating again with few stops",
        "iso9283": "tests by ISO 9283: cube, cycles, formulas, uncertainty, what one SMR cannot show",
        "report": "the page and the certificate of a run: tolerances, uncertainty, decision rule, signing",
        "python": "using cellapp from Python: runs, models, data frames, mistakes",
    },
    "for developers": {
        "validation": "what was measured of the program, on real arms first, each with the program that measured it",
        "extend": "arms, drivers, effects and exports of your own, as plug-ins",
        "emulator": "the emulated cell: real protocols, faults at will",
        "scale": "effects hidden in a cell of yours: trials on all cores or a Dask cluster",
        "architecture": "how the code is laid out, how to add to it, tests",
        "decisions": "decisions that shaped the architecture, with their reasons",
    },
}
"""Name and subject of each chapter, a Markdown file of ``cellapp.docs``, by part of the handbook."""
CHAPTERS: Mapping[str, str] = {name: subject for part in PARTS.values() for name, subject in part.items()}
"""Name and subject of each chapter, in the order of the parts."""
_SECTION = re.compile(r"^## (\w+)$", re.MULTILINE)
_MARKER = re.compile(r"<!--.*?-->\n")
_FOR_TESTS = re.compile(r"^([ ]*```\w+) .*$", re.MULTILINE)
"""Words after the language on the first line of an example: they tell the tests how to run it."""


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
        said = f"docs: '{topic}' is not a topic; {meant} are {', '.join(topics())}{where}"
        raise InputError(removed_command(f"docs {topic}") or said)
    return filled_keys(_FOR_TESTS.sub(r"\1", _MARKER.sub("", kept)))


def chapter_text(chapter: str) -> str:
    """Return a chapter as stored, with the markers around parts that repeat declarations."""
    return resources.files("cellapp.docs").joinpath(f"{chapter}.md").read_text("utf-8")


def effect_sections() -> dict[str, str]:
    """Return each effect's section by slug: from the chapter on effects, or a plug-in effect's declaration."""
    from cellapp.commands.docs.effect_parts import declared_part  # late: chapters do not need it
    from cellapp.robot.effects import EFFECTS

    text = chapter_text("effects")
    found = list(_SECTION.finditer(text))
    ends = [*(match.start() for match in found[1:]), len(text)]
    sections = {match[1]: text[match.start() : end] for match, end in zip(found, ends, strict=True)}
    added = (one for slug, one in EFFECTS.items() if slug not in sections)
    return sections | {one.slug: f"## {one.slug}\n\n*{one.title}.*\n\n{declared_part(one)}" for one in added}


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as Markdown readers form it."""
    return re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-")


_FENCE = re.compile(r"^```")
_HEADING = re.compile(r"^(#+) (.+)$")
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
    return tuple(_split(chapter, topic_text(chapter)))


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


def _split(chapter: str, text: str) -> Iterator[ChapterSection]:
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


def _section(chapter: str, started: tuple[int, str], lines: list[str]) -> ChapterSection:
    level, heading = started
    return ChapterSection(chapter, anchor_of(heading), heading, level, "\n".join(lines) + "\n")
