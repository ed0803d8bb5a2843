"""Nothing is done again without a question: a key that would repeat what a run holds asks first, and begins nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from textual.screen import ModalScreen

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.pictures import settle
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened, shown_text, until

DAY = Path("logs") / "day"
ASKED = {
    "plan a new run": ("2", "b"),
    "append stops": ("2", "plus"),
    "design the rest again": ("2", "r"),
    "calibrate": ("4", "b"),
    "calibrate with a prior": ("4", "i"),
    "search": ("5", "b"),
    "propose": ("5", "plus"),
    "locate": ("6", "l"),
    "check": ("7", "k"),
    "ISO 9283": ("7", "m"),
    "certificate": ("7", "e"),
    "report": ("7", "b"),
    "the whole day": ("1", "f5"),
}


async def test_each_key_that_repeats_what_a_run_holds_asks_first(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    before = (DAY / "run.sqlite").read_bytes()
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY, PROFILES / "twin.yaml")
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        for what, (step, key) in ASKED.items():
            await pilot.press(step)
            await settle(pilot)
            await pilot.press(key)
            await until(pilot, lambda: isinstance(app.screen, ModalScreen), f"a question before: {what}")
            assert not app.jobs.running, what
            await pilot.press("escape")
            await until(pilot, lambda: not isinstance(app.screen, ModalScreen), f"no question any more: {what}")
            assert not app.jobs.running, f"{what}:\n{shown_text(app)}"
    assert (DAY / "run.sqlite").read_bytes() == before


async def test_without_the_file_of_a_profile_a_sentence_says_what_to_do(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("2", "b")
        await until(pilot, lambda: "choose one on the screen Cell (key 1)" in app.message, "the sentence")


@pytest.mark.parametrize("key", ["4", "5"])
async def test_the_question_says_what_is_there_and_the_default_leaves_it(key: str, finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.open_run(DAY, PROFILES / "twin.yaml")
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press(key, "b")
        await until(pilot, lambda: isinstance(app.screen, ModalScreen), "the question")
        assert "The run has a result that holds" in " ".join(shown_text(app).split())
        await pilot.press("enter")
        await until(pilot, lambda: not isinstance(app.screen, ModalScreen), "the screen")
        assert not app.jobs.running
