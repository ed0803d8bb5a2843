"""Reading long target lists and bringing them into the tracker frame. Nothing absolute is asserted.

pytest tests/benchmarks/test_target_lists.py
"""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.targets.goals import goals_of_arm
from cellapp.cell.targets.target_text import targets_text
from cellapp.cell.targets.targets import load_targets
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.robot.model import CellModel
from tests.twin import small_twin

COUNT = 10_000
PROFILE = small_twin()


@pytest.fixture(scope="module")
def csv(tmp_path_factory):
    path = tmp_path_factory.mktemp("lists") / "targets.csv"
    poses = np.random.default_rng(1).uniform(-800.0, 800.0, (COUNT, 6)) * [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]
    header = "name,arm,frame,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg,tolerance_mm\n"
    rows = (f"t{k},left,tracker,{','.join(f'{value:.3f}' for value in pose)},0.1\n" for k, pose in enumerate(poses))
    path.write_text(header + "".join(rows))
    return path


@pytest.mark.benchmark(group="10 000 targets")
def test_read_csv(benchmark, csv):
    assert len(benchmark.pedantic(load_targets, (csv, PROFILE), rounds=3)) == COUNT


@pytest.mark.benchmark(group="10 000 targets")
def test_read_yaml(benchmark, csv):
    path = csv.with_suffix(".yaml")
    path.write_text(targets_text(load_targets(csv, PROFILE)))
    assert len(benchmark.pedantic(load_targets, (path, PROFILE))) == COUNT


@pytest.mark.benchmark(group="10 000 targets")
def test_goals(benchmark, csv):
    model = CellModel({name: nominal_model(PROFILE, name) for name in PROFILE.arms})
    goals = benchmark.pedantic(goals_of_arm, (model, load_targets(csv, PROFILE), "left"), rounds=3)
    assert len(goals.rows) == COUNT
