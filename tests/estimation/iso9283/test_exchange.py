"""Exchangeability against worked numbers."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.iso9283.exchange import exchangeability, exchanged
from cellapp.estimation.iso9283.records import IsoValue, PoseCharacteristics

pytestmark = pytest.mark.fast


def pose(name: str, error: tuple[float, float, float], expanded: float | None = 0.03) -> PoseCharacteristics:
    value = IsoValue(value_mm=1.0, expanded_mm=expanded, n=30)
    return PoseCharacteristics(pose=name, error_mm=error, accuracy=value, repeatability=value, deviations_mm=())


def test_the_largest_distance_of_two_arms_counts() -> None:
    means = np.array([[[0.0, 0.0, 0.0]], [[3.0, 4.0, 0.0]], [[0.0, 1.0, 0.0]]])
    np.testing.assert_allclose(exchangeability(means), [5.0])


def test_one_arm_is_refused() -> None:
    with pytest.raises(ValueError, match="two arms or more"):
        exchangeability(np.zeros((1, 5, 3)))


def test_two_tests_are_compared_pose_by_pose() -> None:
    own = (pose("P1", (1.0, 0.0, 0.0)), pose("P2", (0.0, 0.0, 0.0)), pose("P3", (9.0, 0.0, 0.0)))
    other = (pose("P2", (0.0, 3.0, 4.0), 0.04), pose("P1", (1.0, 1.0, 0.0)))
    found = exchanged(own, other, "runs/other")
    assert found is not None
    assert (found.pose, found.value.value_mm, found.value.n) == ("P2", 5.0, 30)
    assert found.value.expanded_mm == pytest.approx(0.05)
    unknown = exchanged(own[1:2], (pose("P2", (0.0, 1.0, 0.0), None),), "runs/other")
    assert unknown is not None
    assert unknown.value.expanded_mm is None
    assert exchanged(own, (pose("P5", (0.0, 0.0, 0.0)),), "runs/other") is None
