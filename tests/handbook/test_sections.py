"""The handbook by sections: headings, addresses of links, pictures by their words, search."""

from __future__ import annotations

import json
import re

import pytest
from typer.testing import CliRunner

from cellapp.commands.docs.handbook import CHAPTERS, anchor_of, chapter_text, search, sections, topic_text
from cellapp.ground.errors import InputError
from tests.program import app

_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
_LINK = re.compile(r"(?<!!)\[[^\]]+\]\(([^)\s]+)\)")
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def _anchors(chapter: str) -> set[str]:
    """Anchors of the headings of a chapter."""
    return {anchor_of(heading) for heading in _HEADING.findall(_FENCED.sub("", chapter_text(chapter)))}


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_the_sections_of_a_chapter_are_its_text_and_every_link_leads_somewhere(chapter: str) -> None:
    its = sections(chapter)
    assert "".join(one.text for one in its).rstrip("\n") == topic_text(chapter).rstrip("\n")
    assert {one.anchor for one in its} == _anchors(chapter)
    assert its[0].level == 1
    assert not any("![" in one.terminal_text for one in its)
    for place in _LINK.findall(_FENCED.sub("", chapter_text(chapter))):
        file, _, anchor = place.partition("#")
        there = file.removesuffix(".md") or chapter
        if "://" not in place and there in CHAPTERS:
            assert not anchor or anchor in _anchors(there), place


def test_a_picture_is_named_by_its_words_once() -> None:
    backlash = next(one for one in sections("effects") if one.anchor == "backlash")
    words = "Offset of joint 2 over its last step: half play of 40 µrad; hysteresis taken up over 11 deg"
    assert backlash.terminal_text.count(words) == 1
    assert f"*Picture: {words}*" in backlash.terminal_text
    with pytest.raises(InputError, match="not a topic"):
        sections("sorcery")


def test_a_search_finds_all_words_headings_first() -> None:
    found = search("Hayati angle")
    assert found[0].section.address == "frames.md#hayati-angle"
    assert len(found) > 1
    assert all("hayati" in hit.line.lower() or "angle" in hit.line.lower() for hit in found if hit.line)
    assert search("") == search("no such word anywhere") == ()


def test_the_command_searches() -> None:
    runner = CliRunner()
    listed = runner.invoke(app, ["docs", "--search", "hayati angle"]).output
    assert listed.startswith("frames.md#hayati-angle\n  ")
    result = json.loads(runner.invoke(app, ["docs", "--search", "nosuchword", "--json", "-"]).stdout)
    assert result["text"] == "no section has all of these words: nosuchword"
    assert "without a topic" in str(runner.invoke(app, ["docs", "backlash", "--search", "x"]).exception)
