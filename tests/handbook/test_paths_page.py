"""The file on the page about paths, as it stands there."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.handbook.chapters import blocks
from tests.program import app


def test_the_file_of_the_page_is_compensated(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    (file,) = blocks("paths", "yaml")
    Path("seam.yaml").write_text(file, encoding="utf-8")
    for command in "".join(blocks("paths", "sh")).splitlines():
        words = shlex.split(command.replace("profiles/paths/twin.yaml", "seam.yaml"))[1:]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    assert len(Path("q.csv").read_text("utf-8").splitlines()) > 500
    assert Path("q.script").read_text("utf-8").count("  servoj(") > 500
