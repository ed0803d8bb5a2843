"""Recordings of strangers from their files to a calibration, a short one of each kind."""

from __future__ import annotations

import pytest

from tests.trials.stranger import one_stranger


@pytest.mark.parametrize("kind", ["ur5", "seven"])
def test_recordings_of_strangers_lead_to_a_calibration(kind):
    found = one_stranger(kind, 1, 50.0)
    assert abs(found.delay_ms) < 1.0
    assert found.heldout_mm < 0.15 < found.nominal_mm + 0.1
    assert abs(found.rate_ppm) < 60.0
