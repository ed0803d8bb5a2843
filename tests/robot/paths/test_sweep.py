"""Periodic motions: from rest to rest, derivatives as they are, limits kept."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.robot.paths.sweep import Sweep


def drawn(seed: int = 0) -> Sweep:
    rng = np.random.default_rng(seed)
    return Sweep(rng.normal(size=6), rng.normal(size=(4, 6)), rng.normal(size=(4, 6)), 12.0)


def test_it_begins_and_ends_at_rest_at_its_center() -> None:
    motion = drawn()
    ends = np.array([0.0, motion.period_s, 3.0 * motion.period_s])
    np.testing.assert_allclose(motion.at(ends), np.tile(motion.center, (3, 1)), atol=1e-12)
    np.testing.assert_allclose(motion.at(ends, 1), 0.0, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_are_those_of_differences(order: int) -> None:
    motion, step = drawn(), 1e-5
    time_s = np.linspace(0.3, 11.0, 50)
    differences = (motion.at(time_s + step, order - 1) - motion.at(time_s - step, order - 1)) / (2.0 * step)
    np.testing.assert_allclose(motion.at(time_s, order), differences, rtol=1e-5, atol=1e-6)


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
