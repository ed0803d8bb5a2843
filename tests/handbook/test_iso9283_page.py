"""The commands in the chapter on ISO 9283 are understood as they stand there."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path
from typing import NoReturn

import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.iso9283.tests import IsoTask
from cellapp.commands.iso9283 import run as verb
from cellapp.estimation.iso9283.norm import ISO_TESTS
from cellapp.ground.errors import HardwareError
from tests.handbook.chapters import blocks
from tests.program import app
from tests.twin import PROFILES

COMMANDS = "".join(blocks("iso9283", "sh")).splitlines()


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
    for command in COMMANDS:
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
