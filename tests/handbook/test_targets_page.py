"""The lists and the words on the page about targets."""

from __future__ import annotations

import re
from pathlib import Path

from cellapp.cell.targets.targets import load_targets
from cellapp.commands.compensate.words import PART_WORDS, advice
from cellapp.commands.docs.handbook import chapter_text
from tests.handbook.chapters import blocks
from tests.twin import small_twin

PAGE = chapter_text("targets")


def test_the_lists_are_lists_of_targets(tmp_path: Path) -> None:
    profile = small_twin()
    for language in ("yaml", "csv"):
        path = tmp_path / f"list.{language}"
        path.write_text(blocks("targets", language)[0], encoding="utf-8")
        assert load_targets(path, profile)


def test_the_page_has_every_part_of_an_uncertainty_and_the_advice_that_is_printed() -> None:
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE, re.M))
    assert set(PART_WORDS.values()) <= set(rows)
    for reason in ("out of reach", "singular: joints work against each other there"):
        assert rows[reason] == advice(reason)
    (limits,) = [reason for reason in rows if reason.startswith("beyond limits")]
    assert rows[limits] == advice(limits)
