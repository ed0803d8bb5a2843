"""Recordings of motion from their files to commands: imported, shown, calibrated, used, refused; networks from all."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.commands.calibrate.request import VERB
from cellapp.commands.calibrate.request import VERB as CALIBRATE
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.export.run import export
from cellapp.commands.import_ import VERB as IMPORT
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.stages import read_stages
from cellapp.commands.view.table import Table
from cellapp.estimation.calibration import network_training
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Cancelled, JobToken, Progress
from cellapp.robot.kinematics.chain import smr_positions
from tests.commands.moved_arms import OFFSET_S, RATE_PPM, SIGMA_M, add_arm, true_arm, write_recording
from tests.interfaces.page.runs import without_devices
from tests.program import app
from tests.sure import sure
from tests.verbs import export_as_run, import_new_run


def files_of(folder: Path, profile, *names: str, **options: float) -> tuple[list[Path], list[Path]]:
    pairs = [write_recording(folder, name, true_arm(profile, name), **options) for name in names]
    return [joints for joints, _ in pairs], [points for _, points in pairs]


def test_one_arm_is_calibrated_from_a_recording_alone(tmp_path: Path) -> None:
    profile = without_devices("left")
    imported = import_new_run(profile, None, tmp_path / "run", recordings=files_of(tmp_path, profile, "left"))
    assert (imported.readings, imported.recordings[0].points.n) == ({}, 3800)
    assert isinstance(IMPORT.view(imported).parts[0], Table)
    with RunFile.open(tmp_path / "run", write=True) as run:
        assert RunState(run).next_step.verb == "calibrate"
        result = calibrate_run(run)
        samples, state = known_readings(run, "left"), RunState(run)
        assert (len(run.readings("left")), state.measured["left"].readings) == (0, len(samples))
        overview = run_overview(state)
        exported = export_as_run(run, "dh", tmp_path / "arm.yaml")
    arm = json.loads(result.to_json())["arms"]["left"]
    clock = arm["clocks"]["left"]
    at_s = clock["at_s"] - OFFSET_S
    expected = OFFSET_S + 1e-6 * RATE_PPM * (at_s - 20.0)
    assert abs(clock["offset_s"] - expected) < 5.0 * clock["offset_standard_error_s"] < 1e-4
    assert abs(clock["rate_ppm"] - RATE_PPM) < 5.0 * clock["rate_standard_error_ppm"] < 5.0
    nominal, geometry = (arm["validate"][stage]["position_mm"]["rms"] for stage in ("nominal", "geometry"))
    assert geometry < 2e3 * SIGMA_M * np.sqrt(3.0) < 0.25 * nominal
    assert arm["splits"]["validate"] == arm["validate"]["geometry"]["position_mm"]["n"]
    assert {"identify", "validate"} == set(samples.split or ())
    assert 100 < len(samples) < 40.0 / 0.3, "of 40 s: nearer neighbours err alike"
    off = smr_positions(true_arm(profile, "left"), samples.q) - samples.p_M
    assert np.sqrt(np.mean(off**2)) < 2.0 * SIGMA_M, "the samples stand at the fitted clock"
    assert overview.stages[0].out_of_date is None
    assert exported.arms is not None
    titles = [part.title for part in CALIBRATE.view(result).parts if isinstance(part, Table)]
    assert any(title.startswith("Clocks") for title in titles)


def test_recordings_and_stops_of_two_arms(tmp_path: Path) -> None:
    profile = without_devices("left", "right")
    files = files_of(tmp_path, profile, "left", "right")
    joints = [add_arm(path, name) for path, name in zip(files[0], profile.arms, strict=True)]
    points = [add_arm(path, name) for path, name in zip(files[1], profile.arms, strict=True)]
    import_new_run(profile, None, tmp_path / "run", recordings=(joints, points))
    with RunFile.open(tmp_path / "run", write=True) as run:
        alone = calibrate_run(run)
        rng = np.random.default_rng(1)
        q = rng.uniform(-2.0, 2.0, (30, 6))
        p_M = smr_positions(true_arm(profile, "left"), q) + rng.normal(0.0, SIGMA_M, (30, 3))
        approach = np.zeros((30, 6), np.int8)
        run.add_readings(
            "left", Readings(configuration=np.arange(30), time_s=np.full(30, np.nan), q=q, approach=approach, p_M=p_M)
        )
        assert "readings" in read_stages(run).out_of_date["calibrate"]
        both = calibrate_run(run)
        known = known_readings(run, "left")
        assert (known.configuration < 30).sum() == 30 < len(known)
        assert not np.intersect1d(known.configuration, known_readings(run, "right").configuration).size
        assert len(known_readings(run, "right")) > 100
    assert [note for note in alone.notes if "tracker's frame" in note]
    assert set(both.arms["left"].validate_) == {"nominal", "geometry"}
    assert both.arms["left"].validate_["geometry"].position_mm.n == both.arms["left"].splits["validate"] < 30
    in_motion = sure(both.arms["left"].motion)
    assert in_motion.stops_scatter_mm == pytest.approx(SIGMA_M * 1e3, rel=0.5)
    assert in_motion.validate_["geometry"].position_mm.rms < 0.1
    titles = [part.title for part in CALIBRATE.view(both).parts if isinstance(part, Table)]
    assert any(title.startswith("In motion") for title in titles)


def test_a_step_of_a_clock_is_named(tmp_path: Path) -> None:
    profile = without_devices("left")
    import_new_run(profile, None, tmp_path / "run", recordings=files_of(tmp_path, profile, "left", step_s=0.25))
    with RunFile.open(tmp_path / "run", write=True) as run:
        result = calibrate_run(run)
    (clock,) = (result.arms["left"].clocks or {}).values()
    ((_, by_s),) = clock.steps_of_points
    assert by_s == pytest.approx(0.25, abs=0.02)
    assert len(clock.segments) == 2
    assert any("the tracker's clock steps by" in str(part) for part in CALIBRATE.view(result).parts)


def test_recordings_that_changed_make_the_calibration_out_of_date(tmp_path: Path) -> None:
    profile = without_devices("left")
    import_new_run(profile, None, tmp_path / "run", recordings=files_of(tmp_path, profile, "left"))
    with RunFile.open(tmp_path / "run", write=True) as run:
        calibrate_run(run)
        with run.change() as connection:
            connection.execute("UPDATE recording SET sha256 = 'other'")
        assert read_stages(run).out_of_date["calibrate"] == "the recordings of motion were changed since"


def test_what_cannot_be_calibrated_is_said(tmp_path: Path) -> None:
    profile = without_devices("left", "right")
    files = files_of(tmp_path, profile, "left", "right")
    with pytest.raises(InputError, match="no recording of arm right"):
        import_new_run(profile, None, tmp_path / "one", recordings=([files[0][0]], [files[1][0]]), arm="left")
    assert not (tmp_path / "one").exists()
    mixed = ([files[0][0], files[0][1]], [files[1][1], files[1][0]])
    joints = [add_arm(path, name) for path, name in zip(mixed[0], profile.arms, strict=True)]
    points = [add_arm(path, name) for path, name in zip(mixed[1], profile.arms, strict=True)]
    import_new_run(profile, None, tmp_path / "run", recordings=(joints, points))
    with RunFile.open(tmp_path / "run", write=True) as run:
        with pytest.raises(InputError, match="recording"):
            calibrate_run(run)
        assert not read_stages(run).current
    with pytest.raises(InputError, match="holds no recording of motion"):
        _empty_export(tmp_path)


def _empty_export(folder: Path) -> None:
    with RunFile.create(folder / "empty", without_devices("left")) as run:
        export(run, ExportRequest(folder=run.folder, joints=folder / "out.csv"))


def test_long_fits_of_recordings_say_what_they_do_and_end_on_request(tmp_path: Path) -> None:
    profile = without_devices("left")
    import_new_run(profile, None, tmp_path / "run", recordings=files_of(tmp_path, profile, "left", seconds=20.0))

    def events_until(words: str, job: Callable[[RunFile, JobToken], object]) -> list[Progress]:
        """Events of a job that is asked to end as soon as it says ``words``."""
        events: list[Progress] = []

        def listen(event: Progress) -> None:
            events.append(event)
            if words in event.note:
                asked.cancel()

        asked = JobToken(listen)
        with RunFile.open(tmp_path / "run", write=True) as run, pytest.raises(Cancelled):
            job(run, asked)
        return events

    of_calibrate = events_until("with all points", calibrate_run)
    assert [event.note for event in of_calibrate][:2] == [
        "arm left: start of the clocks of recording 'left'",
        "arm left: step 1 with some of the points",
    ]
    assert of_calibrate[-1].note == "arm left: step 1 with all points", "nothing is done after the request"
    with RunFile.open(tmp_path / "run", write=True) as run:
        assert RunState(run).next_step.verb == "calibrate"
        seen: list[Progress] = []
        calibrate_run(run, JobToken(seen.append))
    assert [(event.done, event.total) for event in seen if event.job == "recordings of motion"][-1] == (1, 1)
    of_discover = events_until("with backlash: step 1", discover_run)
    assert of_discover[-1].job == "discover"
    assert "arm left: recordings: with backlash: step 1" in of_discover[-1].note


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    moved = tmp_path_factory.mktemp("moved")
    profile = without_devices("left")
    joints, points = write_recording(moved, "left", true_arm(profile, "left"))
    import_new_run(profile, None, moved / "run", recordings=([joints], [points]))
    return moved / "run"


@pytest.mark.slow
def test_a_recording_teaches_and_the_comparison_is_said(moved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(network_training, "_FEWEST_STEPS", 60)
    with RunFile.open(moved, write=True) as run:
        assert run.profile.network.kind == "none"
        result = calibrate_run(run, network="batches")
    network = sure(result.arms["left"].network)
    assert sure(network.batches).readings > 2000
    assert sure(network.batches).blocks == 40
    assert ("network" in result.arms["left"].validate_) == network.used
    assert CalibrateResult.model_validate_json(result.to_json()) == result
    said = [part for part in VERB.view(result).parts if isinstance(part, str)]
    assert any("readings in batches" in sentence and "the committee" in sentence for sentence in said)
    kept = result.model_dump(by_alias=True)["arms"]["left"]["network"]
    assert "batches" in kept


def test_without_torch_the_command_says_what_to_install(moved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    ended = CliRunner().invoke(app, ["calibrate", str(moved), "--network", "batches"])
    assert isinstance(ended.exception, InputError)  # which ends the program with 2 and this sentence
    assert "pip install 'cellapp[learn]'" in str(ended.exception)


def test_another_network_is_refused(moved: Path) -> None:
    ended = CliRunner().invoke(app, ["calibrate", str(moved), "--network", "deep"])
    assert ended.exit_code == 2
    assert "batches" in ended.output
