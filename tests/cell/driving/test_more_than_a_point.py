"""Collecting more than a point on the simulated cell: several nests on one flange, a 6-D probe on the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.nests import Nests
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import view
from cellapp.commands.push.run import push_run
from cellapp.commands.view.table import Table
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Smr
from tests.twin import PROFILES, small_twin

STOPS = 8
NESTS = {"B": (-0.045, 0.02, 0.06), "C": (0.0, 0.075, 0.06)}
RPY = (0.1, -0.2, 0.3)


def cell_with(stops: int = STOPS) -> Profile:
    profile = small_twin(stops)
    left, right = profile.arms["left"], profile.arms["right"]
    nests: dict[str, Any] = {"name": "A", "nests": {name: {"offset": offset} for name, offset in NESTS.items()}}
    smrs = {
        "left": Smr.model_validate({**left.smr.model_dump(), **nests}),
        "right": Smr.model_validate({**right.smr.model_dump(), "probe": {"rpy": RPY, "sigma": 5e-5}}),
    }
    arms = {name: arm.model_copy(update={"smr": smrs[name]}) for name, arm in profile.arms.items()}
    return profile.model_copy(update={"arms": arms})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    profile = cell_with()
    with RunFile.create(tmp_path_factory.mktemp("more") / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        yield made


def test_nests_are_measured_one_after_another_and_give_the_orientation(run: RunFile) -> None:
    rows, one = run.rows("left"), run.readings("left")
    assert set(rows.smr or ()) == {"A", "B", "C"}
    assert len(one) == STOPS
    for stop in range(STOPS):
        own = np.flatnonzero(rows.configuration == stop)
        assert rows.smr is not None
        assert rows.smr[own[0]] == "A"
        assert np.all(np.diff(rows.time_s[own]) > 0.0)
        np.testing.assert_array_equal(rows.q[own], rows.q[own[:1]].repeat(len(own), axis=0))
    assert one.quaternion_M is not None
    assert np.isfinite(one.quaternion_M).all(axis=1).sum() >= STOPS - 2


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


def test_the_nests_that_are_seen_are_in_the_order_of_the_shortest_way() -> None:
    profile = cell_with()
    nests = Nests.of(profile, cell_bodies(profile))
    plan = plan_stops(profile)
    seen = nests.seen("left", plan)
    for stop in range(STOPS):
        order = [name for name, _ in nests.in_order("left", {name: q[stop] for name, q in plan.items()})]
        assert set(order) == {name for name in NESTS if seen[name][stop]}
    (note,) = nests.notes(plan)
    assert note.startswith("arm left: beside nest A the tracker sees B at ")
    assert nests.seen("right", plan) == {}


def test_calibration_finds_the_nests_and_says_what_they_tell(tmp_path: Path) -> None:
    profile = cell_with(30)
    with RunFile.create(tmp_path / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        result = calibrate_run(made)
        known = load_targets(PROFILES / "targets" / "twin.yaml", profile)
        targets = [one for one in known if one.partner is None and one.arm in profile.arms]
        verified = push_run(made, [*targets[:4], *targets[-4:]], verify=True)
    turns = {one.arm: one.orientation for one in verified.targets if one.orientation is not None}
    assert set(turns) == {"left", "right"}  # of three nests, and of a probe
    for turn in turns.values():
        assert turn.final_mrad is not None
        assert turn.final_mrad < 3.0
    nests = result.arms["left"].nests
    assert nests is not None
    assert nests.stops == 30
    assert nests.noise_mm is not None
    assert 0.005 < nests.noise_mm < 0.05
    mechanism = build_plant(profile).true_mechanism("left")
    for name in NESTS:
        np.testing.assert_allclose(nests.found[name].offset_m, mechanism.nests[name], atol=1e-3)
    shown = view(result)
    assert "Arm left: nests in the flange frame" in [part.title for part in shown.parts if isinstance(part, Table)]
    assert any("nests, which tell the orientation at" in part for part in shown.parts if isinstance(part, str))
    assert result.arms["right"].nests is None
