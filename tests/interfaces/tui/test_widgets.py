"""The log, the strip of live data, title and notices, plots: by themselves and in the application; slow passes of the
collector."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rich.cells import cell_len
from textual.color import Color
from textual.pilot import Pilot

from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import note_halt, unseen_arms
from cellapp.commands.record import Ask
from cellapp.commands.view.charts import Axis, Chart, Limit, series
from cellapp.ground.control import JobControl
from cellapp.ground.progress import ArmLive, CellLive, Halt, HaltState, MeasurementBegun, Progress, StateChange
from cellapp.interfaces.tui import app
from cellapp.interfaces.tui.app import CellApp, SlowCollections
from cellapp.interfaces.tui.job_record import LEVELS, JobRecord, LogRow, banner_of, strip_of
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.plots import draw
from cellapp.interfaces.tui.widgets.chart_plot import ON_DARK, ON_LIGHT
from cellapp.interfaces.tui.widgets.log_pane import LogPane
from cellapp.interfaces.tui.widgets.progress_bars import WHOLE_DAY, ending_words, parts_of, remaining_s
from tests.cell.run.small_runs import planned_run
from tests.interfaces.tui.pilot import SIZES, HeldJob, ended, running, shown_text, shows, until
from tests.sure import sure
from tests.waiting import WAIT_S

NOON = datetime(2026, 3, 1, 12, 0, 0)


async def shown_log(pilot: Pilot[None], app: CellApp, rows: list[LogRow]) -> LogPane:
    """The screen Collect with a log."""
    await pilot.press("3")
    await until(pilot, lambda: app.screen.query(LogPane), "the log")
    pane = app.screen.query_one(LogPane)
    await until(pilot, lambda: pane.view.size.width > 0, "the log on the screen")
    pane.show("A log", rows)
    await pilot.pause()
    return pane


MANY = [
    LogRow(NOON + timedelta(seconds=number), LEVELS[number % 3], f"event {number}, {'left' if number % 3 else 'right'}")
    for number in range(400)
]


async def test_it_follows_the_end_unless_somebody_looks_up() -> None:
    async with running() as (pilot, app):
        pane = await shown_log(pilot, app, [])
        pane.show("Log of this session", MANY, stored=False)
        await shows(pilot, "event 399")
        app.say("the newest")
        await until(pilot, lambda: "the newest" in shown_text(app).partition("event 399")[2], "the newest line")
        await pilot.press("pageup")
        await until(pilot, lambda: not pane.view.auto_scroll, "a look at what is above")
        at = pane.view.scroll_offset.y
        app.record.note("newer still")
        await until(pilot, lambda: pane.shown[-1].text == "newer still", "a newer line")
        await pilot.pause()
        assert pane.view.scroll_offset.y == at
        assert "newer still" not in shown_text(app)
        await pilot.press("end")
        await shows(pilot, "newer still")
        assert pane.view.auto_scroll
        await pilot.resize_terminal(120, 40)
        await shows(pilot, "newer still")


FRESH = CellLive({"left": ArmLive(0.02, False), "right": ArmLive(0.04, True)}, 0.05, 0.1)


class HungJob:
    """A job that measures and says nothing more; ``live`` is what is known of its cell."""

    def __init__(self) -> None:
        self.live = FRESH
        self.over = threading.Event()

    def job(self) -> Job:
        def work(control: JobControl, ask: Ask) -> None:
            with control.watching(lambda: self.live), control.brakes(lambda verb: None):
                control.tell("collect", 3, 30, detail=MeasurementBegun(3, "left"))
                assert self.over.wait(WAIT_S)

        return Job("collect", work, moves=True)


@pytest.mark.parametrize("size", SIZES)
async def test_a_cell_that_is_dead_is_not_shown_as_running_though_its_job_hangs(size: tuple[int, int]) -> None:
    job = HungJob()
    async with running(size=size) as (pilot, app):
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
    job = HungJob()
    async with running(size=SIZES[0]) as (pilot, app):
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
    async with running(size=SIZES[1]) as (pilot, app):
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


def arm_live(age_s: float | None = 0.05, *, moving: bool = False, halt: HaltState | None = None) -> ArmLive:
    return ArmLive(age_s, moving, None if halt is None else Halt(halt, "why"))


def cell_live(
    remaining: ArmLive, right: ArmLive, tracker_age_s: float | None = 0.1, causes: tuple[str, ...] = ()
) -> CellLive:
    return CellLive({"left": remaining, "right": right}, tracker_age_s, 0.2, causes)


def test_ages_are_amber_above_three_tenths_and_red_above_one_second() -> None:
    parts = strip_of(cell_live(arm_live(0.3, moving=True), arm_live(0.31), tracker_age_s=1.01))
    assert parts == [
        ("left moves 0.3 s", "fresh"),
        ("right rests 0.3 s", "late"),
        ("tracker 1.0 s", "lost"),
        ("job 0.2 s", "fresh"),
    ]


def test_missing_data_are_named_where_nothing_was_stopped() -> None:
    words, *_ = sure(banner_of(cell_live(arm_live(5.0), arm_live(), tracker_age_s=None), {}))
    assert words.startswith("NO DATA from arm left, tracker")


HALF = Progress("collect", 215, 400, "stop 216", 600.0)
LOST = Progress("collect", 215, 400, detail=StateChange("stopped", "arm right: link lost."))


def record(*events: Progress) -> JobRecord:
    made = JobRecord()
    made.begin("collect")
    for event in events:
        made.add(event)
    return made


def test_the_time_that_is_left_goes_down_between_two_reports() -> None:
    runs = record(HALF)
    heard_s = runs.heard_s["collect"]
    assert remaining_s(runs, "collect", heard_s) == pytest.approx(600.0)
    assert remaining_s(runs, "collect", heard_s + 120.0) == pytest.approx(480.0)
    waits = record(LOST, HALF)
    assert remaining_s(waits, "collect", waits.heard_s["collect"]) is None, "who waits for a person has no end"
    assert ending_words(-3.0, datetime(2026, 1, 2)) == "any moment"


def test_the_candidates_of_a_plan_are_no_part_of_the_day_that_goes_on() -> None:
    day = JobRecord()
    day.begin("run")
    day.add(Progress("candidates", 1, 2, "arm right"))
    assert parts_of(day) == [*WHOLE_DAY, "candidates"]
    day.add(HALF)
    assert parts_of(day) == list(WHOLE_DAY)


async def test_a_stop_is_told_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    rung: list[str] = []
    monkeypatch.setattr(CellApp, "bell", lambda app: rung.append(app.message))
    held = HeldJob((HALF, LOST))
    async with running() as (pilot, app):
        app.start_job(held.job())
        await until(pilot, lambda: any("link lost, 215 of 400" in one for one in rung), "the bell")
        held.go_on.set()
        await ended(pilot, app)


def drawn_texts(chart: Chart, width: int, height: int) -> list[str]:
    return ["".join(text for text, _ in line) for line in draw(chart, width, height)]


# -- on the screen ----------------------------------------------------------------------------------------------------


def test_colours_stand_out_from_their_backgrounds() -> None:
    """A contrast of 3 to 1, as WCAG 2.1 asks of graphics, on the darkest and lightest backgrounds of terminals."""

    def luminance(colour: Color) -> float:
        parts = np.array(colour.normalized)
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    for colours, backgrounds in ((ON_DARK, ("#000000", "#1e1e1e", "#282828")), (ON_LIGHT, ("#ffffff", "#e0e0e0"))):
        for background in backgrounds:
            ground = luminance(Color.parse(background))
            for colour in colours:
                low, high = sorted((ground, luminance(Color.parse(colour))))
                assert (high + 0.05) / (low + 0.05) >= 3.0, (colour, background)


# -- the drawing ------------------------------------------------------------------------------------------------------


NUMBERS = st.one_of(
    st.floats(-1e6, 1e6), st.floats(0.0, 1e-9), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300])
)


@settings(max_examples=150)
@given(
    x=arrays(np.float64, st.integers(0, 30), elements=NUMBERS, fill=st.nothing()),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["line", "points"]),
    size=st.tuples(st.integers(0, 90), st.integers(0, 30)),
    logarithmic=st.booleans(),
    equal=st.booleans(),
)
def test_whatever_the_numbers_nothing_leaves_the_room(x, seed, kind, size, logarithmic, equal) -> None:
    y = np.random.default_rng(seed).permutation(x)
    one = series("left", x, y, kind, band=np.abs(np.nan_to_num(y, posinf=1.0, neginf=1.0)))
    axis = Axis("error", "mm", logarithmic and not equal)
    chart = Chart("Title", axis, axis, (one, replace(one, style=1)), "Message.", (Limit("limit", 1.0),), equal=equal)
    width, height = size
    lines = drawn_texts(chart, width, height)
    assert len(lines) <= height
    assert all(cell_len(line) <= width for line in lines)


@pytest.fixture
def _as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(app, "gc", gc)  # other tests of screens have none
    before, often = list(gc.callbacks), gc.get_threshold()
    yield
    gc.callbacks[:] = before
    gc.set_threshold(*often)


@pytest.mark.usefixtures("_as_before")
@pytest.mark.parametrize(("slow_s", "sets_aside"), [(-1.0, True), (60.0, False)])
def test_what_survives_a_slow_full_pass_is_set_aside(
    monkeypatch: pytest.MonkeyPatch, slow_s: float, sets_aside: bool
) -> None:
    monkeypatch.setattr(app, "_SLOW_S", slow_s)
    before, often = gc.get_freeze_count(), gc.get_threshold()
    SlowCollections().watch()
    assert gc.get_threshold() > often, "a full pass is rarer: first visits of screens waited for one"
    gc.collect(1)
    assert gc.get_freeze_count() <= before
    gc.collect()
    assert (gc.get_freeze_count() > before) is sets_aside


@pytest.mark.usefixtures("_as_before")
def test_garbage_that_was_set_aside_is_collected_after_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "_SLOW_S", -1.0)
    passes = SlowCollections()
    passes.watch()
    cycle: list[object] = []
    cycle.append(cycle)
    gc.collect()
    del cycle
    before = gc.get_freeze_count()
    passes.look_again()
    assert gc.get_freeze_count() < before
