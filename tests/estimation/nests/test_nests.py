"""Nests on a flange: the figure they form, one reading a stop with its orientation, names that are exchanged."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.estimation.nests import StopGroups, by_stop, fit_shape
from cellapp.estimation.nests.shape import UnseenPair, better_names, outlying
from cellapp.estimation.readings import Readings, coordinate_uncertainty
from cellapp.ground.errors import NotConverged

pytestmark = pytest.mark.fast
NAMES = ("A", "B", "C")
OFFSETS = np.array([[0.045, 0.020, 0.060], [-0.05, 0.03, 0.06], [0.0, -0.08, 0.055]])
SIGMA = 2e-5


def measured(stops: int = 60, sigma: float = SIGMA, offsets: np.ndarray = OFFSETS, seed: int = 0) -> Readings:
    """Rows of all nests at random flange poses."""
    rng = np.random.default_rng(seed)
    count = len(offsets)
    rotation = Rotation.random(stops, random_state=seed).as_matrix()
    origin = rng.uniform(-1.0, 1.0, (stops, 3)) + np.array([3.0, 0.0, 0.0])
    points = np.einsum("sab,kb->ska", rotation, offsets) + origin[:, None]
    points = points + sigma * rng.standard_normal(points.shape)
    return Readings(
        configuration=np.repeat(np.arange(stops), count),
        time_s=np.arange(stops * count, dtype=np.float64),
        q=np.repeat(rng.uniform(-1.0, 1.0, (stops, 6)), count, axis=0),
        approach=np.zeros((stops * count, 6), dtype=np.int8),
        p_M=points.reshape(-1, 3),
        sigma_m=np.full(stops * count, SIGMA),
        smr=tuple("ABCD"[place] for _ in range(stops) for place in range(count)),
        extras={"rotation": tuple(str(rotation[s].ravel().tolist()) for s in range(stops) for _ in range(count))},
    )


def true_rotations(readings: Readings) -> np.ndarray:
    return np.array([np.array(json.loads(text)).reshape(3, 3) for text in readings.extras["rotation"]])


def test_the_figure_and_its_noise_are_found() -> None:
    shape, _ = fit_shape(StopGroups.of(measured(200), NAMES))
    shape = shape.turned_like(OFFSETS)
    np.testing.assert_allclose(shape.points_S, OFFSETS - OFFSETS[0], atol=1.5e-5)
    assert shape.noise_m == pytest.approx(SIGMA, rel=0.1)


def test_orientations_have_the_errors_that_are_stated() -> None:
    stops = by_stop(measured(400), NAMES, OFFSETS)
    one = stops.readings
    assert len(one) == 400
    assert one.smr is None
    assert one.quaternion_M is not None
    assert one.sigma_rad is not None
    found = Rotation.from_quat(np.roll(one.quaternion_M, -1, axis=1))
    off = (found * Rotation.from_matrix(true_rotations(one)).inv()).as_rotvec()
    assert one.turning_covariance_M is not None
    chi = np.einsum("na,nab,nb->n", off, np.linalg.inv(one.turning_covariance_M), off)
    assert chi.mean() == pytest.approx(3.0, rel=0.15)
    # sigma_rad is of the axis that is known least; the others are better by up to the root of two
    assert np.mean(np.abs(off) < 1.96 * one.sigma_rad[:, None]) > 0.95


def test_the_first_nest_is_better_known_than_from_its_own_row() -> None:
    one = by_stop(measured(50), NAMES, OFFSETS).readings
    sigma_m = coordinate_uncertainty(one)
    assert sigma_m is not None
    assert np.all(sigma_m < SIGMA)
    assert np.all(sigma_m > 0.5 * SIGMA)


def test_a_stop_without_enough_nests_has_a_position_only_or_is_left_out() -> None:
    rows = measured(20)
    keep = [row for row in range(60) if row not in (1, 3, 5)]  # stop 0 without B, stop 1 without A and C
    stops = by_stop(rows.take(keep), NAMES, OFFSETS)
    assert stops.left_out.tolist() == [False, True, *[False] * 18]
    assert stops.readings.configuration.tolist() == [0, *range(2, 20)]
    assert stops.readings.quaternion_M is not None
    assert np.isnan(stops.readings.quaternion_M[0]).all()
    np.testing.assert_array_equal(stops.readings.p_M[0], rows.p_M[0])


def test_exchanged_names_at_a_stop_are_named() -> None:
    rows = measured(30)
    words = list(rows.smr or ())
    words[3 * 7 + 1], words[3 * 7 + 2] = "C", "B"
    rows = replace(rows, smr=tuple(words))
    groups = StopGroups.of(rows, NAMES)
    shape, misfit = fit_shape(groups)
    assert np.flatnonzero(outlying(misfit)).tolist() == [7]
    assert better_names(shape, groups.p_M[7]) == ("A", "C", "B")


def test_four_nests_tell_their_handedness() -> None:
    offsets = np.vstack([OFFSETS, [0.02, 0.03, 0.12]])
    shape, misfit = fit_shape(StopGroups.of(measured(40, offsets=offsets), ("A", "B", "C", "D")))
    np.testing.assert_allclose(shape.turned_like(offsets).points_S, offsets - offsets[0], atol=3e-5)
    assert np.nanmax(misfit) < 1e-4


def test_nests_that_were_never_measured_together_give_positions_only() -> None:
    rows = measured(20)
    keep = [row for row in range(60) if row % 3 != (1 if row < 30 else 2)]
    with pytest.raises(UnseenPair, match="B and C were never measured at the same stop"):
        fit_shape(StopGroups.of(rows.take(keep), NAMES))
    stops = by_stop(rows.take(keep), NAMES, OFFSETS)
    assert stops.shape is None
    assert len(stops.readings) == 20
    assert stops.readings.quaternion_M is None


def test_readings_without_a_stated_uncertainty_take_that_of_the_figure() -> None:
    one = by_stop(replace(measured(100), sigma_m=None), NAMES, OFFSETS).readings
    stated = by_stop(measured(100), NAMES, OFFSETS).readings
    assert coordinate_uncertainty(one) is None
    assert one.sigma_rad is not None
    assert stated.sigma_rad is not None
    np.testing.assert_allclose(one.sigma_rad, stated.sigma_rad, rtol=0.15)


def test_a_figure_that_does_not_settle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.estimation.nests.shape._ROUNDS", 1)
    with pytest.raises(NotConverged, match="fit of the nests on a flange did not converge"):
        fit_shape(StopGroups.of(measured(60), NAMES))
