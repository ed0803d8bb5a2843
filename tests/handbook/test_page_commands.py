"""Commands and files of single chapters, as they stand there, do what the chapter says; ``test_commands`` runs all."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import NoReturn, get_args

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import cellapp
from cellapp.cell.driving.iso9283.tests import IsoTask
from cellapp.cell.exports.formats import all_formats
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.compensate.words import PART_WORDS, advice
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.iso9283 import run as verb
from cellapp.estimation.iso9283.norm import ISO_TESTS
from cellapp.estimation.monitoring.records import CheckVerdict
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile.schema import Plant
from cellapp.interfaces.tui.screens import SCREENS
from tests.handbook.chapters import blocks
from tests.handbook.screen_pictures import write_screens
from tests.program import app
from tests.sure import sure
from tests.twin import PROFILES

# -- What the chapter about Python says that mistakes are answered with. ``test_commands`` runs its examples -----------


def test_mistakes_are_answered_as_the_chapter_says(finished_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example, printed) = re.findall(r"^```(?:python|text)\n(.*?)^```", chapter_text("python"), re.M | re.S)[-2:]
    run = cellapp.open_run(finished_run)
    names = {"cellapp": cellapp, "cell": cellapp.Cell(run.profile), "run": run, "left": run.readings("left"), "np": np}
    exec(compile(example, "python.md", "exec"), names)
    numbers = re.compile(r"-?\d+\.\d+")  # of another run
    assert numbers.sub("*", capsys.readouterr().out) == numbers.sub("*", printed)


# -- Pictures of the terminal application's screens: all are drawn from a finished run -----------------

TWIN = PROFILES / "twin.yaml"


@pytest.mark.slow
def test_every_screen_is_drawn(finished_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "new"
    write_screens(TWIN, finished_run, out)
    paths = [out / f"screen-{step}.svg" for step in ("first-run", *(entry.step for entry in SCREENS))]
    texts = {path.stem: path.read_text("utf-8").replace("&#160;", " ") for path in paths}
    assert not any("@font-face" in text or len(text) > 150_000 for text in texts.values())
    assert "Try the simulated twin" in texts["screen-first-run"]
    assert "COMPLETE, " in texts["screen-collect"]
    assert "held-out errors [mm]" in texts["screen-calibrate"]


# -- The lists and the words on the page about targets -----------------------------------------------------------------

PAGE = chapter_text("targets")


def test_the_page_has_every_part_of_an_uncertainty_and_the_advice_that_is_printed() -> None:
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE, re.M))
    assert set(PART_WORDS.values()) <= set(rows)
    for reason in ("out of reach", "singular: joints work against each other there"):
        assert rows[reason] == advice(reason)
    (limits,) = [reason for reason in rows if reason.startswith("beyond limits")]
    assert rows[limits] == advice(limits)


# -- The page about exports describes every format ---------------------------------------------------------------------


def test_the_page_describes_every_format() -> None:
    first_cells = re.findall(r"^\| (`[^|]+) \|", chapter_text("exports"), re.M)
    assert sorted(re.findall(r"`([a-z-]+)`", " ".join(first_cells))) == sorted(all_formats())


# -- The commands in the chapter on ISO 9283 are understood as they stand there ----------------------------------------

COMMANDS_OF_ISO9283_PAGE = "".join(blocks("iso9283", "sh")).splitlines()


@pytest.mark.slow
def test_the_commands_ask_for_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks: list[IsoTask] = []

    def drive(task: IsoTask, *_: object, **__: object) -> NoReturn:
        tasks.append(task)
        raise HardwareError("this cell stays where it is")

    monkeypatch.setattr(verb, "drive_tests", drive)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(PROFILES, "profiles")
    shutil.copytree(finished_run, "logs/my-run")
    for command in COMMANDS_OF_ISO9283_PAGE:
        ended = CliRunner().invoke(app, shlex.split(command)[1:])
        assert "stays where it is" in str(ended.exception), command
    asked = [(task.tests, task.cycles, task.arms, task.commands) for task in tasks]
    both = ("left", "right")
    assert asked == [
        (ISO_TESTS, 30, both, ("nominal", "calibrated")),
        (("pose",), 5, ("right",), ("calibrated",)),
        (("drift",), 30, both, ("nominal",)),
        (ISO_TESTS, 30, both, ("nominal", "calibrated")),
    ]
    assert tasks[2].drift_s == 480.0 * 60.0
    assert tasks[2].model is None
    assert tasks[3].also_speeds == (0.5, 0.1)


def changed_profile(folder: Path, plant: Plant) -> Path:
    """The twin's profile with the physics of a run and the lines of the page."""
    shutil.copytree(PROFILES, folder)
    content = yaml.safe_load((folder / "twin.yaml").read_text("utf-8"))
    content["plant"]["effects"] = {name: dict(own) for name, own in plant.effects.items()}
    content["plant"]["effects"]["left"].update(yaml.safe_load(blocks("check", "yaml")[0]))
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert load_profile(path).plant is not None
    return path


@pytest.mark.slow
def test_the_commands_of_the_check_find_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    with RunFile.open(Path("logs/my-run")) as run:
        path = changed_profile(tmp_path / "profiles", sure(run.profile.plant))
    ends = []
    for line in (line for line in "".join(blocks("check", "sh")).splitlines() if " check" in line):
        program, *arguments = shlex.split(line.replace("changed.yaml", str(path)))
        ended = CliRunner().invoke(app, [*arguments, "--json", "result.json", "--force"])
        found = json.loads(Path("result.json").read_text("utf-8"))
        ends.append((program, found["schema"], found["verdict"], ended.exit_code))
    valid = ("cellapp", "cellapp-check", "valid", 0)
    assert ends == [valid, valid, ("cellapp", "cellapp-check", "arm changed", 1)]


def test_every_verdict_is_explained() -> None:
    listed = re.findall(r"^\| ([a-z ]+) \| .* \| .*\|$", chapter_text("check"), re.M)
    assert set(listed) - {"verdict"} == set(get_args(CheckVerdict))
