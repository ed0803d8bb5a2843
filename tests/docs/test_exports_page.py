"""The commands on the page about exports, as they stand there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cli.app import app
from cellapp.docs.handbook import chapter_text
from cellapp.exports.formats import all_formats

COMMANDS = [
    line
    for block in re.findall(r"^```sh\n(.*?)^```", chapter_text("exports"), re.M | re.S)
    for line in block.splitlines()
]


def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    assert len(COMMANDS) >= 4
    for command in COMMANDS:
        program, *arguments = shlex.split(command)
        ended = CliRunner().invoke(app, [*arguments, "--json", "result.json"])
        assert (program, ended.exit_code) == ("cellapp", 0), f"{command}: {ended.exception}"
        result = json.loads(Path("result.json").read_text("utf-8"))
        files = [*result.get("arms", {}).values(), *result.get("commands", {}).values()]
        assert all(Path(one["file"]).is_file() for one in files)
    written = {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert written >= {"cell-left.urdf", "cell-right.urdf", "calibration-left.conf", "readings.csv", "rigid-left.urdf"}
    assert written >= {"commands.csv", "left.script"}


@pytest.mark.fast
def test_the_page_describes_every_format() -> None:
    described = re.findall(r"^\| `([a-z-]+)` \|", chapter_text("exports"), re.M)
    assert described == list(all_formats())
