"""Times of the handbook come with their computer, or as a ratio."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cellapp.commands.docs.handbook import chapter_text

pytestmark = pytest.mark.fast
_README = Path(__file__).parents[2] / "README.md"
_TAKES = re.compile(r"\b(?:takes?|took) (?:some |about )?[\d.]+ (?:m?s|min)\b[^.;|]*")
_KNOWN = ("figures", "AMD EPYC", "times", "of the cell", "simulated twin")
"""What tells where a time is from."""


@pytest.mark.parametrize("name", ["README", "tutorial", "check", "cell"])
def test_no_time_of_the_program_stands_alone(name: str) -> None:
    text = _README.read_text("utf-8") if name == "README" else chapter_text(name)
    text = " ".join(re.sub(r"(?s)```.*?```", "", text).split())
    alone = [words for words in _TAKES.findall(text) if not any(known in words for known in _KNOWN)]
    assert alone == []
