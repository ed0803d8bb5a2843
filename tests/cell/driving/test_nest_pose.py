"""The orientation of a flange at rest, from several SMRs that are measured one after another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.nest_pose import NestPoses, turned_by
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.nests import NestShape
from cellapp.estimation.uncertainty.turn_budget import expanded_mrad, turn_budget
from drivers.trackers.protocol import Point
from tests.cell.driving.test_more_than_a_point import cell_with
from tests.twin import with_arm

pytestmark = pytest.mark.fast
SIGMA_M = 1e-5
SHAPE = NestShape(("A", "B", "C"), np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]), SIGMA_M)
TRUE = Rotation.from_rotvec([0.4, -1.1, 0.7])


def measured(seed: int) -> dict[str, Point]:
    """The nests at a place, with noise."""
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_M, (3, 3))
    places = np.array([2.0, -0.5, 0.3]) + TRUE.apply(SHAPE.points_S) + noise
    covariance = SIGMA_M**2 * np.eye(3)
    return {name: Point(p_M, covariance, 1.0, 0.5, 20.0) for name, p_M in zip(SHAPE.names, places, strict=True)}


def test_orientation_follows_with_its_uncertainty() -> None:
    off = []
    for seed in range(200):
        point = turned_by(SHAPE, measured(seed))
        assert point.quaternion_M is not None
        assert point.sigma_rad is not None
        off.append((Rotation.from_quat(point.quaternion_M, scalar_first=True) * TRUE.inv()).as_rotvec())
    largest = float(np.sqrt(np.linalg.eigvalsh(np.cov(np.array(off).T))[-1]))
    assert point.sigma_rad == pytest.approx(largest, rel=0.15)
    np.testing.assert_array_equal(point.p_M, measured(seed)["A"].p_M)


def test_two_nests_and_nests_that_moved_give_none() -> None:
    points = measured(1)
    assert turned_by(SHAPE, {name: points[name] for name in "AB"}).quaternion_M is None
    moved = {**points, "C": replace(points["C"], p_M=points["C"].p_M + np.array([0.0, 5e-4, 0.0]))}
    point = turned_by(SHAPE, moved)
    assert point.quaternion_M is None
    assert "do not stand as" in point.quality[0]


def test_figures_are_those_of_the_profile_until_readings_show_them() -> None:
    profile = cell_with()
    poses = NestPoses.of(profile, None, cell_bodies(profile), {})
    assert list(poses.shapes) == ["left"]
    assert set(poses.nests.cells["left"]) == {"B", "C"}
    smr = profile.arms["left"].smr
    nests = {**smr.nests, "C": smr.nests["C"].model_copy(update={"offset": "unknown"})}
    unknown = with_arm(profile, "left", smr=smr.model_copy(update={"nests": nests}))
    assert not NestPoses.of(unknown, None, cell_bodies(unknown), {}).shapes


def test_the_uncertainty_of_nests_is_their_scatter_about_the_model() -> None:
    lines = turn_budget(cell_with(), "left", 0.03, 0.14)
    assert [one.source for one in lines] == ["several SMRs", "calibrated model"]
    assert expanded_mrad(lines) == pytest.approx(2.0 * np.hypot(0.03, 0.14))
    lines = turn_budget(cell_with(), "right", 0.03, 0.14)  # a probe of 0.05 mrad
    assert [one.source for one in lines] == ["6-D probe", "repeatability of the arm", "calibrated model"]
    assert expanded_mrad(lines) == pytest.approx(2.0 * np.hypot(0.03, 0.14))
