"""``show DIR plan --check``, ``--forecast`` and ``doctor --cell``: what the screens Cell and Plan show, in batch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.pipeline import new_planned_run
from cellapp.run import RunFile
from tests.cli.test_cli import exit_code
from tests.twin import PROFILES, small_twin

pytestmark = pytest.mark.fast


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.MonkeyPatch.context() as patch:
        code = exit_code(patch, *arguments)
    said = capsys.readouterr()
    return code, said.out, said.err


def read_json(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def test_a_plan_is_checked_and_foreseen_in_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new_planned_run(small_twin(12), tmp_path / "run").close()
    before = (tmp_path / "run" / "run.sqlite").read_bytes()
    out = tmp_path / "out.json"
    code, said, _ = called(capsys, "show", tmp_path / "run", "plan", "--check", "--json", out)
    assert (code, read_json(out)["schema"]) == (0, "cellapp-plan-check")
    assert "Safe: 12 stops and 13 ways" in said
    code, said, _ = called(capsys, "show", tmp_path / "run", "plan", "--forecast", "--json", out)
    assert code == 0
    assert read_json(out)["schema"] == "cellapp-plan-forecast"
    assert set(read_json(out)["arms"]) == {"left", "right"}
    assert "effects that the plan can show" in said
    assert "Collecting takes about" in said
    assert (tmp_path / "run" / "run.sqlite").read_bytes() == before


def test_a_plan_that_is_refused_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    down = np.array([[0.0, 0.6, 0.0, -1.5, 0.0, 0.0]])  # bent down into the floor
    with RunFile.create(tmp_path / "run", small_twin(1), lambda run: run.write_plan({"left": down, "right": down})):
        pass
    out = tmp_path / "out.json"
    code, said, complaint = called(capsys, "show", tmp_path / "run", "plan", "--check", "--json", out)
    assert code == 1
    assert "stop 1: arm left: collides with the floor" in said
    assert "Not safe" in complaint
    assert read_json(out)["refused"]


def test_bad_use_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    RunFile.create(tmp_path / "imported", small_twin()).close()
    for arguments, words in (
        (("overview", "--check"), "belong to 'plan'"),
        (("plan", "--check", "--forecast"), "give one of them"),
        (("plan", "--check"), "the run has no plan"),
        (("plan", "--forecast"), "the run has no plan"),
    ):
        code, _, complaint = called(capsys, "show", tmp_path / "imported", *arguments)
        assert code == 2
        assert words in complaint


def test_the_doctor_says_what_the_profile_describes(capsys: pytest.CaptureFixture[str]) -> None:
    code, said, _ = called(capsys, "doctor", PROFILES / "twin.yaml", "--cell")
    assert code == 0
    for words in ("UR10, 6 joints", "clearance", "elevation -55 to 55 deg"):
        assert words in " ".join(said.split())
