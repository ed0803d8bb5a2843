"""Every sentence about the state of a run comes from one state: all states, through all screens and all their tabs."""

from __future__ import annotations

import asyncio
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from textual.pilot import Pilot
from textual.widgets import TabbedContent, TabPane

from cellapp.cell.run import RunFile
from cellapp.commands.conclusions import stage_conclusions
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.report.result import read_results
from cellapp.commands.stages import append_stage, read_stages
from cellapp.ground.progress import JobState
from cellapp.ground.results import CALIBRATE
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.job_record import MOST_LINES, JobRecord
from cellapp.interfaces.tui.keys import with_keys
from cellapp.interfaces.tui.run_state import SIGNS, marks_of
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.collect import CollectScreen
from cellapp.interfaces.tui.widgets.tables import TablesView
from cellapp.interfaces.tui.workspace import Workspace, load_workspace
from tests.cell.run.small_runs import planned_run
from tests.handbook.declarations import with_declarations
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import PROFILES, WAIT_S, HeldJob, ended, opened, shown_text, until
from tests.interfaces.tui.states import (
    RUN,
    STATES,
    broken,
    complete,
    events,
    nothing,
    part,
    sentences,
    state_and_record,
    states_table,
)

SIZE = (120, 40)
NO_RUN = ("No run is open", "NO RUN", "no run is open")
NOTHING = ("Nothing was collected yet", "No readings yet", "ollect first", "Collect and calibrate first", "READY, ")
UNCALIBRATED = ("Not calibrated yet",)
RUNS = ("RUNNING", "PAUSED", "STOPPED", " Escape STOP", " esc STOP", " x Abort", "'collect' runs", "is PAUSED")
COMPLETE = ("COMPLETE", "INTERRUPTED")
COMMAND = re.compile(r"'cellapp |\bcellapp (?:plan|collect|calibrate|discover|push|report|check|iso9283|locate)\b")


@dataclass(frozen=True)
class Case:
    """A state: how it is made, what every screen together must say, and what none may."""

    make: Callable[[], object]
    says: tuple[str, ...]
    never: tuple[str, ...]
    job: JobState | None = None
    watched: bool = False


def calibrated_out_of_date() -> None:
    with RunFile.open(RUN, write=True) as run:
        stored = read_stages(run).current[CALIBRATE]
        result = read_results(run).calibrate
        assert result is not None
        assert stored.basis is not None
        append_stage(run, CALIBRATE, result, stored.basis.model_copy(update={"profile": "another"}), stored.model)


BEGINS = ("b measures", "b begins", "b collect", "b calibrate", "b searches", "k measures", "m measures")
OPEN = (*NO_RUN, *NOTHING)
CASES = {
    "empty": Case(nothing, ("no run is open", "No run is open: plan one"), (*RUNS, *COMPLETE)),
    "planned": Case(lambda: planned_run(RUN).close(), ("READY, 4 stops",), (*NO_RUN, *RUNS, *COMPLETE)),
    "collecting": Case(part, ("RUNNING", "3 of 4 stops are measured"), (*OPEN, *COMPLETE, "PAUSED"), "running"),
    "paused": Case(part, ("PAUSED", "'collect' is PAUSED; 3 of 4 stops are measured"), (*OPEN, *COMPLETE), "paused"),
    "stopped": Case(part, ("STOPPED", "link lost"), (*OPEN, *COMPLETE, "PAUSED"), "stopped"),
    "part": Case(part, ("INTERRUPTED, 2 of 4", "3 Collect◐"), (*OPEN, *RUNS, "COMPLETE")),
    "complete": Case(complete, ("COMPLETE, 4 stops",), (*OPEN, *RUNS, "INTERRUPTED")),
    "calibrated": Case(nothing, ("COMPLETE, ", "6 Targets"), (*OPEN, *RUNS, *UNCALIBRATED)),
    "out of date": Case(calibrated_out_of_date, ("OUT OF DATE", "4 Calibrate!"), (*OPEN, *RUNS, *UNCALIBRATED)),
    "broken": Case(broken, ("not a run file",), (*RUNS, *NOTHING, *COMPLETE)),
    "read-only": Case(part, ("READ-ONLY", "This folder cannot be written"), (*OPEN, *RUNS, " b Begin", *BEGINS)),
    "watched": Case(part, ("WATCHED", "3 of 4 stops are measured"), (*OPEN, *COMPLETE), "running", watched=True),
}
FINISHED = ("calibrated", "out of date")
ALWAYS = ("empty", "collecting", "calibrated")
"""Cases whose screens every run of the tests shows; the table of states is compared with all of them."""


