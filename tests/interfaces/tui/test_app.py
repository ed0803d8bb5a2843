"""The application around its screens: jobs and their ends, keys, dialogs, quitting."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from textual.binding import Binding
from textual.dom import DOMNode
from textual.screen import ModalScreen

from cellapp.commands.docs.keys import KEYS, filled_keys
from cellapp.commands.stages import NextVerb, next_command
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.program import possible_commands
from cellapp.interfaces.tui.job_outcome import ERROR_LOG
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.keys import WAYS
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.controls import Entry, key_lines
from cellapp.interfaces.tui.workspace import load_workspace
from tests.cell.run.small_runs import collected_run, planned_run
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import (
    PROFILES,
    SMALL,
    WAIT_S,
    HeldJob,
    ended,
    exit_code,
    opened,
    running,
    shown_text,
    shows,
    tells,
    until,
)
from tests.sure import sure


async def test_an_unforeseen_error_is_one_sentence_and_its_text_is_kept() -> None:
    held = HeldJob(error=ZeroDivisionError("by the test"))
    async with running() as (pilot, app):
        app.start_job(held.job(folder=Path("here")))
        held.go_on.set()
        await ended(pilot, app)
        kept = Path("here") / ERROR_LOG
        assert str(kept) in app.message
        assert "ZeroDivisionError: by the test" in kept.read_text(encoding="utf-8")
        Path("file").write_text("not a folder")
        app.start_job(held.job(folder=Path("file")))
        held.go_on.set()
        await ended(pilot, app)
        assert "by the test" in app.message
        assert "could not be written" in app.message
        assert await exit_code(pilot, app) == 3


async def test_nothing_else_is_opened_while_a_job_moves_arms() -> None:
    held = HeldJob()
    async with running() as (pilot, app):
        app.start_job(held.job(folder=Path("here")))
        app.open_profile(PROFILES / "ur10-ur5.yaml")
        await tells(pilot, "moves arms")
        held.go_on.set()
        await ended(pilot, app)
        assert app.workspace.kind == "simulated"
        app.open_profile(PROFILES / "ur10-ur5.yaml")
        await until(pilot, lambda: " REAL ARMS " in shown_text(app).splitlines()[0], "the other profile")


async def test_a_job_that_does_not_stop_cannot_hold_the_program() -> None:
    held = HeldJob()
    app = CellApp(PROFILES, patience_s=0.05)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        app.start_job(held.job())
        await until(pilot, held.reached.is_set, "the job")
        await pilot.press("q", "y")
        await until(pilot, lambda: app.return_code is not None, "the end of the application")
    assert app.return_code == 3
    app.draw_all()  # what is read so late has no screen any more
    assert held.thread is not None
    assert held.thread.daemon
    held.go_on.set()
    held.thread.join(WAIT_S)
    assert not held.thread.is_alive()


def test_importing_is_cheap_and_opening_loads_no_numerics() -> None:
    script = (
        "import sys, cellapp.interfaces.tui\n"
        "assert not {'textual', 'torch', 'scipy'} & set(sys.modules)\n"
        "import cellapp.interfaces.cli.program, cellapp.interfaces.tui.app, cellapp.interfaces.tui.screens.cell\n"
        "later = {'torch', 'scipy', 'numpy', 'yaml', 'typer', 'rich.markdown', 'cellapp.ground.profile'}\n"
        "sys.exit(', '.join(later & set(sys.modules)) or None)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=PROFILES.parent, timeout=WAIT_S).returncode == 0


# -- One grammar of keys: a meaning has one key on every screen, footers break nowhere; Escape and n -------------------

RUN = Path("logs/day")
OF_TABLE = {key.keys for key in KEYS.values()}
OWN = {"escape", "ctrl+c", "ctrl+x", "ctrl+q", "ctrl+p", *(entry.key for entry in SCREENS)}
"""Stop and abort wherever one is, and the screens; what is left is in the table."""


def screens() -> list[type[DayScreen]]:
    return [type(entry.make()) for entry in SCREENS]  # type: ignore[misc]


def test_a_key_has_one_meaning_and_a_meaning_one_key() -> None:
    used = [name for key in KEYS.values() for name in key.keys.split(",")]
    assert len(used) == len(set(used))
    assert len({key.shown for key in KEYS.values()}) == len(KEYS)
    assert [filled_keys(f"{{key:{entry.step}}}") for entry in SCREENS] == [f"**{entry.key}**" for entry in SCREENS]


@pytest.mark.parametrize("of", [CellApp, *screens()])
def test_every_binding_is_from_the_table_and_bound_once(of: type[DOMNode]) -> None:
    bound = [one for one in of.BINDINGS if isinstance(one, Binding)]
    strange = [one.key for one in bound if one.key not in OF_TABLE | OWN]
    assert not strange, "declare its meaning in keys.py"
    keys = [one.key for one in bound if one.key not in ("ctrl+c",)]
    assert len(keys) == len(set(keys))


def test_every_way_to_a_verb_is_a_key_of_its_screen() -> None:
    by_step = {entry.step: type(entry.make()) for entry in SCREENS}
    for verb, (step, meaning) in WAYS.items():
        keys = [one.key for one in by_step[step].BINDINGS if isinstance(one, Binding)]
        assert KEYS[meaning].keys in keys, verb


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_footers_break_between_entries_only_and_keep_the_general_ones(width: int) -> None:
    own = [Entry(letter, "A few words", "") for letter in "abcdefghijklmnop"]
    general = [Entry(key, word, "", general=True) for key, word in (("n", "Next"), ("?", "Help"), ("q", "Quit"))]
    lines = key_lines([*own, *general], width)
    assert 1 <= len(lines) <= 2
    assert all(sum(entry.width for entry in line) <= width for line in lines)
    shown = [entry for line in lines for entry in line]
    assert shown[-3:] == general
    assert shown[:-3] == own[: len(shown) - 3], "the last ones are left out, help has them"


async def test_the_last_run_stands_on_the_first_screen_and_what_is_read_of_it_takes_no_key(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    collected_run(RUN, "stopped")
    read, words_of_run = threading.Event(), verb_jobs.words_of_run
    monkeypatch.setattr(verb_jobs, "words_of_run", lambda folder: words_of_run(folder) if read.wait(WAIT_S) else "")
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await shows(pilot, "a goes on with the last run, logs/day")
        await pilot.press("2")
        read.set()
        await shows(pilot, "a goes on with the last run, logs/day: 2 stops left")
        assert app.screen is app.day_screen
        assert app.day_screen.STEP == "plan"
        await pilot.press("a")
        await until(pilot, lambda: app.workspace.folder == RUN, "the run")


NEXT = (
    *(next_command(verb, RUN) for verb in get_args(NextVerb)),
    "cellapp collect logs/day --resume",
    "cellapp discover logs/day --propose 30",
    "cellapp push logs/day TARGETS --verify --iterate 2",
    "cellapp compensate logs/day PATHS",
    "Add cooperative targets (partner) to the list; then measure them: cellapp push logs/day TARGETS --verify",
    "Measure with a smaller uncertainty, as with the tracker nearer: position error of left.",
)
"""Every next step of a run, as ``show`` gives it."""


async def test_every_next_step_of_every_state_is_begun_by_n_or_says_what_to_do(
    finished_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Job] = []
    app = CellApp(PROFILES)
    monkeypatch.setattr(app, "start_job", lambda job, **_: begun.append(job))
    planned_run(Path("logs/planned")).close()
    collected_run(Path("logs/part"), "stopped")
    collected_run(Path("logs/complete"), "complete", 4)
    shutil.copytree(finished_run, RUN)
    states = [load_workspace(PROFILES / "twin.yaml", folder) for folder in (None, *sorted(Path("logs").iterdir()))]
    held = states[2]
    assert held.folder == RUN
    for words in NEXT:
        verb = "push" if words.startswith("Add") else words.split()[1] if words.startswith("cellapp") else ""
        verb = "" if "PATHS" in words else verb
        overview = sure(held.overview).model_copy(update={"next_verb": verb, "next_step": words})
        states.append(replace(held, overview=overview))
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        for workspace in states:
            begun.clear()
            app.workspace, app.message = workspace, ""
            app.draw_all()
            what = app.state.next_words
            for _ in range(2):  # to the screen of the step, and there
                if not (begun or app.message or isinstance(app.screen, ModalScreen)):
                    await pilot.press("n")
                    await settle(pilot)
            assert begun or app.message or isinstance(app.screen, ModalScreen), f"{what}:\n{shown_text(app)}"
            await pilot.press("f10")
            await until(pilot, lambda: app.screen is app.day_screen, "the end of the question")


async def test_the_palette_lists_each_command_once() -> None:
    async with running() as (pilot, app):
        for entry in SCREENS:
            await pilot.press(entry.key)
            await settle(pilot)
            assert entry.step == app.day_screen.STEP
            listed = [one.title for one in possible_commands(app, app.day_screen)]
            assert len(listed) == len(set(listed)), sorted(listed)
            twice = [verb for verb, (of, _) in WAYS.items() if of == entry.step and f"cellapp {verb}" in listed]
            assert not twice, "a key of the screen does it"
