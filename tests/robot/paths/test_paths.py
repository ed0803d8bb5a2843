"""Paths by the mathematics alone: geometry, files, joint paths within tolerance, timing within limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.cell.targets.path import PathPlan, PathSpec, load_paths, plan_path
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import parameter_names
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, pose_matrix, up_in_tracker
from cellapp.robot.paths.cartesian import Arc, CartesianPath
from cellapp.robot.paths.joint_path import Sweep
from tests.approved import assert_refused
from tests.arms import effect_term
from tests.sure import sure
from tests.twin import PROFILES, small_twin

PERIOD_S = 0.008
TWIN = PROFILES / "paths" / "twin.yaml"


@pytest.fixture(scope="module")
def profile() -> Profile:
    return small_twin()


@pytest.fixture(scope="module")
def model(profile: Profile) -> CellModel:
    return calibrated(profile)


def calibrated(profile: Profile) -> CellModel:
    """A calibrated cell: every arm's geometry is some 0.3 mm off the published one; all have backlash."""
    rng = np.random.default_rng(5)
    arms = {}
    for name, arm in profile.arms.items():
        T_M_B = np.linalg.inv(pose_matrix(sure(profile.tracker.pose))) @ pose_matrix(sure(arm.base))
        nominal = nominal_arm(arm).with_T_M_B(T_M_B)
        names = parameter_names(nominal.joints)
        sizes = np.array([3e-4 if "a" in parameter or "d" in parameter else 1e-3 for parameter in names])
        real = nominal.with_vector(nominal.vector() + 0.3 * sizes * rng.standard_normal(len(names)))
        term = effect_term("backlash", {f"half_play{j + 1}": 1e-4 for j in range(nominal.joints)})
        arms[name] = ArmModel(real, nominal, bodies_of(arm), up_in_tracker(profile), (term,))
    return CellModel(arms)


def spec(**changes: Any) -> PathSpec:
    """A short line of the left arm, in front of the tracker."""
    content: dict[str, Any] = {
        "name": "line",
        "arm": "left",
        "tolerance": "0.05 mm",
        "speed": "100 mm/s",
        "poses": [{"position": [-0.15, -0.75, 0.55], "rpy": ["90 deg", 0, 0]}, {"position": [0.05, -0.75, 0.55]}],
    }
    return PathSpec.model_validate({**content, **changes})


# -- geometry ---------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9))
def test_an_arc_goes_through_its_three_points(numbers: list[float]) -> None:
    start, via, end = np.array(numbers).reshape(3, 3)
    height = np.linalg.norm(np.cross(via - start, end - start))
    if height < 0.05:
        return
    arc = Arc.through(start, via, end)
    ends = arc.positions(np.array([0.0, arc.length]))
    np.testing.assert_allclose(ends, np.stack([start, end]), atol=float(1e-9 / height))
    points = arc.positions(np.linspace(0.0, arc.length, 2001))
    assert np.linalg.norm(points - via, axis=1).min() < arc.length / 1999.0


# -- joint paths ------------------------------------------------------------------------------------------------------


def planned(profile: Profile, model: CellModel, wanted: PathSpec) -> PathPlan:
    plan = plan_path(profile, model, wanted, PERIOD_S)
    assert plan.refusal == ""
    return plan


def distances_m(path: CartesianPath, points: Array) -> Array:
    """Distances (n,) [m] of points (n, 3) from a path, to half a micrometre."""
    vertices = path.positions(np.arange(0.0, path.length, 1e-6))
    return np.asarray(scipy.spatial.cKDTree(vertices).query(points)[0])


def assert_followed(profile: Profile, model: CellModel, plan: PathPlan) -> None:
    """The model's SMR keeps the tolerance at every sample and between them; no joint exceeds its rates or limits."""
    trajectory, path, wanted = plan.trajectory, plan.path, plan.spec
    assert trajectory is not None
    arm, kind = model.arms[wanted.arm], profile.arms[wanted.arm]
    speed, acceleration = trajectory.largest_rates()
    most = np.array([[joint.speed, joint.acceleration] for joint in kind.type.joints]) * kind.speed_scale
    assert (speed <= most[:, 0] * (1.0 + 1e-9)).all()
    assert (acceleration <= most[:, 1] * (1.0 + 1e-9)).all()
    # away from where joints turn round, the side of approach is the sign of the motion
    steps = np.diff(trajectory.q, axis=0)
    away = np.ones(len(steps), dtype=bool)
    for one in sure(plan.joints).reversals:
        away &= np.abs(trajectory.s[:-1] - one.at_m) > one.window_m + 2e-3
    signs = np.where(np.abs(steps) > 1e-9, np.sign(steps), 0.0)
    away &= (np.abs(steps) > 2e-6).all(axis=1)
    for share in (0.0, 0.5):
        q = trajectory.q[:-1] + share * steps
        smr = arm.predict(q[away], conditions=MeasurementConditions(approach=signs[away]))
        assert distances_m(sure(path), smr).max(initial=0.0) < wanted.tolerance
    cell, others = cell_bodies(profile, model), home_positions(profile)
    for row in np.linspace(0, len(trajectory.q) - 1, 5).astype(int):
        assert refuse_stop(cell, {**others, wanted.arm: trajectory.q[row]}) == ""


