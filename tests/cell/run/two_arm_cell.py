"""A small cell for the run's tests: two arms of two and three joints, no devices."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile


def two_arms() -> Profile:
    """Arm left with 2 joints, arm right with 3."""
    arms = {
        name: {
            "type": {"model": name, "joints": [{"d": 0.1, "a": 0.3}] * joints},
            "driver": {"kind": "none"},
            "smr": {"offset": "unknown"},
        }
        for name, joints in (("left", 2), ("right", 3))
    }
    return Profile.model_validate(
        {
            "schema": "cellapp-profile",
            "version": 1,
            "name": "two",
            "arms": arms,
            "tracker": {"driver": {"kind": "none"}},
        }
    )


def assert_same(first: Readings, second: Readings) -> None:
    """All that the two hold is the same, bit for bit (so that -0.0 is not 0.0, and NaN is NaN)."""
    for entry in fields(Readings):
        one, other = getattr(first, entry.name), getattr(second, entry.name)
        if isinstance(one, np.ndarray):
            assert isinstance(other, np.ndarray), entry.name
            assert (one.dtype, one.shape) == (other.dtype, other.shape), entry.name
            present = ~np.isnan(other)
            np.testing.assert_array_equal(~np.isnan(one), present, err_msg=entry.name)
            assert one[present].tobytes() == other[present].tobytes(), entry.name
        else:
            assert one == other, entry.name
