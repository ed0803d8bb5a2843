"""The commands and the example on the page about checking, as they stand there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import get_args

import pytest
import yaml
from typer.testing import CliRunner

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.docs.handbook import chapter_text
from cellapp.estimation.monitoring.check.records import CheckVerdict
from cellapp.ground.profile.schema import Plant
from tests.handbook.chapters import blocks
from tests.program import app
from tests.twin import PROFILES

PAGE = chapter_text("check")


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
def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    with RunFile.open(Path("logs/my-run")) as run:
        assert run.profile.plant is not None
        path = changed_profile(tmp_path / "profiles", run.profile.plant)
    ends = []
    for line in (line for line in "".join(blocks("check", "sh")).splitlines() if " check" in line):
        program, *arguments = shlex.split(line.replace("changed.yaml", str(path)))
        ended = CliRunner().invoke(app, [*arguments, "--json", "result.json", "--force"])
        found = json.loads(Path("result.json").read_text("utf-8"))
        ends.append((program, found["schema"], found["verdict"], ended.exit_code))
    valid = ("cellapp", "cellapp-check", "valid", 0)
    assert ends == [valid, valid, ("cellapp", "cellapp-check", "arm changed", 1)]


def test_every_verdict_is_explained() -> None:
    listed = re.findall(r"^\| ([a-z ]+) \| .* \| .*\|$", PAGE, re.M)
    assert set(listed) - {"verdict"} == set(get_args(CheckVerdict))
