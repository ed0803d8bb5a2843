"""The table of what a new effect, driver, export, verb, chart or screen touches is what the toys really touch."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import cellapp
from cellapp.commands.docs.handbook import chapter_text
from cellapp.interfaces.tui.screens import SCREENS
from tests.touches import TESTS, TOUCHES, Touch, touches_table

PACKAGE = Path(cellapp.__file__).parent


@pytest.mark.parametrize("touch", TOUCHES, ids=lambda touch: touch.kind)
def test_a_toy_has_these_files_and_a_test_that_shows_it(touch: Touch) -> None:
    assert all((TESTS / one).is_file() for one in touch.own)
    assert (TESTS / touch.shown_by).is_file()
    for line in touch.elsewhere:
        assert (PACKAGE.parent / line.partition(":")[0]).is_file()


def test_a_kind_without_lines_elsewhere_is_named_in_its_own_folder_alone() -> None:
    """Chart and dialog of the toy verb: no interface knows them."""
    for path in (PACKAGE / "interfaces").rglob("*.py"):
        assert "greet" not in path.read_text("utf-8").lower(), path


def test_a_screen_is_named_in_the_registry_of_screens_alone() -> None:
    for entry in SCREENS:
        word = re.compile(rf"\b{entry.class_name}\b")
        naming = {path for path in PACKAGE.rglob("*.py") if word.search(path.read_text("utf-8"))}
        own = PACKAGE / f"interfaces/tui/screens/{entry.step}.py"
        assert naming == {own, PACKAGE / "interfaces/tui/screens/__init__.py"}, entry.class_name


def test_the_handbook_has_this_table() -> None:
    assert touches_table() in chapter_text("house")
