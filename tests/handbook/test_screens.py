"""Pictures of the terminal application's screens: the command draws all of them from a finished run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.ground.errors import InputError
from cellapp.interfaces.tui.screens import SCREENS
from tests.program import app
from tests.twin import PROFILES

TWIN = PROFILES / "twin.yaml"


def test_the_command_draws_every_screen(finished_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "new"
    ended = CliRunner().invoke(
        app, ["docs", "screens", "--profile", str(TWIN), "--run", str(finished_run), "--out", str(out), "--json", "-"]
    )
    assert ended.exit_code == 0
    paths = [out / f"screen-{step}.svg" for step in ("first-run", *(entry.step for entry in SCREENS))]
    assert json.loads(ended.stdout)["files"] == [str(path) for path in paths]
    texts = {path.stem: path.read_text("utf-8").replace("&#160;", " ") for path in paths}
    assert not any("@font-face" in text or len(text) > 150_000 for text in texts.values())
    assert "Try the simulated twin" in texts["screen-first-run"]
    assert "COMPLETE, " in texts["screen-collect"]
    assert "held-out errors [mm]" in texts["screen-calibrate"]
    with pytest.raises(InputError, match="--run belongs to 'screens'"):
        CliRunner().invoke(app, ["docs", "figures", "--run", "x"], catch_exceptions=False)
