"""README and handbook name only programs of tests/evidence that are there, and every program is shown."""

from __future__ import annotations

import re

from tests.evidence.page import README_ROWS, figures_part, readme_part
from tests.evidence.skeleton import Limit, Share, programs, stated_results
from tests.handbook.chapters import CHAPTERS, ROOT, chapter_path


def test_programs_that_are_named_are_there() -> None:
    known = {*programs(), "page", "NAME"}
    for chapter in CHAPTERS:
        text = (ROOT / chapter_path(chapter)).read_text("utf-8")
        assert {*re.findall(r"python -m\s+tests\.evidence\s(\w+)", text)} <= known, chapter
        assert "python -m tests.trials" not in text, chapter


def test_figures_are_of_programs_and_shown() -> None:
    assert set(stated_results()) <= set(programs())
    assert {name for _, _, name in README_ROWS} <= set(stated_results())
    for title in (stated["title"] for stated in stated_results().values()):
        assert f"## {title}\n" in figures_part()
    assert "| --- | --- | --- |" in readme_part()


def test_limits_and_shares_are_said() -> None:
    assert Limit("error", 0.2, most=0.3).words() == "error: 0.2 (at most 0.3)"
    assert Limit("share", 0.5, 1.0, 0.9).words() == "share: 0.5 (at least 0.9, at most 1; MISSED)"
    assert str(Share.of([True, False, None, 1])) == "2 of 4 (6.8 to 93.2 %)"
    assert str(Share.of([])) == ""
