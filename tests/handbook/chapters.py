"""The examples of README and handbook: fenced blocks, what their first lines say of them, and commands in sentences.

The first line of a block is a language, then words that say what may be done with it:

``sh``
    Commands. The tests run them in a folder with a small run, in the order of the chapter.
``sh long``
    Commands that take more than a few seconds on the small run. Run by the slow tests, on full profiles.
``sh server``
    Commands that serve until they are interrupted. Their options are checked; they are not run.
``sh real-cell``
    Commands that need devices, or an emulated cell that runs in another shell. Not run.
``sh dev``
    Commands that install, build or need an optional program. Not run.
``yaml``, ``csv``
    A list of targets, paths, or sections of a profile: read as the program reads it. ``file=NAME``: the commands of the
    chapter find it under this name. ``part=KEY.KEY``: it stands there in a profile, and the file is the whole profile.
    ``excerpt``: part of a file that is not complete without the rest; only its syntax is read.
``python``
    Executed in the folder of the commands, all blocks of a chapter one after the other. ``long``, ``real-cell``,
    ``dev``: only compiled.
``json``, ``toml``
    Only read.
``text``
    What a command prints, after a line ``$ cellapp ...`` whose options are checked, or anything else that nobody runs.
    ``printed``: the commands before it print this; compared by the slow tests, as small runs have other figures.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
_CHAPTERS = ROOT / "cellapp" / "docs"
CHAPTERS = ("README", *sorted(path.stem for path in _CHAPTERS.glob("*.md")))
"""README and every chapter that is there."""
NOT_RUN = ("server", "real-cell", "dev")
LONG = "long"
EXCERPT = "excerpt"
PRINTED = "printed"
_COMMAND = re.compile(r"cellapp [-a-z]")
_PROMPT = "$ "
"""What begins a command above what it prints."""


@dataclass(frozen=True)
class Example:
    """A fenced block.

    Attributes
    ----------
    path : Path
        The Markdown file, seen from the repository.
    line : int
        Line of the file in which the text begins, from 1.
    language : str
        First word of the block's first line; empty if it has none.
    words : frozenset of str
        Its other words without a value.
    values : tuple of (str, str)
        Its other words ``key=value``.
    text : str
        What stands in the block.
    """

    path: Path
    line: int
    language: str
    words: frozenset[str]
    values: tuple[tuple[str, str], ...]
    text: str

    def value(self, key: str) -> str:
        """What the first line says after ``key=``; empty if nothing."""
        return dict(self.values).get(key, "")

    def place(self, line: int = 0) -> str:
        """File and line, of the text's first line or of one after it."""
        return f"{self.path}:{self.line + line}"


@dataclass(frozen=True)
class Command:
    """A line of a shell, with the place where it begins."""

    place: str
    text: str


def chapter_path(chapter: str) -> Path:
    """The file of a chapter, seen from the repository."""
    path = ROOT / "README.md" if chapter == "README" else _CHAPTERS / f"{chapter}.md"
    return path.relative_to(ROOT)


@cache
def examples(chapter: str) -> tuple[Example, ...]:
    """All fenced blocks of a chapter."""
    path = chapter_path(chapter)
    found = []
    for token in MarkdownIt("commonmark").parse((ROOT / path).read_text("utf-8")):
        if token.type == "fence" and token.map is not None:
            language, *words = token.info.split() or [""]
            values = tuple((key, value) for key, mark, value in (word.partition("=") for word in words) if mark)
            plain = frozenset(word for word in words if "=" not in word)
            found.append(Example(path, token.map[0] + 2, language, plain, values, token.content))
    return tuple(found)


def blocks(chapter: str, language: str) -> list[str]:
    """Texts of the blocks of one language."""
    return [example.text for example in examples(chapter) if example.language == language]


@cache
def mentions(chapter: str) -> tuple[Command, ...]:
    """Commands of this program that stand in sentences, in tables and above what they print."""
    path = chapter_path(chapter)
    found = []
    for token in MarkdownIt("commonmark").enable("table").parse((ROOT / path).read_text("utf-8")):
        for child in token.children or ():
            if child.type == "code_inline" and _COMMAND.match(child.content) and token.map is not None:
                found.append(Command(f"{path}:{token.map[0] + 1}", child.content))
    for example in examples(chapter):
        for number, line in enumerate(example.text.splitlines() if example.language in ("", "text") else ()):
            if line.startswith(f"{_PROMPT}cellapp "):
                found.append(Command(example.place(number), line.removeprefix(_PROMPT)))
    return tuple(found)


def commands(example: Example) -> Iterator[Command]:
    """The commands of a block, without comments; a backslash at the end of a line continues it."""
    begin, parts = 0, list[str]()
    for number, line in enumerate(example.text.splitlines()):
        if not parts and (not line.strip() or line.lstrip().startswith("#")):
            continue
        begin = begin if parts else number
        parts.append(line.removesuffix("\\").strip())
        if not line.endswith("\\"):
            yield Command(example.place(begin), " ".join(parts))
            parts = []
