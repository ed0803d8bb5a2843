"""The commands on the page about programs, as they stand there."""

from __future__ import annotations

import gzip
import json
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from tests.handbook.chapters import blocks
from tests.program import app

COMMANDS = "".join(blocks("programs", "sh")).splitlines()


@pytest.mark.slow
def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    with RunFile.open(finished_run) as run:
        q = run.readings("left").q[5].tolist()
    Path("day.script").write_text(f"set_tcp(p[0,0,0.1,0,0,0])\nmovej({q})\n")
    Path("loops.script").write_text(f"movej({q})\nmovel(pose_add(get_actual_tcp_pose(), p[0,0,0.1,0,0,0]))\n")
    Path("bare.script").write_text(f"movej({q})\n")
    waypoint = f'<Waypoint type="Fixed" name="a"><position><JointAngles angles="{str(q)[1:-1]}"/></position></Waypoint>'
    Path("taught.urp").write_bytes(gzip.compress(f"<URProgram>{waypoint}</URProgram>".encode()))
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        program, *arguments = shlex.split(command)
        ended = CliRunner().invoke(app, [*arguments, "--json", "result.json", "--force"])
        assert (program, ended.exit_code) == ("cellapp", 0), f"{command}: {ended.exception}"
        result = json.loads(Path("result.json").read_text("utf-8"))
        assert result["schema"] == "cellapp-correct"
        assert result["targets"][0]["new"] != result["targets"][0]["old"]
        assert Path(result["out"]).is_file()
    refused = CliRunner().invoke(app, ["correct", "logs/my-run", "loops.script", "--out", "x.script", "--arm", "left"])
    assert refused.exit_code != 0
    assert "line 2 have no correction" in str(refused.exception)
    assert not Path("x.script").exists()
    typed = CliRunner().invoke(
        app, ["correct", "logs/my-run", "bare.script", "--out", "x.script", "--arm", "left", "--tcp", "120,0,0"]
    )
    assert "expected six numbers" in str(typed.exception)
