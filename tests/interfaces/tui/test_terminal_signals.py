"""What a terminal tells somebody who looks elsewhere; the live job on every screen, and its time that goes down."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from functools import partial
from itertools import cycle
from pathlib import Path

import pytest

from cellapp.ground.progress import Progress, StateChange
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.job_record import JobRecord, Pace
from cellapp.interfaces.tui.run_state import run_state
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.terminal import notice_sequence, title_sequence, title_words
from cellapp.interfaces.tui.widgets.progress_bars import Part, _line, ending_words, parts_of
from cellapp.interfaces.tui.workspace import Workspace
from tests.interfaces.tui.pilot import PROFILES, SMALL, HeldJob, ended, opened, shown_text, until

HALF = Progress("collect", 215, 400, "stop 216", 600.0)
LOST = Progress("collect", 215, 400, detail=StateChange("stopped", "arm right: link lost."))


def record(*events: Progress) -> JobRecord:
    made = JobRecord()
    made.begin("collect")
    for event in events:
        made.add(event)
    return made


def test_the_title_says_state_and_percent() -> None:
    space = Workspace(folder=Path("logs/day"))
    assert title_words(run_state(space, JobRecord()), JobRecord()) == "cellapp · logs/day"
    running = record(HALF)
    assert title_words(run_state(space, running), running) == "53 % collect · logs/day"
    stopped = record(HALF, LOST)
    assert title_words(run_state(space, stopped), stopped) == "STOPPED 53 % collect · logs/day"


def test_no_text_ends_a_sequence_early() -> None:
    for sequence in (title_sequence("a\x07b\x1b]0;c\n"), notice_sequence("x;y\x07", "a\x1b\\b\x9c")):
        inner = sequence.strip("\x07").replace("\x1b]2;", "").replace("\x1b]9;", "").replace("\x1b]777;", "")
        assert "\x1b" not in inner
        assert "\x9c" not in inner
    assert notice_sequence("cellapp stopped", "why") == (
        "\x07\x1b]9;cellapp stopped: why\x07\x1b]777;notify;cellapp stopped;why\x07"
    )


def test_the_time_that_is_left_goes_down_between_two_reports() -> None:
    part = Part("collect", HALF, Pace(0.0, 15, 100.0))
    assert part.left_s(100.0) == pytest.approx(600.0)
    assert part.left_s(220.0) == pytest.approx(480.0)
    assert replace(part, waits=True).left_s(220.0) is None, "who waits for a person has no time of ending"
    assert ending_words(-3.0, datetime(2026, 1, 2)) == "any moment"
    assert Pace(0.0, 15, 100.0).per_minute(215) == pytest.approx(120.0)
    assert Pace(0.0, 15, 100.0).per_minute(15) is None
    assert all(one.waits for one in parts_of(record(HALF, LOST)))


@pytest.mark.parametrize(("span_s", "words"), [(0.6, "6400/min"), (40.0, "96/min"), (400.0, "9.6/min")])
def test_a_rate_has_no_power_of_ten(span_s: float, words: str) -> None:
    part = Part("collect", Progress("collect", 79, 400), pace=Pace(0.0, 15, span_s))
    assert words in _line(part, 200, datetime.now()).plain


def shows(app: CellApp, words: str) -> bool:
    return words in shown_text(app)


async def test_every_screen_shows_the_job_with_its_newest_line(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(CellApp, "tell", lambda app, sequence: told.append(sequence))
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        for entry, name in zip(SCREENS, cycle(("plan", "calibrate", "discover", "verify", "iso9283")), strict=False):
            held = HeldJob((Progress(name, 3, 40, "what it does", 240.0),))
            await pilot.press(entry.key)
            app.start_job(held.job(name))
            app.say("the newest line")
            await until(pilot, partial(shows, app, "what it does"), f"the job on {entry.step}")
            text = shown_text(app)
            assert "3/40" in text
            assert re.search(r"\d (min|s) left, at \d", text)
            assert "the newest line" in text
            told.clear()
            held.go_on.set()
            await ended(pilot, app)
            assert any("done" in one and "\x1b]9;" in one for one in told), "its end is told"


async def test_a_stop_is_told_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(CellApp, "tell", lambda app, sequence: told.append(sequence))
    held = HeldJob((HALF, LOST))
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.start_job(held.job())
        await until(pilot, lambda: any("link lost, 215 of 400" in one for one in told), "the notice")
        await until(pilot, lambda: any("STOPPED 53 % collect" in one for one in told), "the title")
        assert "link lost, 215 of 400" in app.message
        held.go_on.set()
        await ended(pilot, app)
