"""What is stated of a command beforehand: bounds of the error, its parts, unknown conditions, extrapolation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.targets.prediction import length_bounds, outside_notes, predicted_verdict, predictions, spread_of
from cellapp.cell.targets.ranges import ConditionRanges, MeasuringNoise, unknown_conditions
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import PosteriorSamples, ReadingsNoise
from tests.arms import effect_term
from tests.sure import sure

HOME = np.array([0.0, -1.2, 0.8, -1.4, 0.9, 0.0])
NOTHING = MeasurementConditions()


@pytest.fixture(scope="module")
def arm(model: CellModel) -> ArmModel:
    """An arm with geometry alone, and draws of its base's height and of one joint zero."""
    own = model.arms["left"]
    draws = np.random.default_rng(0).standard_normal((64, 2)) * np.array([2e-5, 1e-5])
    return replace(own, effects=(), network=None, posterior=PosteriorSamples((2, 16), draws, (), ReadingsNoise(1.5e-5)))


def configurations(n: int) -> np.ndarray:
    return HOME + np.random.default_rng(1).uniform(-0.5, 0.5, (n, 6))


def test_bounds_of_published_cases() -> None:
    """Of one, two and three equal weights: quantiles of chi with as many degrees of freedom (tables)."""
    shapes = np.array([np.diag(d) for d in ([1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0])])
    low, high = length_bounds(shapes)
    np.testing.assert_allclose(high, [1.95996, 2.44775, 2.79548], rtol=1e-4)
    np.testing.assert_allclose(low, [0.06271, 0.32029, 0.59317], rtol=1e-3)
    assert not np.any(length_bounds(np.zeros((2, 3, 3))))


def test_a_verdict_is_about_the_true_position() -> None:
    assert [predicted_verdict(0.01, 0.05, size) for size in (0.05, 0.049, 0.01, 0.0099, None)] == [
        "in",
        "not decided",
        "not decided",
        "out",
        "",
    ]


def test_stated_distances_hold_for_errors_sampled_from_the_model(arm: ArmModel) -> None:
    q = configurations(40)
    assert arm.posterior is not None
    known = predictions(arm, q, NOTHING, [None] * 40, HOME, ConditionRanges())
    stated = np.array([one.within_mm for one in known if one is not None])
    rng = np.random.default_rng(5)
    drawn = replace(arm.posterior, geometry=rng.standard_normal((4000, 2)) * arm.posterior.geometry.std(axis=0))
    moved = drawn.displacements(arm.geometry, (), arm.context(q)) + rng.standard_normal((4000, 40, 3)) * 1.5e-5
    assert np.mean(np.linalg.norm(moved, axis=2) * 1e3 <= stated) == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize(
    ("slug", "values", "law", "condition", "key", "ends"),
    [
        ("joint_compliance", {"compliance2": 1.0 / 6e4}, (), "payload", "payload_kg", (0.0, 5.0)),
        ("thermal_growth", {"growth": 1e-5}, ("air", {"mean_c": 21.0}), "temperature", "air_c", (18.0, 26.0)),
        ("base_drift", {"base_drift_x": 6e-5}, ("linear", {"first_s": 0, "last_s": 9e3}), "time", "time_s", (0.0, 9e3)),
    ],
)
def test_unknown_payload_temperature_and_time(
    arm: ArmModel, slug: str, values: dict[str, float], law: Any, condition: str, key: str, ends: Any
) -> None:
    with_effect = replace(arm, effects=(effect_term(slug, values, "", law=EFFECTS[slug].law(*law)),))
    q, ranges = configurations(5), ConditionRanges(**{key: ends})
    (found,) = unknown_conditions(with_effect, q, NOTHING, ranges)
    assert found.condition == condition
    assert found.largest_m.max() > 1e-5
    stated = [MeasurementConditions(**{key: one * np.ones(5)}) for one in (ends[1], ends[1] + 1.0)]
    covered, beyond = (unknown_conditions(with_effect, q, one, ranges) for one in stated)
    assert covered == []
    assert [np.sqrt(np.trace(one.covariance[0])) for one in beyond] == pytest.approx(
        [6e-5 * np.sqrt(0.375)] if condition == "time" else []
    ), "a drift goes on after the readings: as uncertain as over their time"
    assert unknown_conditions(with_effect, q, NOTHING, ConditionRanges()) == [], "the run covered one value"


class Waves:
    """A correction with a spread, which fades out beyond its range as a residual network's does."""

    def correct(self, q: np.ndarray) -> np.ndarray:
        return np.tile([2e-4, 0.0, 0.0], (len(q), 1)) * (np.abs(q[:, :1] - HOME[0]) < 0.6)

    def spread(self, q: np.ndarray) -> np.ndarray:
        return np.full((len(q), 3), 1e-5) * (np.abs(q[:, :1] - HOME[0]) < 0.6)


def test_beyond_the_readings_extrapolation_is_a_part_of_its_own(arm: ArmModel) -> None:
    network: Any = Waves()
    ranges = ConditionRanges(q=np.stack([HOME - 0.5, HOME + 0.5]))
    far, near = HOME + np.array([[1.0, 0, 0, 0, 0, 0]]), HOME[None]
    with_network = replace(arm, network=network)
    inside, outside = (spread_of(with_network, q, NOTHING, ranges) for q in (near, far))
    assert not inside.extrapolation.any()
    bare = spread_of(arm, far, NOTHING, ranges)
    lost = np.trace(outside.extrapolation[0] - bare.extrapolation[0])
    np.testing.assert_allclose(lost, 2e-4**2, rtol=1e-9, err_msg="what the network no longer corrects, in full")
    np.testing.assert_allclose(np.trace(outside.network[0]), 3e-10)
    np.testing.assert_allclose(np.trace(bare.of_model[0]), 3.0 * arm.uncertainty(far)[0] ** 2)
    notes = outside_notes(np.vstack([near, far]), NOTHING, ranges, [None, None], 0.3)
    assert notes == ["", "outside the calibrated joint ranges: joint 1 by 27 deg"]


def test_what_a_measurement_finds_is_judged_with_all_of_its_scatter(arm: ArmModel) -> None:
    q = configurations(1)
    tolerance = [0.045]
    exact = MeasuringNoise(along=(1.5e-5, 0.0), across=(1.5e-5, 0.0), typical=1.5e-5**2)
    better = MeasuringNoise(along=(1e-6, 0.0), across=(1e-6, 0.0), typical=1e-12)
    (of_tracker,) = predictions(arm, q, NOTHING, tolerance, HOME, ConditionRanges(noise=exact))
    (of_arm,) = predictions(arm, q, NOTHING, tolerance, HOME, ConditionRanges(noise=better))
    assert of_tracker is not None
    assert of_arm is not None
    assert of_tracker.within_mm == pytest.approx(of_arm.within_mm, rel=1e-6)
    assert of_tracker.uncertainty_mm == of_arm.uncertainty_mm
    assert (of_tracker.verdict, of_arm.verdict) == ("not decided", "not decided")
    bound = [of_tracker.within_mm]
    (met,) = predictions(arm, q, NOTHING, bound, HOME, ConditionRanges(noise=exact))
    assert sure(met).verdict == "in", "the bound that the row states decides"
