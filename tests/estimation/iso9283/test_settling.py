"""Stabilisation time, overshoot and posing time against a motion that is known."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.iso9283.evaluate_paths import PathTrack
from cellapp.estimation.iso9283.evaluate_settling import SettlingRuns, settling_characteristics
from cellapp.estimation.iso9283.settling import settled

pytestmark = pytest.mark.fast

TIME_S = np.arange(0.0, 4.0, 0.001)
BAND_M = 1e-4


def motion(amplitude_m: float, decay_s: float = 0.1, frequency_hz: float = 8.0) -> np.ndarray:
    """At rest for 0.5 s, 100 mm along x within 1 s, then a swing across that dies away."""
    x = 0.1 * np.clip(TIME_S - 0.5, 0.0, 1.0)
    after = np.maximum(TIME_S - 1.5, 0.0)
    swing = amplitude_m * np.exp(-after / decay_s) * np.sin(2.0 * np.pi * frequency_hz * after)
    return np.stack([x + swing, np.zeros(len(TIME_S)), np.zeros(len(TIME_S))], axis=1)


def test_a_swing_is_overshoot_and_takes_its_time_to_die_away() -> None:
    found = settled(TIME_S, motion(1e-3), BAND_M)
    assert found is not None
    after = np.maximum(TIME_S - 1.5, 0.0)
    swing = 1e-3 * np.exp(-after / 0.1) * np.sin(2.0 * np.pi * 8.0 * after)
    last = TIME_S[np.flatnonzero(np.abs(swing) > BAND_M)[-1]] + 0.001
    entered = 0.5 + (0.1 - BAND_M) / 0.1
    left = 0.5 + BAND_M / 0.1
    assert found.overshoot_m == pytest.approx(np.abs(swing).max(), rel=1e-6)
    assert found.stabilisation_s == pytest.approx(last - entered, abs=0.0021)
    assert found.posing_s == pytest.approx(last - left, abs=0.0021)


def test_an_arm_that_stops_dead_has_neither() -> None:
    found = settled(TIME_S, motion(0.0), BAND_M)
    assert found is not None
    assert (found.stabilisation_s, found.overshoot_m) == (0.0, 0.0)
    assert found.posing_s == pytest.approx(1.0 - 2.0 * BAND_M / 0.1, abs=0.0021)


@pytest.mark.parametrize("decay_s", [20.0], ids=["it never rests"])
def test_a_record_that_does_not_end_at_rest_says_nothing(decay_s: float) -> None:
    assert settled(TIME_S, motion(5e-3, decay_s), BAND_M) is None


def test_a_record_without_motion_says_nothing() -> None:
    assert settled(TIME_S, np.zeros((len(TIME_S), 3)), BAND_M) is None


def test_a_band_below_the_noise_is_widened() -> None:
    tracks = [PathTrack(TIME_S, motion(1e-3)), PathTrack(TIME_S, motion(2e-3))]
    runs = SettlingRuns(
        "left", "nominal", "P1", "P2", np.array([0.1, 0.0, 0.0]), 0.1, 1e-6, (40e-6) ** 2 * np.eye(3), 2, tracks
    )
    found = settling_characteristics(runs)
    assert found is not None
    assert found.band_mm == pytest.approx(0.2)
    assert found.overshoot.value_mm == pytest.approx(2.0 * 1e3 * np.abs(motion(1e-3)[:, 0] - motion(0.0)[:, 0]).max())
    assert found.overshoot.n == 2
    assert found.step_s == pytest.approx(0.001)
