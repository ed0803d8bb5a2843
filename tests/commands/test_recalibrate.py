"""Many runs calibrated again: which, why, and what fails."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.requests.job_requests import taking_requests
from cellapp.cell.run import RunFile
from cellapp.commands.recalibrate.result import RecalibrateResult
from cellapp.commands.recalibrate.run import recalibrate
from cellapp.commands.recalibrate.view import recalibration_sentences, recalibration_table
from cellapp.commands.stages import read_stages
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.executors import Work
from cellapp.ground.results import CALIBRATE
from cellapp.interfaces.cli.app import app
from tests.estimation.monitoring.fleet.runs import STOPS, measured_run


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs that are calibrated and were not searched."""
    folder = tmp_path_factory.mktemp("fleet")
    measured_run(folder / "a", 1)
    shutil.copytree(folder / "a", folder / "b")
    return folder


def calibrations(run: Path) -> int:
    with RunFile.open(run) as opened:
        return [row.name for row in opened.stage_rows()].count(CALIBRATE)


def change(run: Path) -> None:
    """Let other readings be held out: the calibration is out of date then."""
    with RunFile.open(run, write=True) as opened:
        held_out = ["validate" if k % 3 == 0 else "identify" for k in range(STOPS)]
        opened.assign_splits("left", held_out)


def test_only_what_is_out_of_date_is_made_again(fleet: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(fleet, tmp_path / "fleet"))
    assert recalibrate([folder], computing=Work(), search=False).made == ()
    change(folder / "b")
    result = recalibrate([folder], computing=Work(), search=False)
    (made,) = result.made
    assert (Path(made.run).name, made.made) == ("b", ("calibrate",))
    assert made.because.startswith("calibrate: ")
    assert 0.0 < made.heldout_mm["left"] < 0.1
    assert len(recalibration_table(result).rows) == 1
    assert recalibration_sentences(result) == ["1 run computed again, 1 up to date, 0 failed"]
    assert RecalibrateResult.from_json(result.to_json(), "here") == result
    assert recalibrate([folder], computing=Work(), search=False).made == ()
    forced = recalibrate([folder / "a"], computing=Work(), search=False, force=True)
    assert [run.because for run in forced.runs] == ["calibrate: asked for"]
    assert [calibrations(folder / name) for name in ("a", "b")] == [2, 2]


def test_effects_are_searched_where_that_was_not_done(fleet: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(fleet / "a", tmp_path / "a"))
    (found,) = recalibrate([run], computing=Work()).runs
    assert (found.made, found.because) == (("discover",), "discover: not done yet")
    with RunFile.open(run) as opened:
        assert not read_stages(opened).out_of_date


def test_a_run_that_fails_is_named_and_does_not_stop_the_others(fleet: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(fleet, tmp_path / "fleet"))
    shutil.copytree(folder / "a", folder / "c")
    change(folder / "c")
    (folder / "a" / "run.sqlite").write_bytes(b"no run")
    with taking_requests(folder / "b", JobControl()):
        ended = CliRunner().invoke(app, ["recalibrate", str(folder), "--jobs", "1", "--calibration-only"])
    assert isinstance(ended.exception, CheckFailed)
    assert str(ended.exception) == "recalibrate: 2 of 3 runs failed"
    assert "1 run computed again, 0 up to date, 2 failed" in ended.output
    assert "is not a run file" in ended.output
    assert "is in use (a job that runs now)" in ended.output
    assert calibrations(folder / "c") == 2


def test_folders_without_runs_are_refused(tmp_path: Path) -> None:
    for folders, sentence in (
        ([], "at least one folder"),
        ([tmp_path], "no runs below"),
        ([tmp_path / "x"], "not found"),
    ):
        with pytest.raises(InputError, match=sentence):
            recalibrate(folders, computing=Work())
