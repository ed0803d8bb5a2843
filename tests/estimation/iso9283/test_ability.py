"""What a tracker can tell of a tolerance, before measuring."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.iso9283.ability import Instrument, ability, ability_words, least_shown_mm
from cellapp.estimation.uncertainty.records import Characteristic

SIGMA_M = 10e-6


def instrument(per_metre: float = SIGMA_M, frame: float = 0.0) -> Instrument:
    """A tracker with a standard uncertainty that is proportional to the distance."""
    return Instrument(lambda d: (per_metre * d) ** 2 * np.eye(3), 1.0, frame**2 * np.eye(3))


@pytest.mark.fast
def test_what_an_arm_without_error_shows_is_the_trackers_own_scatter() -> None:
    """RP of normal scatter: mean and three deviations of a Maxwell distribution; most of it counts as uncertain."""
    rp_mm = 1e3 * SIGMA_M * (1.5958 + 3.0 * 0.6734)
    shown = least_shown_mm("pose_repeatability", instrument(), 1.0, 100)
    assert 1.6 * rp_mm < shown < 2.3 * rp_mm
    assert least_shown_mm("pose_repeatability", instrument(), 3.0, 100) == pytest.approx(3.0 * shown, rel=0.02)


@pytest.mark.fast
@pytest.mark.parametrize(
    "characteristic",
    ["pose_accuracy", "multidirectional", "distance_accuracy", "distance_repeatability", "drift", "cooperative"],
)
def test_every_characteristic_grows_with_the_distance(characteristic: Characteristic) -> None:
    near, far = (least_shown_mm(characteristic, instrument(), d, 10) for d in (1.0, 2.0))
    assert far == pytest.approx(2.0 * near, rel=0.1)


def test_a_distance_that_would_do_is_named_and_does() -> None:
    tracker = instrument()
    limit = least_shown_mm("pose_repeatability", tracker, 2.0, 30)
    found = ability("pose_repeatability", "arm left", tracker, 4.0, 30, 1.001 * limit)
    assert found.shown_mm > found.tolerance_mm
    assert found.distance_that_does_m == pytest.approx(2.0, abs=0.1)
    assert found.distance_that_does_m is not None
    assert least_shown_mm("pose_repeatability", tracker, found.distance_that_does_m, 30) <= found.tolerance_mm
    words = ability_words(found)
    assert "is below what the tracker can tell at 4.0 m with 30 cycles" in words
    assert "a tracker at 2.0 m or nearer" in words or "a tracker at 1.9 m or nearer" in words


def test_a_number_of_cycles_that_would_do_is_named() -> None:
    tracker = instrument()
    limit = least_shown_mm("multidirectional", tracker, 4.0, 100)
    found = ability("multidirectional", "arm left", tracker, 4.0, 5, 1.01 * limit)
    assert found.cycles_that_do == 100
    assert "100 cycles would do" in ability_words(found)


@pytest.mark.fast
def test_a_base_that_is_not_known_better_is_helped_by_nothing() -> None:
    found = ability("pose_accuracy", "arm left", instrument(1e-9, frame=1e-3), 4.0, 30, 0.1)
    assert (found.distance_that_does_m, found.cycles_that_do) == (None, None)
    assert "neither a nearer tracker nor more cycles would do" in ability_words(found)


@pytest.mark.fast
def test_nothing_is_said_of_a_tolerance_that_can_be_told() -> None:
    found = ability("pose_repeatability", "arm left", instrument(), 4.0, 30, 10.0)
    assert (found.distance_that_does_m, found.cycles_that_do) == (None, None)
    assert ability_words(found) == ""
