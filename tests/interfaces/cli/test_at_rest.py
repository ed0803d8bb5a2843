"""``at-rest``: a person settles that an arm counts as moving; ``show`` says it first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.run.unseen_arms import note_halt
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Halt
from tests.cell.run.small_runs import planned_run
from tests.program import app

pytestmark = pytest.mark.fast


def test_a_person_says_that_an_arm_rests(tmp_path: Path) -> None:
    folder, call = tmp_path / "run", CliRunner().invoke
    with planned_run(folder) as run:
        note_halt(run, "left", Halt("not seen at rest", "arm left: link lost"))
    shown = " ".join(call(app, ["show", str(folder)]).output.split())
    assert "arm left: NOT SEEN AT REST since" in shown
    state = json.loads(call(app, ["show", str(folder), "--json", "-"]).stdout)
    assert state["not_seen_at_rest"]["left"]["reason"] == "arm left: link lost"

    told = json.loads(call(app, ["at-rest", str(folder), "left", "--json", "-"]).stdout)
    assert (told["schema"], told["counted_as_moving"]) == ("cellapp-at-rest", True)
    assert "it did not count as moving" in call(app, ["at-rest", str(folder), "left"]).stdout
    assert "NOT SEEN" not in call(app, ["show", str(folder)]).output
    refused = call(app, ["at-rest", str(folder), "middle"])
    assert isinstance(refused.exception, InputError)
    assert "arm 'middle' not found" in str(refused.exception)
