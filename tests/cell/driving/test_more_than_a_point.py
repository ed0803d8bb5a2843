"""Collecting more than a point on the simulated cell: a 6-D probe on one flange, one SMR on the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.push.run import push_run
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from tests.twin import PROFILES, small_twin

STOPS = 8
RPY = (0.1, -0.2, 0.3)


def cell_with(stops: int = STOPS) -> Profile:
    profile = small_twin(stops)
    right = profile.arms["right"]
    smr = Smr.model_validate({**right.smr.model_dump(), "probe": {"rpy": RPY, "sigma": 5e-5}})
    return profile.model_copy(update={"arms": {**profile.arms, "right": right.model_copy(update={"smr": smr})}})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    profile = cell_with()
    with RunFile.create(tmp_path_factory.mktemp("more") / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        yield made


def test_a_probe_is_measured_as_it_is_turned(run: RunFile) -> None:
    right = run.readings("right")
    assert right.quaternion_M is not None
    assert right.sigma_rad is not None
    np.testing.assert_array_equal(right.sigma_rad, np.full(STOPS, 5e-5))
    true = build_plant(run.profile).probe_rotations(
        "right", right.q, approach=right.approach.astype(np.float64), others={"left": run.readings("left").q}
    )
    off = (Rotation.from_quat(np.roll(right.quaternion_M, -1, axis=1)) * Rotation.from_matrix(true).inv()).as_rotvec()
    assert np.abs(off).max() < 5e-3  # hidden effects of time, rest and warmth are not asked for here


def test_the_orientation_of_a_probe_is_verified_at_targets(tmp_path: Path) -> None:
    profile = cell_with(30)
    with RunFile.create(tmp_path / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        calibrate_run(made)
        known = load_targets(PROFILES / "targets" / "twin.yaml", profile)
        targets = [one for one in known if one.partner is None and one.arm in profile.arms]
        verified = push_run(made, [*targets[:4], *targets[-4:]], verify=True)
    turns = {one.arm: one.orientation for one in verified.targets if one.orientation is not None}
    assert set(turns) == {"right"}
    assert turns["right"].final_mrad is not None
    assert turns["right"].final_mrad < 3.0
