"""The verb ``init``: write a profile as a starting point, or run the whole demonstration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import FOLDER, TWIN_SMALL, readings_of, write_starter
from cellapp.commands.init.answers import write_answers
from cellapp.commands.init.own_data import InitResult, write_own_data
from cellapp.commands.init.request import InitRequest
from cellapp.commands.record import Request, View, Work
from cellapp.commands.run.request import VERB as RUN
from cellapp.commands.run.request import RunRequest
from cellapp.commands.run_results import WholeRunResult
from cellapp.ground.shell import shell_word
from cellapp.ground.starters import TWIN

_SWEEPS = 20
"""Stops of the demonstration in motion, each with a sweep of every arm."""


def run(request: InitRequest, work: Work) -> InitResult | WholeRunResult:
    """Write the profile; ask for missing data of recorded readings. For the demonstration, run everything."""
    if request.demo:
        return _demo(request, work)
    if request.readings is not None:
        return write_own_data(request, work.choose, work.outputs)
    if request.answers is not None:
        return write_answers(request.answers, request.folder)
    starter = TWIN if request.starter is None else request.starter
    return InitResult(profile=str(write_starter(starter, request.folder)))


def _demo(request: InitRequest, work: Work) -> WholeRunResult:
    """Write the profile if there is none, and run everything."""
    from cellapp.commands.plan.run import default_folder  # late: planning takes long to load
    from cellapp.commands.run.run import run as run_all

    name = TWIN if request.full else TWIN_SMALL
    profile = request.folder / FOLDER / f"{name}.yaml"
    if profile.is_file():
        work.say(f"{profile} exists already and is used as it is")
    else:
        write_starter(name, request.folder)
        work.say(f"written: {profile}")
    sweeps = _SWEEPS if request.sweeps else None
    return run_all(RunRequest(profile=profile, folder=request.folder / default_folder(name), sweeps=sweeps), work)


def view(result: InitResult | WholeRunResult, request: Request | None = None) -> View:
    """Show notes, the written files, and the next command; of the demonstration what ``run`` shows."""
    if isinstance(result, WholeRunResult):
        return RUN.view(result)
    files = [result.profile, *([] if result.readings is None else [result.readings])]
    return View((*result.notes, f"written: {', '.join(files)}", f"next: {_next_command(result)}"))


def _next_command(result: InitResult) -> str:
    """Return the next command: ``import`` for a cell that only has readings, ``doctor`` for one with devices."""
    path = Path(result.profile)
    logs = Path("logs") / path.stem
    if result.joints is not None or result.readings is not None:
        given: list[str | None] = [result.readings, *([] if result.smr is None else ["--smr", result.smr])]
        if result.joints is not None:
            given = ["--joints", result.joints, "--points", result.points]
        return _import(path, given, path.parent.parent / logs)
    if any(arm.driver.has_device for arm in load_profile(path).arms.values()):
        return f"cellapp doctor {shell_word(path)}"
    readings = readings_of(path.stem, path.parent)
    return _import(path, [str(readings) if readings.is_file() else None], logs)


def _import(profile: Path, given: Sequence[str | None], run: Path) -> str:
    """Return the command that imports the ``given`` files; the chapter about it where one is not known."""
    known = [one for one in given if one is not None]
    if len(known) < len(given):
        return "cellapp docs readings"
    return " ".join(["cellapp import", *(shell_word(str(word)) for word in (profile, *known, "--run", run))])
