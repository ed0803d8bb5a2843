"""The commands and the file on the page about paths, as they stand there."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cli.app import app
from cellapp.docs.handbook import chapter_text
from tests.twin import PROFILES

COMMANDS, FILE = (
    "".join(re.findall(rf"^```{kind}\n(.*?)^```", chapter_text("paths"), re.M | re.S)) for kind in ("sh", "yaml")
)


def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    shutil.copytree(PROFILES / "paths", "profiles/paths")
    first, *others = COMMANDS.splitlines()
    assert len(others) == 2
    Path("seam.yaml").write_text(FILE, encoding="utf-8")
    for command in (first, first.replace("profiles/paths/twin.yaml", "seam.yaml")):
        done = CliRunner().invoke(app, shlex.split(command)[1:])
        assert done.exit_code == 0, done.output
        assert len(Path("q.csv").read_text("utf-8").splitlines()) > 500
    for command in others:  # their options, without the drive that other tests do
        words = [word for word in shlex.split(command)[1:] if word not in ("--verify", "--drive", "--rehearse")]
        assert CliRunner().invoke(app, words).exit_code == 0
        assert "rehearsal" in str(CliRunner().invoke(app, [*words, "--rehearse"]).exception)
