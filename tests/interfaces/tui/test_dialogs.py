"""Dialogs that are made from records of verbs, of own readings and of exports: where they begin, what Enter does, what
they refuse."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from textual.screen import ModalScreen
from textual.widgets import Input

from cellapp.cell.run import RunFile, sqlite_file
from cellapp.cell.targets.records import ArmVerification, MeasuredTarget, VerifyResult
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.compensate.request import CompensateRequest
from cellapp.commands.record import Request, View
from cellapp.commands.run.request import VERB as WHOLE_DAY
from cellapp.commands.run_results import WholeRunResult, read_results
from cellapp.ground.results import ErrorSummary, Result
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.dialogs.question import WRITE
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.job_outcome import REPORT_FILE, ending_of
from cellapp.interfaces.tui.jobs import Job
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import PROFILES, ended, running, shown_text, until
from tests.sure import sure

DAY = Path("logs") / "day"
GIVEN = {"folder": Path("day"), "targets": Path("old.script")}


async def test_enter_in_a_field_sends_what_moves_nothing_and_the_first_empty_field_has_the_focus() -> None:
    answers = list[Request | None]()
    async with running() as (pilot, app):
        proposed, choices = {"out": Path("new.script")}, {"arm": ("left", "right")}
        app.push_screen(VerbQuestion(COMPENSATE, "", WRITE, GIVEN, proposed=proposed, choices=choices), answers.append)
        await until(pilot, lambda: isinstance(app.focused, Input), "the focus")
        assert app.focused is app.screen.query_one("#arm")
        assert app.screen.query_one("#arm", Input).placeholder == "left or right"
        text = shown_text(app)
        assert "Write (Ctrl+S)" in text
        assert "Close (F10)" in text
        await pilot.press(*"left", "enter")
        await until(pilot, lambda: bool(answers), "the answer")
    assert answers == [
        CompensateRequest(folder=Path("day"), targets=Path("old.script"), out=Path("new.script"), arm="left")
    ]


# Nothing is done again without a question: a key that would repeat what a run holds asks first, and begins nothing.

ASKED = {
    "plan a new run": ("2", "b"),
    "change the plan": ("2", "plus"),
    "calibrate": ("4", "b"),
    "calibrate with a prior": ("4", "i"),
    "search": ("5", "b"),
    "propose": ("5", "plus"),
    "locate": ("6", "l"),
    "check": ("7", "k"),
    "ISO 9283": ("7", "m"),
    "certificate": ("7", "e"),
    "the whole day": ("1", "f5"),
}


async def test_each_key_that_repeats_what_a_run_holds_asks_first(finished_run: Path) -> None:
    shutil.copytree(finished_run, DAY)
    before = (DAY / "run.sqlite").read_bytes()
    async with running() as (pilot, app):
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


# -- An arm is calibrated with an earlier run as prior from the screen Calibrate, as the command does ------------------

DAY_OF_PRIOR, EARLIER = Path("logs") / "day", Path("logs") / "earlier"


async def test_the_earlier_run_is_chosen_and_shown(finished_run: Path) -> None:
    shutil.copytree(finished_run, EARLIER)
    with RunFile.open(EARLIER) as before, RunFile.create(DAY_OF_PRIOR, before.profile) as run:
        for name in run.profile.arms:
            readings = before.readings(name)
            moved = readings.p_M + np.array([0.01, 0.02, 0.03])  # the same stops, seen from another place
            run.add_readings(name, replace(readings, p_M=moved))
        calibrate_run(run)
    async with running() as (pilot, app):
        app.open_run(DAY_OF_PRIOR)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await pilot.press("4")
        await until(pilot, lambda: app.day_screen.STEP == "calibrate", "the screen")
        await pilot.press("i")
        await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the dialog")
        app.screen.query_one("#prior", Input).value = str(EARLIER)
        await pilot.press("enter")
        await ended(pilot, app)
    with RunFile.open(DAY_OF_PRIOR) as run:
        result = read_results(run).calibrate
    assert all(arm.prior is not None and arm.prior.stage == "discover" for arm in sure(result).arms.values())


RUN = Path("logs/monday")
SMALL_MM, LARGE_MM = (ErrorSummary(mean=mm, rms=mm, std=0.0, max=mm, n=3) for mm in (0.1, 2.0))
TARGETS = (MeasuredTarget(name="t1", arm="left", nominal_mm=None, compensated_mm=None, note=""),)
HELD = VerifyResult(arms={"left": ArmVerification(nominal_mm=LARGE_MM, compensated_mm=SMALL_MM)}, targets=TARGETS)
WORSE = VerifyResult(arms={"left": ArmVerification(nominal_mm=SMALL_MM, compensated_mm=LARGE_MM)}, targets=TARGETS)


def ending_words(job: Job, result: Result | None) -> tuple[str, int]:
    text, _, code = ending_of(job, result, View() if result is None else job.view(result), None)
    return text, code


@pytest.mark.parametrize(
    ("verify", "words", "code"),
    [(HELD, "the verification held", 0), (None, "nothing was verified", 0), (WORSE, "verification: arm left", 1)],
)
def test_a_day_names_its_report_and_says_whether_the_verification_held(
    verify: VerifyResult | None, words: str, code: int
) -> None:
    text, exit_code = ending_words(
        verb_jobs.job_of(WHOLE_DAY, profile=RUN, folder=RUN), WholeRunResult(run=str(RUN), verify=verify)
    )
    assert words in text
    assert str(RUN / "report.html") in text
    assert exit_code == code


def test_the_page_is_named_as_it_is_written() -> None:
    """The module has a copy of the name: the run's own loads scipy, which a start need not wait for."""
    assert REPORT_FILE == sqlite_file.REPORT_FILE
