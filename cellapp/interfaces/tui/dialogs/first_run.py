"""The first start in a folder without profiles: try the simulated twin, write a profile, or open one elsewhere."""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

from textual.app import SuspendNotSupported

from cellapp.cell.profile.starters import copy_starter
from cellapp.commands.record import Request
from cellapp.ground.errors import InputError
from cellapp.ground.starters import TWIN
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import Choice, ChosenAnswer
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.host import Host

NEW_PROFILE = "my-cell.yaml"
"""File of a new profile."""
_PATTERN = "ur10-ur5"
"""The profile that explains every key, which a new one begins with."""


class Welcome(Choice):
    """Choice of how to begin, with the long answers below one another."""


def offer_first_run(app: Host) -> None:
    """Ask how to begin where there are no profiles."""
    text = (
        f"There are no profiles in the folder {app.profiles}. A profile describes a cell: its arms, its tracker, where"
        " they stand. The simulated twin needs no hardware: from it, F5 leads to a finished report in a few minutes."
    )
    answers = (
        ChosenAnswer("twin", "Try the simulated twin", "t", "success"),
        ChosenAnswer("write", "Write a profile for my cell", "w"),
        ChosenAnswer("readings", "Calibrate readings of my own", "r"),
        ChosenAnswer("open", "Open a profile elsewhere", "o"),
    )
    app.push_screen(Welcome("Welcome to cellapp", text, answers), lambda answer: begin_with(app, answer))


def begin_with(app: Host, answer: str | None) -> None:
    """Do what was chosen; None: nothing."""
    if answer == "twin":
        try:
            path = copy_starter(TWIN, app.profiles)
        except InputError as error:
            app.say(str(error), "error")
            return
        app.open_profile(path)
        app.say(f"The simulated twin is in {path}. F5 runs the whole day; n goes to the next step alone.")
    elif answer == "write":
        write_profile(app)
    elif answer == "readings":
        take_own_readings(app)
    elif answer == "open":
        picker = FilePicker("Which profile?", app.profiles.parent, [".yaml"])
        app.push_screen(picker, lambda path: None if path is None else app.open_profile(path))


def write_profile(app: Host) -> None:
    """Write a new profile in which every key is explained, and let a person edit it."""
    path = app.profiles / NEW_PROFILE
    try:
        if not path.exists():
            copy_starter(_PATTERN, app.profiles, NEW_PROFILE)
    except InputError as error:
        app.say(str(error), "error")
        return
    edit_profile(app, path)


def take_own_readings(app: Host) -> None:
    """Ask for external readings; create their profile and run, and open the run."""
    from cellapp.commands.init.request import VERB as INIT
    from cellapp.commands.init.request import InitRequest
    from cellapp.interfaces.tui import verb_jobs

    def begin(request: Request | None) -> None:
        if isinstance(request, InitRequest):
            app.start_job(verb_jobs.own_readings(request))

    text = (
        "A text file with a row of names, joint positions and points. Separators, decimal commas and units are found"
        " out. A profile and a run, named after the file, are written; nothing moves."
    )
    answers = (ChosenAnswer("begin", "Begin", "b", "success"), ChosenAnswer("no", "Not now", "n"))
    app.push_screen(VerbQuestion(INIT, text, answers, {"folder": app.profiles.parent}), begin)


def edit_profile(app: Host, path: Path) -> None:
    """Let a person edit a profile, then read and check it again."""

    def read() -> None:
        app.open_run(app.workspace.folder if path == app.workspace.profile_path else None, path)

    edit_file(app, path, read, "Enter on its name checks it again")


def edit_file(app: Host, path: Path, read: Callable[[], None], again: str) -> None:
    """Let a person edit a file in ``$EDITOR``, then ``read`` it; say where it is if that cannot be, and what ``again``
    reads it."""
    if app.jobs.running:
        app.say(f"A job runs: edit {path.name} when it has ended, STOP must stay at hand.", "warning")
        return
    editor = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    why = "" if editor else "EDITOR names no editor"
    try:
        if editor:
            with app.lend_terminal():
                subprocess.run([*shlex.split(editor, posix=os.name == "posix"), str(path)], check=False)
    except SuspendNotSupported:
        why = "this terminal cannot be lent to an editor"
    except (OSError, ValueError) as error:
        why = f"'{editor}' cannot be started ({error})"
    read()
    if why:
        app.say(f"Edit {path.resolve()} in another window ({why}); {again}.", "warning")
