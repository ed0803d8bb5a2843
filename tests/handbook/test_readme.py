"""README and handbook as texts: length of the README, links and their anchors, every chapter listed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cellapp.docs
from cellapp.commands.docs.handbook import CHAPTERS, PARTS

README = Path(__file__).parents[2] / "README.md"
DOCS = Path(cellapp.docs.__file__).parent
TEXTS = {"README": README, **{chapter: DOCS / f"{chapter}.md" for chapter in CHAPTERS}}
MOST_LINES = 150
LINK = re.compile(r"!?\[[^\]]+\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Anchors of the headings of a Markdown file, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", path.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_readme_is_short() -> None:
    assert len(README.read_text("utf-8").splitlines()) <= MOST_LINES


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_to_files_and_headings_that_exist(name: str) -> None:
    path = TEXTS[name]
    for link in LINK.findall(CODE.sub("", path.read_text("utf-8"))):
        if link.startswith(("https://", "http://")):
            continue
        file, _, anchor = link.partition("#")
        target = path.parent / file if file else path
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target), link


def test_the_readme_leads_to_every_chapter_by_parts() -> None:
    listed = re.findall(r"^\| \[(\w+)\]\(cellapp/docs/\1\.md\) \| (.+) \|$", README.read_text("utf-8"), re.MULTILINE)
    assert listed == list(CHAPTERS.items()), "the README's tables 'Read on' are those of the handbook's parts"
    parts = re.findall(r"^\| ([a-z ]+) \| \|$", README.read_text("utf-8"), re.MULTILINE)
    assert parts == list(PARTS)
