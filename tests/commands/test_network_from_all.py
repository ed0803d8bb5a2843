"""``calibrate --network batches``: from a recording by command, in result and words; without torch, one sentence."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.request import VERB
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.import_ import import_new_run
from cellapp.estimation.calibration import learning
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.errors import InputError
from tests.commands.moved_arms import true_arm, write_recording
from tests.interfaces.page.runs import without_devices
from tests.program import app


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("moved")
    profile = without_devices("left")
    joints, points = write_recording(folder, "left", true_arm(profile, "left"))
    import_new_run(profile, None, folder / "run", recordings=([joints], [points]))
    return folder / "run"


def test_a_recording_teaches_and_the_comparison_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(learning, "_FEWEST_STEPS", 60)
    with RunFile.open(folder, write=True) as run:
        assert run.profile.network.kind == "none"
        result = calibrate_run(run, network="batches")
    network = result.arms["left"].network
    assert network is not None
    assert network.batches is not None
    assert network.batches.readings > 2000
    assert network.batches.blocks == 40
    assert ("network" in result.arms["left"].validate_) == network.used
    assert CalibrateResult.model_validate_json(result.to_json()) == result
    said = [part for part in VERB.view(result).parts if isinstance(part, str)]
    assert any("readings in batches" in sentence and "the committee" in sentence for sentence in said)
    kept = result.model_dump(by_alias=True)["arms"]["left"]["network"]
    assert "batches" in kept


def test_without_torch_the_command_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    ended = CliRunner().invoke(app, ["calibrate", str(folder), "--network", "batches"])
    assert isinstance(ended.exception, InputError)  # which ends the program with 2 and this sentence
    assert "pip install 'cellapp[learn]'" in str(ended.exception)


def test_another_network_is_refused(folder: Path) -> None:
    ended = CliRunner().invoke(app, ["calibrate", str(folder), "--network", "deep"])
    assert ended.exit_code == 2
    assert "batches" in ended.output
