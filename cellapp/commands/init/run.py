"""The verb ``init``: write a profile as a starting point."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import readings_of, write_starter
from cellapp.commands.init.answers import write_answers
from cellapp.commands.init.own_data import OwnData, write_own_data
from cellapp.commands.init.request import InitRequest
from cellapp.commands.record import Request, View, Work
from cellapp.ground.results import Result
from cellapp.ground.shell import shell_word
from cellapp.ground.starters import TWIN


class InitResult(Result, schema="cellapp-init"):
    """``init``: the profile that was written, and what is to be known about it; ``readings`` are the converted ones,
    ``joints`` the file of joint positions of a motion, ``points`` that of its points, where it is known, ``smr`` the
    one of two SMRs that is taken."""

    profile: str
    notes: tuple[str, ...] = ()
    readings: str | None = None
    joints: str | None = None
    points: str | None = None
    smr: str | None = None
    omitted_when_none = frozenset({"readings", "joints", "points", "smr"})


def run(request: InitRequest, work: Work) -> InitResult:
    """Write the profile; ask for missing data of recorded readings."""
    if request.readings is not None:
        given = OwnData(
            request.readings,
            request.arm or "",
            request.modified,
            request.angles or "",
            request.lengths or "",
            request.name or "",
            request.column,
            request.rows or "",
        )
        own = write_own_data(given, request.folder, work.choose, work.outputs)
        if own.readings is None:
            joints, points = str(request.readings), None if own.points is None else str(own.points)
            return InitResult(profile=str(own.profile), notes=own.notes, joints=joints, points=points)
        return InitResult(profile=str(own.profile), notes=own.notes, readings=str(own.readings), smr=own.smr)
    if request.answers is not None:
        written = write_answers(request.answers, request.folder)
        return InitResult(profile=str(written.path), notes=written.notes)
    starter = TWIN if request.starter is None else request.starter
    return InitResult(profile=str(write_starter(starter, request.folder)))


def view(result: InitResult, request: Request | None = None) -> View:
    """Show notes, the written files, and the next command."""
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
    return " ".join(["cellapp import", *map(shell_word, [profile, *known, "--run", run])])
