"""Numbers with the noun that they count, one function for all sentences."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cellapp
from cellapp.ground.counting import counted

_NOUNS = ("targets", "stops", "readings", "cycles", "checks", "positions")
_NUMBER = re.compile(
    r"len\(.*\)|count|left|rows|wanted|total|done|asked|n|.*\.(n|stops|cycles|readings|stops_left|targets)"
)
_AT_LEAST_TWO = {"one.targets"}
"""Of sentences that are said of two or more only."""


def test_one_and_many() -> None:
    assert counted(1, "stop") == "1 stop"
    assert counted(0, "stop") == "0 stops"
    assert counted(2, "stop is", "stops are") == "2 stops are"


def _bare(path: Path) -> Iterator[str]:
    """Numbers that stand before a plural without being counted."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.JoinedStr):
            continue
        for value, after in pairwise(node.values):
            if isinstance(value, ast.FormattedValue) and value.format_spec is None and isinstance(after, ast.Constant):
                source, word = ast.unparse(value.value), str(after.value).removeprefix(" ").partition(" ")[0]
                if word.strip(".,;:)") in _NOUNS and _NUMBER.fullmatch(source) and source not in _AT_LEAST_TWO:
                    yield f"{path.name}:{node.lineno}: {{{source}}} {word}"


def test_what_a_person_reads_counts_with_one_function() -> None:
    root = Path(cellapp.__file__).parent
    found = [
        one
        for part in ("interfaces", "commands", "cell")
        for path in (root / part).rglob("*.py")
        for one in _bare(path)
    ]
    assert not found, "\n".join(found)