def test_the_example_paths_are_planned_for_both_arms(profile: Profile, model: CellModel) -> None:
    for wanted in load_paths(TWIN, profile):
        plan = planned(profile, model, wanted)
        assert_followed(profile, model, plan)
        assert sure(plan.joints).deviation_m < 0.1 * wanted.tolerance
        assert plan.nominal is not None
        np.testing.assert_array_equal(np.diff(sure(plan.trajectory).s) >= 0.0, True)


coordinates = st.floats(-0.12, 0.12)


@settings(max_examples=8)
@given(
    corner=st.tuples(coordinates, coordinates, coordinates),
    rotation=st.floats(-0.3, 0.3),
    speed=st.floats(0.02, 0.4),
    blend=st.sampled_from([0.0, 5.0]),
)
def test_random_small_paths_keep_tolerance_and_limits(
    profile: Profile, model: CellModel, corner: tuple[float, float, float], rotation: float, speed: float, blend: float
) -> None:
    base = np.array([0.0, -0.7, 0.6])
    middle = base + np.array(corner) + np.array([0.02, 0.0, 0.02])
    poses = [
        {"position": base.tolist(), "rpy": ["90 deg", 0, 0]},
        {"position": middle.tolist(), "rpy": [np.pi / 2.0 + rotation, 0, rotation], "blend": f"{blend} mm"},
        {"position": (base + np.array([0.0, 0.05, -0.08])).tolist()},
    ]
    try:
        wanted = spec(poses=poses, speed=speed)
    except ValueError:  # a blend longer than half of a piece
        return
    plan = plan_path(profile, model, wanted, PERIOD_S)
    if plan.refusal:
        assert plan.refusal.startswith("at ") or "home" in plan.refusal
        return
    assert_followed(profile, model, plan)


def test_a_joint_that_turns_round_crosses_its_play(profile: Profile, model: CellModel) -> None:
    there_and_back = spec(
        poses=[
            {"position": [-0.1, -0.75, 0.55], "rpy": ["90 deg", 0, 0]},
            {"position": [0.1, -0.75, 0.55]},
            {"position": [-0.1, -0.75, 0.55]},
        ]
    )
    plan = planned(profile, model, there_and_back)
    at_stop = [one for one in sure(plan.joints).reversals if one.at_m == pytest.approx(0.2)]
    assert at_stop
    assert all(one.jump_m > 0.0 and one.window_m == 0.0 for one in at_stop)
    lonely = replace(model, arms={name: replace(arm, effects=()) for name, arm in model.arms.items()})
    without = sure(planned(profile, lonely, there_and_back).joints)
    assert without.reversals == ()


def test_the_wanted_speed_is_kept_where_limits_allow_it(profile: Profile, model: CellModel) -> None:
    trajectory = sure(planned(profile, model, spec()).trajectory)
    speed = np.diff(trajectory.s) / PERIOD_S
    assert speed.max() == pytest.approx(0.1, rel=PERIOD_S / 2.0)  # the end falls on a sample
    assert trajectory.at_speed > 0.8
    assert trajectory.slowed == ""
    fast = sure(planned(profile, model, spec(speed="2500 mm/s", acceleration=9.0)).trajectory)
    assert np.diff(fast.s).max() / PERIOD_S < 2.5


# -- refusals ---------------------------------------------------------------------------------------------------------


def test_what_cannot_be_followed_is_refused_with_its_place(profile: Profile, model: CellModel) -> None:
    start = {"position": [-0.15, -0.75, 0.55], "rpy": ["90 deg", 0, 0]}
    cases = {
        "its beginning, at 0 mm, is out of reach": [{**start, "position": [5.0, 0, 0]}, start],
        "out of reach": [start, {"position": [-0.15, -3.0, 0.55]}],
        "floor": [start, {"position": [-0.15, -0.75, -0.15]}],
    }
    for words, poses in cases.items():
        plan = plan_path(profile, model, spec(poses=poses), PERIOD_S)
        assert words in plan.refusal
        assert plan.trajectory is None
        assert " mm" in plan.refusal


def test_a_bad_file_is_named_by_line_as_approved(tmp_path: Path, profile: Profile) -> None:
    """Words of the twin's paths are replaced."""
    path, text = tmp_path / "paths.yaml", TWIN.read_text("utf-8")

    def refused(good: str, bad: str) -> object:
        assert good in text
        path.write_text(text.replace(good, bad, 1), "utf-8")
        return load_paths(path, profile)

    assert_refused(Path(__file__).parent / "approved" / "wrong-files.txt", refused, tmp_path)


# -- Periodic motions: from rest to rest, derivatives as they are, limits kept -----------------------------------------


def drawn(seed: int = 0) -> Sweep:
    rng = np.random.default_rng(seed)
    return Sweep(rng.normal(size=6), rng.normal(size=(4, 6)), rng.normal(size=(4, 6)), 12.0)


def test_slowed_keeps_the_path_and_the_limits() -> None:
    motion = drawn()
    limits = np.full(6, 0.5), np.full(6, 0.4), np.full(6, 2.0)
    slower = motion.slowed(*limits)
    share = np.linspace(0.0, 1.0, 300)
    np.testing.assert_allclose(slower.at(share * slower.period_s), motion.at(share * motion.period_s), atol=1e-12)
    excess = [
        float((np.abs(slower.at(share * slower.period_s, order)) / limit).max())
        for order, limit in enumerate(limits, start=1)
    ]
    assert 0.9 < max(excess) <= 1.001
    assert slower.slowed(*limits).period_s == pytest.approx(slower.period_s, rel=1e-3)
