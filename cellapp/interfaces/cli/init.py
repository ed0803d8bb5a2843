"""``init``: write a profile to start from."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption

_Angles = Literal["rad", "deg", ""]
_Lengths = Literal["m", "mm", ""]


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The profile goes into FOLDER/profiles.")] = Path(),
    twin: Annotated[
        bool, typer.Option("--twin", help="The simulated cell, to try the program without hardware.")
    ] = False,
    starter: Annotated[
        str | None, typer.Option("--from", metavar="NAME", help="A copy of a profile that comes with cellapp.")
    ] = None,
    answers: Annotated[
        Path | None,
        typer.Option("--answers", metavar="FILE", help="From answers; see 'cellapp docs cell'."),
    ] = None,
    readings: Annotated[
        Path | None,
        typer.Option(
            "--readings", metavar="FILE", help="For readings recorded elsewhere; see 'cellapp docs readings'."
        ),
    ] = None,
    arm: Annotated[
        str | None,
        typer.Option(
            "--arm", metavar="TYPE", help="With --readings: an arm type by name, its file, or D-H rows (CSV)."
        ),
    ] = None,
    modified: Annotated[
        bool, typer.Option("--modified", help="With --arm ROWS.csv: the rows are modified D-H (Craig).")
    ] = False,
    angles: Annotated[
        Literal["rad", "deg"] | None,
        typer.Option("--angles", help="With --readings: unit of joint positions, if it is not found."),
    ] = None,
    lengths: Annotated[
        Literal["m", "mm"] | None,
        typer.Option("--lengths", help="With --readings: unit of points, if it is not found."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="With --readings: name of the profile.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Write a new profile as commented YAML; nothing is overwritten."""
    from cellapp.commands.doctor.result import InitResult

    with Job(json_file) as job:
        own = (arm, angles, lengths, name)
        if readings is None and (modified or any(one is not None for one in own)):
            raise InputError("init: --arm, --modified, --angles, --lengths and --name belong to --readings; add it")
        if twin + (starter is not None) + (answers is not None) + (readings is not None) != 1:
            raise InputError(_choices())
        if readings is not None:
            _own_data(job, readings, folder, arm or "", modified, angles or "", lengths or "", name or "")
            return
        path, notes = _written(folder, starter, answers)
        job.say(*notes, f"written: {path}", f"next: {_next_command(path)}")
        job.result(InitResult(profile=str(path), notes=notes))


def _choices() -> str:
    from cellapp.cell.profile.starters import starter_profiles

    listed = "\n".join(f"  {item.name:14} {item.sentence}" for item in starter_profiles())
    return (
        "init: give one of --twin, --from NAME, --answers FILE and --readings FILE. Profiles that come with cellapp:\n"
        + listed
    )


def _written(folder: Path, starter: str | None, answers: Path | None) -> tuple[Path, tuple[str, ...]]:
    from cellapp.cell.profile.starters import TWIN, write_starter
    from cellapp.commands.init.answers import write_answers

    if answers is not None:
        written = write_answers(answers, folder)
        return written.path, written.notes
    return write_starter(TWIN if starter is None else starter, folder), ()


def _next_command(path: Path) -> str:
    """A cell of which nothing moves has readings to import, and no devices to look at."""
    from cellapp.cell.profile import load_profile
    from cellapp.cell.profile.starters import readings_of

    if any(arm.driver.has_device for arm in load_profile(path).arms.values()):
        return f"cellapp doctor {path}"
    readings = readings_of(path.stem, path.parent)
    return (
        f"cellapp import {path} {readings if readings.is_file() else 'READINGS.csv'} --run {Path('logs') / path.stem}"
    )


def _own_data(
    job: Job, readings: Path, folder: Path, arm: str, modified: bool, angles: _Angles, lengths: _Lengths, name: str
) -> None:
    from cellapp.commands.doctor.result import InitResult
    from cellapp.commands.init.own_data import OwnData, write_own_data

    given = OwnData(readings, arm, modified, angles, lengths, name)
    written = write_own_data(given, folder, _ask, job.outputs)
    job.say(*written.notes, f"written: {written.profile}, {written.readings}", f"next: {written.next_command}")
    job.result(InitResult(profile=str(written.profile), notes=written.notes, readings=str(written.readings)))


def _ask(question: str, answers: tuple[str, ...]) -> str:
    """Ask a person; empty where nobody sits at a terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return ""
    said: str = typer.prompt(f"{question}\n{', '.join(answers)}", err=True, default=answers[0])
    return said.strip() if said.strip() in answers else ""