async def texts_of(pilot: Pilot[None], app: CellApp) -> dict[str, str]:
    """Screen and tab -> the words that are shown, once the screen says what the table of states says."""
    texts: dict[str, str] = {}
    for entry in SCREENS:
        await pilot.press(entry.key)
        await settle(pilot)
        for sentence in due(app, entry.step):
            await until(pilot, lambda sentence=sentence: sentence in words(app), f"{entry.step}: {sentence}")  # type: ignore[misc]
        texts[entry.step] = words(app)
        for tab in app.screen.query(TabPane).results():
            app.screen.query_one(TabbedContent).active = tab.id or ""
            await pilot.pause()
            texts[f"{entry.step}, {tab.id}"] = words(app)
        if isinstance(app.screen, CollectScreen):
            for _ in range(4):
                await pilot.press("t")
                await pilot.pause()
                texts[entry.step] += words(app)
    return texts


def due(app: CellApp, step: str) -> list[str]:
    """What the table of states says on a screen in the present state."""
    said = sentences(app.state, app.record)
    word, _, sentence = said["Collect"].partition(": ")
    empty = [said["Calibrate"]] if app.state.nothing("calibrate", "") else []
    places = {"cell": [said["first line"]], "collect": [word, sentence]}
    places |= dict.fromkeys(("calibrate", "discover", "accept"), empty)
    return [" ".join(text.split()) for text in places.get(step, [])]


def words(app: CellApp) -> str:
    return " ".join(shown_text(app).split())


