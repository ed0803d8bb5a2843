"""The verb ``iso9283``: what it stores, what it refuses, and its command."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.driving.iso9283 import programme
from cellapp.cell.profile import profile_to_json
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283.request import VERB, Iso9283Request
from cellapp.commands.iso9283.run import iso9283_run, opened_run
from cellapp.commands.iso9283.view import iso9283_sentences, iso9283_tables
from cellapp.commands.record import Work
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.sections import report_sections
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import read_stages
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Progress
from cellapp.ground.results import ISO9283
from tests.cell.planning.planned_cells import one_arm
from tests.interfaces.cli.conftest import exit_code
from tests.sure import sure
from tests.twin import altered, small_twin


@pytest.fixture(autouse=True)
def _few_orientations(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cube need not be the largest here."""
    monkeypatch.setattr(programme, "_SEEDS", 4)


def left_alone() -> Profile:
    """The left arm of the twin, without hidden effects."""
    profile = one_arm()
    return altered(profile, plant={"effects": {}})


def asked(run: RunFile, **options: Any) -> Iso9283Request:
    """The request for tests in a run, as the interfaces make it."""
    request = VERB.asked({"folder": run.folder, **options})
    assert isinstance(request, Iso9283Request)
    return request


def test_a_calibrated_run_is_tested_as_found_and_as_left(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        result = iso9283_run(run, asked(run, tests=("pose", "cooperative"), cycles=3), Work())
        stages = read_stages(run)
        assert ISO9283 in stages.current
        assert ISO9283 not in stages.out_of_date
        assert read_results(run).iso9283 == result
        (section,) = (one for one in report_sections(run, read_report_data(RunState(run))) if one.key == "iso9283")
    assert Iso9283Result.from_json(result.to_json(), "test") == result
    assert (result.missing, result.stopped) == ((), "")
    for arm in result.arms.values():
        assert arm.base is None
        largest = {kind: max(one.accuracy.value_mm for one in tests.pose) for kind, tests in arm.tests.items()}
        assert largest["nominal"] > 20.0 * largest["calibrated"]
        assert largest["calibrated"] < 0.1
    (pair,) = result.pairs
    assert max(one.accuracy.value_mm for one in pair.vector["calibrated"]) < 0.1
    assert {one.characteristic for one in result.judgements} == {"pose_accuracy", "pose_repeatability", "cooperative"}
    assert all("calibrated commands, 3 of 30 cycles" in one.source for one in result.judgements)
    assert sure(result.conditions).commands == ("nominal", "calibrated")
    titles = [table.title for table in iso9283_tables(result)]
    assert titles[0] == "Errors against their tolerances [mm]"
    assert "Pose accuracy AP and repeatability RP [mm]" in titles
    message, *others = iso9283_sentences(result)
    assert "mm (nominal), " in message
    assert section.message.lower() == f"{message.lower()}."
    assert any("characteristics of orientation" in line for line in others)
    assert any("3 cycles at 100% of the profile's speed" in line and "payload: left 0.3 kg" in line for line in others)


def test_what_was_measured_before_a_fault_is_stored(finished_copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def listen(event: Progress) -> None:
        if event.job == "iso9283" and event.done == 7:
            raise HardwareError("arm right: protective stop")

    with RunFile.open(finished_copy, write=True) as run:
        request = asked(run, tests=["distance"], cycles=3, arms=["right"], commands="nominal")
        with pytest.raises(HardwareError, match="protective stop"):
            iso9283_run(run, request, Work(JobControl(listen)))
        stored = read_results(run).iso9283
    assert stored is not None
    assert stored.stopped == "stopped: arm right: protective stop"
    assert stored.complaints()[0] == stored.stopped
    assert any("of 3 cycles" in words for words in stored.missing)
    (distance,) = stored.arms["right"].tests["nominal"].distance
    assert distance.accuracy.n == 2
    assert list(stored.arms) == ["right"]


def test_a_folder_of_another_cell_is_refused(tmp_path: Path) -> None:
    opened_run(tmp_path / "run", small_twin(), new=True).close()
    opened_run(tmp_path / "run", small_twin(stops=7), new=False).close()
    with pytest.raises(InputError, match="differs from 'twin' in section 'arms'"):
        opened_run(tmp_path / "run", one_arm(), new=True)


def saved(profile: Profile, folder: Path) -> Path:
    path = folder / "cell.json"
    path.write_text(profile_to_json(profile), "utf-8")  # JSON is YAML
    return path


def test_the_command_makes_one_test_in_a_new_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = left_alone()
    path = saved(altered(profile, tolerances={"pose_accuracy": 0.05, "distance_accuracy": 1e-06}), tmp_path)
    out = tmp_path / "result.json"
    assert exit_code(monkeypatch, "iso9283", "distance", path, "--run", tmp_path / "run") == 2  # a folder mistyped
    assert "holds no run" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert exit_code(monkeypatch, "iso9283", "distance", path) == 2
    assert "--nominal" in capsys.readouterr().err
    arguments = ("--run", tmp_path / "run", "--cycles", 2, "--nominal", "--json", out)
    assert exit_code(monkeypatch, "iso9283", "distance", path, *arguments) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "one does not: distance accuracy AD of left" in printed
    assert not re.search("nearer|wider|more cycles|another instrument", printed), "a calibration would help"
    assert "Distance accuracy AD and repeatability RD" in printed
    assert "arm left: Distance accuracy AD " in printed
    found = json.loads(out.read_text("utf-8"))
    assert (found["schema"], found["tests"]) == ("cellapp-iso9283", ["distance"])
    assert found["arms"]["left"]["base"]["n"] == 20
    with RunFile.open(tmp_path / "run") as run:
        assert read_results(run).iso9283 is not None
        assert read_stages(run).out_of_date == {}


@pytest.mark.parametrize("words", [(), ("all",), ("pose",), ("--cycles", "2")], ids=["none", "all", "pose", "option"])
def test_the_name_of_the_test_may_be_left_out(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert exit_code(monkeypatch, "iso9283", *words, tmp_path / "missing.yaml") == 2
    assert "missing.yaml" in capsys.readouterr().err
