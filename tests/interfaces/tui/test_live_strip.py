"""What every screen shows of the open cell, whether the job gives a sign of life or hangs; arms that were not seen."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.unseen_arms import note_halt, unseen_arms
from cellapp.ground.control import JobControl
from cellapp.ground.progress import ArmLive, CellLive, Halt, HaltState, Listener, MeasurementBegun, Progress
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.job_record import banner_of, strip_of
from cellapp.interfaces.tui.jobs import Ask, Job
from tests.cell.run.small_runs import planned_run
from tests.interfaces.tui.pilot import PROFILES, SIZES, ended, opened, shown_text, until
from tests.waiting import WAIT_S

FRESH = CellLive({"left": ArmLive(0.02, False), "right": ArmLive(0.04, True)}, 0.05, 0.1)


class HungJob:
    """A job that measures and says nothing more; ``live`` is what is known of its cell."""

    def __init__(self) -> None:
        self.live = FRESH
        self.over = threading.Event()

    def job(self) -> Job:
        def work(listener: Listener, control: JobControl, ask: Ask) -> None:
            with control.watching(lambda: self.live), control.brakes(lambda verb: None):
                listener(Progress("collect", 3, 30, detail=MeasurementBegun(3, "left")))
                assert self.over.wait(WAIT_S)

        return Job("collect", work, moves=True)


@pytest.mark.parametrize("size", SIZES)
async def test_a_cell_that_is_dead_is_not_shown_as_running_though_its_job_hangs(size: tuple[int, int]) -> None:
    app, job = CellApp(PROFILES), HungJob()
    async with app.run_test(size=size) as pilot:
        await opened(pilot, app)
        app.start_job(job.job())
        await pilot.press("3")
        await until(pilot, lambda: "right moves 0.0 s" in shown_text(app), "the ages")
        assert "left rests 0.0 s" in shown_text(app)
        assert "tracker 0.1 s" in shown_text(app) or "tracker 0.0 s" in shown_text(app)
        await until(pilot, lambda: "RUNNING" in shown_text(app), "running")
        job.live = replace(FRESH, arms={"left": ArmLive(2.0, False), "right": ArmLive(None, True)})
        # header, strip and headline are drawn one after the other
        await until(pilot, lambda: "RUNNING" not in shown_text(app), "what is old is not running")
        await until(pilot, lambda: "NO DATA from arm left, arm right" in shown_text(app), "what is missing")
        await until(pilot, lambda: app.screen.query_one("#state").has_class("halted"), "its colour")
        assert "RUNNING" not in shown_text(app)
        await pilot.press("1")
        await until(pilot, lambda: "NO DATA from arm left, arm right" in shown_text(app), "another screen")
        job.over.set()
        await ended(pilot, app)
        await until(pilot, lambda: "NO DATA" not in shown_text(app), "no cell is open any more")


async def test_each_state_of_a_stop_is_shown_without_the_job() -> None:
    app, job = CellApp(PROFILES), HungJob()
    async with app.run_test(size=SIZES[0]) as pilot:
        await opened(pilot, app)
        app.start_job(job.job())
        await pilot.press("3")
        await until(pilot, lambda: "MEASURING" in shown_text(app), "measuring")
        cause = ("arm left: link lost",)
        for state, words in (("asked", "STOP ASKED"), ("braking", "ARMS BRAKE"), ("at rest", "AT REST: all arms")):
            arms = {name: ArmLive(0.05, False, Halt(state, "why")) for name in ("left", "right")}  # type: ignore[arg-type]
            job.live = replace(FRESH, arms=arms, causes=cause)
            await until(pilot, lambda words=words: words in shown_text(app), words)  # type: ignore[misc]
            assert "arm left: link lost" in shown_text(app)
            await until(pilot, lambda: "STOPPED" in shown_text(app), "the headline, which is drawn after the strip")
            assert "MEASURING" not in shown_text(app)
        unseen = ArmLive(None, True, Halt("not seen at rest", "why"))
        job.live = replace(FRESH, arms={"left": unseen, "right": unseen}, causes=cause)
        await until(pilot, lambda: "NOT SEEN AT REST: arms left, right" in shown_text(app), "the doubt")
        assert any(row.level == "error" and "NOT SEEN AT REST" in row.text for row in app.record.log)
        job.over.set()
        await ended(pilot, app)


async def test_an_arm_that_was_not_seen_stays_on_every_screen_until_a_person_says_so(tmp_path: Path) -> None:
    with planned_run(tmp_path / "run") as run:
        note_halt(run, "left", Halt("not seen at rest", "arm left: link lost"))
    app = CellApp(PROFILES)
    async with app.run_test(size=SIZES[1]) as pilot:
        await opened(pilot, app)
        app.open_run(tmp_path / "run")
        await until(pilot, lambda: "NOT SEEN AT REST: arm left" in shown_text(app), "the doubt")
        for key in "2345678":
            await pilot.press(key)
            await until(pilot, lambda: "NOT SEEN AT REST: arm left; treat it as moving" in shown_text(app), f"on {key}")
        await pilot.press("ctrl+p")
        await pilot.press(*"arm left is at rest")
        await until(pilot, lambda: "it no longer counts as moving" in shown_text(app), "the command")
        await pilot.press("enter")
        await until(pilot, lambda: "Is arm left at rest?" in shown_text(app), "the question")
        await pilot.press("s")
        await until(pilot, lambda: "NOT SEEN AT REST" not in shown_text(app), "it is settled")
    with RunFile.open(tmp_path / "run") as run:
        assert unseen_arms(run) == {}


# -- The strip and its banner: ages of all data, how far a stop is, and what counts as moving --------------------------


def arm(age_s: float | None = 0.05, *, moving: bool = False, halt: HaltState | None = None) -> ArmLive:
    return ArmLive(age_s, moving, None if halt is None else Halt(halt, "why"))


def cell(left: ArmLive, right: ArmLive, tracker_age_s: float | None = 0.1, causes: tuple[str, ...] = ()) -> CellLive:
    return CellLive({"left": left, "right": right}, tracker_age_s, 0.2, causes)


def test_ages_are_amber_above_three_tenths_and_red_above_one_second() -> None:
    parts = strip_of(cell(arm(0.3, moving=True), arm(0.31), tracker_age_s=1.01))
    assert [(part.text, part.look) for part in parts] == [
        ("left moves 0.3 s", "fresh"),
        ("right rests 0.3 s", "late"),
        ("tracker 1.0 s", "lost"),
        ("job 0.2 s", "fresh"),
    ]


def test_missing_data_are_named_where_nothing_was_stopped() -> None:
    banner = banner_of(cell(arm(5.0), arm(), tracker_age_s=None), {})
    assert banner is not None
    assert banner.words.startswith("NO DATA from arm left, tracker")