@pytest.mark.parametrize(
    "name", [name if name in ALWAYS else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
async def test_no_sentence_contradicts_the_state(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = CASES[name]
    monkeypatch.setattr(work, "interrupted_run", lambda logs: None)
    if name in FINISHED:
        shutil.copytree(request.getfixturevalue("finished_run"), RUN)
    if name == "read-only":
        monkeypatch.setattr("cellapp.interfaces.tui.workspace.os.access", lambda path, mode: False)
    case.make()
    app = CellApp(PROFILES)
    held = HeldJob(() if case.job is None else events(case.job), patience_s=10 * WAIT_S)
    async with app.run_test(size=SIZE) as pilot:
        await opened(pilot, app)
        if RUN.exists():
            app.open_run(RUN)
            await until(pilot, lambda: app.workspace.folder == RUN or app.workspace.problem != "", "the run")
        if case.job is not None:
            job = replace(held.job(folder=RUN), process=99 if case.watched else None)
            app.record.begin(job.name, watched=case.watched)
            app.jobs.start(job)
            await until(pilot, lambda: app.record.state == case.job and bool(app.record.progress), "the job")
        texts = await texts_of(pilot, app)
        wrong = [f"{place}: {phrase}" for place, text in texts.items() for phrase in case.never if phrase in text]
        wrong += [f"{place}: {found[0]}" for place, text in texts.items() if (found := COMMAND.search(text))]
        assert not wrong, "\n".join(
            [*wrong, *{place.partition(":")[0]: texts[place.partition(":")[0]] for place in wrong}.values()]
        )
        missing = [phrase for phrase in case.says if not any(phrase in text for text in texts.values())]
        assert not missing
        if case.job is not None:
            held.go_on.set()
            await ended(pilot, app)
            await pilot.pause()
            await until(pilot, lambda: not [word for word in RUNS if word in words(app)], "a screen without the job")


@pytest.mark.parametrize("name", STATES)
def test_the_table_of_states_says_what_the_cases_ask_and_nothing_that_contradicts(name: str, tmp_path: Path) -> None:
    said = " ".join(sentences(*state_and_record(name)).values())
    wrong = [phrase for phrase in CASES[name].never if phrase in said and phrase not in OPEN * (name in FINISHED)]
    assert not wrong, said
    assert not COMMAND.search(said)


def test_the_table_has_every_state_and_stands_in_the_handbook() -> None:
    assert list(STATES) == list(CASES)
    table = states_table()
    assert [row[0] for row in table[1:]] == list(CASES)
    text = chapter_text("terminal")
    assert with_declarations(text) == text, "renew it: python -m tests.handbook"


async def test_a_screen_that_is_drawn_while_it_is_being_made_says_the_state() -> None:
    planned_run(RUN).close()
    app = CellApp(PROFILES)
    async with app.run_test(size=SIZE) as pilot:
        await opened(pilot, app)
        app.open_run(RUN)
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")
        for step, sentence in (("plan", "arm left: 4 stops"), ("collect", "READY, 4 stops"), ("calibrate", "Not cal")):
            app.action_show(step)  # type: ignore[arg-type]
            async with asyncio.timeout(WAIT_S):
                while not app.day_screen.is_mounted:
                    app.record.changes += 1  # events of a job come at any moment
                    app._draw_events()
                    app.draw_all()
                    await asyncio.sleep(0.0)
            await until(pilot, lambda: sentence in words(app), f"{step}: {sentence}")  # noqa: B023


async def test_a_screen_that_is_made_while_the_time_of_a_job_goes_down_says_the_state() -> None:
    planned_run(RUN).close()
    app, held = CellApp(PROFILES), HeldJob(events("running"), patience_s=10 * WAIT_S)
    async with app.run_test(size=SIZE) as pilot:
        await opened(pilot, app)
        app.open_run(RUN)
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")
        app.start_job(held.job(folder=RUN))
        await until(pilot, lambda: app.state.collecting and app.state.measured == 3, "the job")
        for step in ("calibrate", "discover", "accept"):
            app.action_show(step)
            async with asyncio.timeout(WAIT_S):
                while not app.day_screen.is_mounted:
                    app._tick()
                    await asyncio.sleep(0.0)
            await settle(pilot)
            said = [str(one.render()) for view in app.day_screen.query(TablesView) for one in view.children]
            assert any("Not calibrated yet: 'collect' runs" in text for text in said), step
        held.go_on.set()
        await ended(pilot, app)


async def test_until_what_a_job_stored_is_read_no_sentence_says_what_was_true_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planned_run(RUN).close()
    app, held, may_read = CellApp(PROFILES), HeldJob(), threading.Event()

    def late(profile: Path | None, folder: Path | None) -> Workspace:
        assert may_read.wait(WAIT_S)
        return load_workspace(profile, folder)

    async with app.run_test(size=SIZE) as pilot:
        await opened(pilot, app)
        app.open_run(RUN)
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")
        monkeypatch.setattr("cellapp.interfaces.tui.app.load_workspace", late)
        app.start_job(held.job(folder=RUN))
        held.go_on.set()
        await ended(pilot, app)
        for step, before in (("collect", "READY"), ("calibrate", "Not calibrated yet"), ("discover", "Not calibrated")):
            app.action_show(step)  # type: ignore[arg-type]
            await until(pilot, lambda: "What 'collect' has stored is being read." in words(app), step)
            assert before not in words(app)
        may_read.set()
        await until(pilot, lambda: "Not calibrated yet" in words(app), "the run")
        assert not app.state.reading


# -- the marks ---------------------------------------------------------------------------------------------------------


def test_a_tick_is_no_verdict(finished_run: Path) -> None:
    held = load_workspace(None, finished_run)
    assert held.results is not None
    verify = held.results.verify
    assert verify is not None
    stopped = verify.model_copy(update={"stopped": "stopped after 3 of 40 targets: link lost"})
    signs = {}
    for kind, result in (("done", verify), ("part", stopped)):
        results = held.results.model_copy(update={"verify": result})
        mark = marks_of(replace(held, results=results, conclusions=stage_conclusions(results)), 1, 1, 0, None)[
            "targets"
        ]
        signs[kind] = SIGNS[mark.kind]
        if kind == "part":
            assert mark.words == "stopped after 3 of 40 targets"
    assert signs["part"] == "◐"
    assert signs["done"] in "✓≤?✗"
    assert len(set(SIGNS.values())) == len(SIGNS), "each conclusion has its own mark"


@pytest.mark.parametrize(
    ("conformity", "sign"), [("conforms", "≤"), ("cannot say", "?"), ("does not conform", "✗"), (None, "✓")]
)
def test_the_mark_of_accept_is_the_verdict(conformity: str | None, sign: str, finished_run: Path) -> None:
    held = replace(load_workspace(None, finished_run), reported=True, conformity=conformity)  # type: ignore[arg-type]
    assert SIGNS[marks_of(held, 1, 1, 0, None)["accept"].kind] == sign


def test_what_runs_is_marked_and_what_is_next_keeps_its_own_mark() -> None:
    marks = marks_of(Workspace(), 0, 0, 0, "plan")
    assert marks["plan"].kind == "running"
    assert marks["cell"].is_next
    assert marks["cell"].kind == "next"


def test_sentences_name_keys_and_no_commands() -> None:
    assert with_keys("report.html is old; run 'cellapp report logs/a'") == "report.html is old; keys 7, b"
    assert with_keys("Measure them: cellapp push DIR TARGETS --verify") == "Measure them: keys 6, m"
    assert with_keys("run 'cellapp iso9283 PROFILE --run DIR', then go on") == "keys 7, m, then go on"
    assert with_keys("More: 'cellapp docs joint_compliance'") == "More: key F1"
    assert with_keys("no runs below logs; 'cellapp run PROFILE' makes one") == "no runs below logs; key F5 makes one"
    assert with_keys("cellapp is a program") == "cellapp is a program"


# -- The record of a job: what events leave behind, without any screen -------------------------------------------------

Q0, Q1 = (0.0, 0.1), (1.0, 1.1)


@given(steps=st.lists(st.integers(0, 40), max_size=20))
def test_newest_lines_are_each_heard_once(steps: list[int]) -> None:
    record, heard, written = JobRecord(), [], 0
    for count in steps:
        for _ in range(count):
            record.note(f"line {record.log_written}")
        heard += record.newest_lines(written)
        written = record.log_written
    assert [row.text for row in heard] == [f"line {number}" for number in range(sum(steps))]


def test_lines_that_are_kept_no_more_are_not_heard() -> None:
    record = JobRecord()
    for number in range(MOST_LINES + 10):
        record.note(f"line {number}")
    newest = record.newest_lines(0)
    assert len(newest) == MOST_LINES
    assert newest[0].text == "line 10"
