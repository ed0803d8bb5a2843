"""The bound of a measured rotation, where its noise differs by axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.prediction import _with_noise, length_bounds
from cellapp.estimation.calibration.weights import readings_noise
from cellapp.robot.model.model import PosteriorDraws, posterior_from_json, posterior_to_json

pytestmark = pytest.mark.fast
AXES = np.array([5e-5, 6e-5, 2e-4])
DRAWS = PosteriorDraws((0,), np.zeros((4, 1)), (), 1e-5, float(np.sqrt(np.mean(AXES**2))), AXES)


def test_angles_of_several_smrs_keep_their_bound() -> None:
    rng = np.random.default_rng(1)
    turns = Rotation.random(4000, random_state=2)
    angles = np.linalg.norm(turns.apply(AXES * rng.standard_normal((4000, 3))), axis=1)
    true = 1e-12 * np.eye(3)[None]
    by_axis = length_bounds(_with_noise(true, DRAWS))[1][0]
    alike = length_bounds(_with_noise(true, replace(DRAWS, noise_axes_rad=None)))[1][0]
    assert np.mean(angles <= by_axis) == pytest.approx(0.95, abs=0.012)
    assert np.mean(angles <= alike) < 0.94


def test_the_noise_by_axis_is_stored_and_stated_where_it_differs() -> None:
    again = posterior_from_json(posterior_to_json(DRAWS)).noise_axes_rad
    assert again is not None
    np.testing.assert_array_equal(again, AXES)
    assert "noise_axes_rad" not in posterior_to_json(replace(DRAWS, noise_axes_rad=None))
    turned = np.array([False, True])
    sigma = np.array([1e-10 * np.eye(3), np.diag(AXES**2)])
    axes_rad = readings_noise(sigma, turned).axes_rad
    assert axes_rad is not None
    np.testing.assert_allclose(axes_rad, AXES)
    assert readings_noise(np.array([1e-5, 4e-5]), turned).axes_rad is None
    assert readings_noise(np.array([1e-10 * np.eye(3)] * 2), turned).axes_rad is None
