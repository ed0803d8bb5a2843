"""Compensated paths: what is written, stored and refused, and how far the true SMR is from them."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.driving.tracked_path import MOST_RUNS, PathDriver
from cellapp.cell.exports.arm_commands import first_rates
from cellapp.cell.run import RunFile
from cellapp.cell.targets.path import PathPlan, PathResult, PathSpec, plan_path
from cellapp.commands.compensate.request import VERB
from cellapp.commands.compensate.run import compensate_paths
from cellapp.commands.compensate.run import run as compensate
from cellapp.commands.compensate.view import paths_view
from cellapp.commands.record import Work
from cellapp.commands.report.result import read_results
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY
from cellapp.ground.progress import Cancelled, ignore
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel
from drivers.trackers.protocol import TargetLost
from tests.crossed_beam import crossed_beam
from tests.twin import PROFILES, plant_of


def spec(**changes: Any) -> PathSpec:
    """A quarter of a circle of the right arm, whose joints have backlash, and a line back."""
    poses = [
        {"position": [0.20, 0.50, 0.45], "rpy": ["-90 deg", 0, 0]},
        {"position": [0.30, 0.50, 0.55], "via": [0.2293, 0.50, 0.5207]},
        {"position": [0.22, 0.50, 0.45]},
    ]
    content = {"name": "arc", "arm": "right", "tolerance": "0.1 mm", "speed": "100 mm/s", "poses": poses}
    return PathSpec.model_validate({**content, **changes})


WORK = Work(ignore, JobControl(), lambda _: None, NEW_ONLY)
OUT_OF_REACH = spec(name="far", poses=[spec().poses[0], {"position": [0.2, 3.0, 0.45]}])


def test_a_path_is_written_and_stored_and_nothing_moves(run: RunFile, cells: list[Any], tmp_path: Path) -> None:
    result = compensate_paths(run, [spec(), OUT_OF_REACH], tmp_path / "q.csv")
    assert cells == []
    assert read_results(run).path == result
    assert PathResult.from_json(result.to_json(), "test") == result
    near, far = result.paths
    assert near.refusal == ""
    assert near.deviation_mm is not None
    assert near.deviation_mm < 0.01
    assert {one.joint for one in near.reversals} <= {1, 2, 3}  # the joints with play
    assert "out of reach" in far.refusal
    assert result.complaints() == [f"path far refused {far.refusal}"]
    assert f"path far: refused: {far.refusal}" in paths_view(result).parts
    assert result.files == (str(tmp_path / "q.csv"),)
    with (tmp_path / "q.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == near.samples
    assert {row["path"] for row in rows} == {"arc"}
    assert float(rows[1]["time_s"]) == 0.008


def test_a_program_streams_the_path_from_home_and_back(run: RunFile, model: CellModel, tmp_path: Path) -> None:
    result = compensate_paths(run, [spec(), OUT_OF_REACH], tmp_path / "q.script")
    text = (tmp_path / "q.script").read_text("utf-8")
    assert result.files == (str(tmp_path / "q.script"),)
    assert text.startswith("# Compensated joint paths as URScript, by cellapp, of a simulated cell.\n")
    assert "  # path far: left out: " in text
    sent = re.findall(r"^  (movej|servoj)\(\[(.*?)\]", text, re.MULTILINE)
    motions = [(word, np.array(q.split(", "), float)) for word, q in sent]
    trajectory = plan_path(run.profile, model, spec(), 0.008).trajectory
    assert trajectory is not None
    home = np.array(run.profile.arms["right"].home)
    assert [word for word, _ in motions[:3]] == ["movej"] * 3
    for _, q in (motions[0], motions[-1]):
        np.testing.assert_allclose(q, home, atol=1e-9)
    streamed = np.array([q for word, q in motions if word == "servoj"])
    np.testing.assert_allclose(streamed[: len(trajectory.q) - 1], trajectory.q[1:], atol=1e-9)
    np.testing.assert_array_equal(streamed[len(trajectory.q) - 1 :], np.tile(streamed[-1], (38, 1)))
    speed, acceleration = first_rates(run.profile, run.profile.arms["right"])
    assert f"a={acceleration:.3f}, v={speed:.3f})" in text


def test_each_arm_has_a_program_of_its_own(run: RunFile, tmp_path: Path) -> None:
    request = {"folder": run.folder, "targets": PROFILES / "paths" / "twin.yaml", "out": tmp_path / "q.script"}
    result = compensate(VERB.asked(request), WORK)  # type: ignore[arg-type]
    assert isinstance(result, PathResult)
    assert result.files == (str(tmp_path / "q-left.script"), str(tmp_path / "q-right.script"))


def test_what_cannot_be_written_is_refused(run: RunFile, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a file \.csv, or \.script"):
        compensate_paths(run, [spec()], tmp_path / "q.txt")
    targets = {"folder": run.folder, "targets": PROFILES / "targets" / "twin.yaml", "out": tmp_path / "q.csv"}
    with pytest.raises(InputError, match="--out is for path files"):
        compensate(VERB.asked(targets), WORK)  # type: ignore[arg-type]
    control = JobControl()
    control.cancel()
    with pytest.raises(Cancelled):
        compensate_paths(run, [spec()], control=control)


def off_m(run: RunFile, model: CellModel, plan: PathPlan) -> Array:
    """Distances (n,) [m] of the measured SMR from a path that the simulated arm follows."""
    control = JobControl()
    path, trajectory, before = plan.path, plan.trajectory, plan.run_up
    assert path is not None
    assert trajectory is not None
    assert before is not None
    with moving_cell(run.profile, model, control, slow_visits=None) as moving:

        def begin() -> None:
            for q in (before, trajectory.q[0]):
                moving.mover.go_home_unless_clear("right", q)
                moving.mover.move({"right": q})

        driver = PathDriver(moving.cell, moving.mover, moving.reaction, control)
        found = driver.drive("right", trajectory, begin, path.positions(np.zeros(1))[0])
        clearance = plant_of(moving.cell).clearance
        assert clearance is not None
        assert min(clearance.arms_m, clearance.floor_m) > 0.0
    return path.distances(found.track.p_M)


def test_the_true_smr_keeps_the_tolerance_and_would_not_without_its_plays(
    run: RunFile, model: CellModel, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    off = off_m(run, model, plan_path(run.profile, model, spec(), 0.008))
    assert np.quantile(off, 0.95) < spec().tolerance
    monkeypatch.setattr("cellapp.robot.paths.joint_path._approach", lambda s, turns, crossings: np.zeros((len(s), 6)))
    without = off_m(run, model, plan_path(run.profile, model, spec(), 0.008))
    assert without.mean() > max(4e-5, 1.5 * off.mean())


def test_a_beam_that_breaks_each_time_leaves_the_path_unmeasured(
    run: RunFile, model: CellModel, cells: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    crossed = crossed_beam(monkeypatch, cells, "right", 1.0, times=99)
    with pytest.raises(TargetLost, match="the beam broke each of the 4 times"):
        off_m(run, model, plan_path(run.profile, model, spec(), 0.008))
    assert len(crossed) == MOST_RUNS
    plant = plant_of(cells[0])
    assert not any(plant.moving(name) for name in ("left", "right"))
