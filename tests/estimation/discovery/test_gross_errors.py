"""Gross errors of a few readings are left out and said; noise with heavy tails is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cellapp.estimation.calibration.calibrate import calibrate_arm, gross_errors
from cellapp.estimation.discovery.discover import discover_arm
from tests.evidence.shared.series import load_entrant

ROOT = Path(__file__).parents[3]


def test_heavy_tails_are_no_gross_errors_and_a_moved_target_is_one() -> None:
    left_M = 2e-5 * np.random.default_rng(1).standard_t(4, (400, 3))
    assert gross_errors(left_M).mean() <= 0.005
    left_M[7] += 2e-3
    assert gross_errors(left_M)[7]
    assert not gross_errors(np.zeros((5, 3))).any()


def test_discovery_of_a_real_arm_bears_gross_errors() -> None:
    ur5 = load_entrant("UR5")
    split = tuple("identify" if row % 8 == 0 else "validate" for row in range(len(ur5.readings)))
    readings = replace(ur5.readings, split=split)
    arm, _ = calibrate_arm(ur5.profile, ur5.arm, readings)
    plain = discover_arm(ur5.profile, ur5.arm, arm.model, readings)
    p_M = readings.p_M.copy()
    p_M[[80, 320, 640]] += np.array([[0.002, 0.0, 0.0], [0.0, -0.01, 0.0], [0.0, 0.0, 0.03]])
    disturbed = discover_arm(ur5.profile, ur5.arm, arm.model, replace(readings, p_M=p_M))
    disturbed_mm, plain_mm = (one.result.heldout_position_mm for one in (disturbed, plain))
    assert disturbed_mm is not None
    assert plain_mm is not None
    assert disturbed_mm.after.mean < 1.05 * plain_mm.after.mean
    assert "3 readings with gross errors were left out (configurations 80, 320, 640)" in disturbed.result.sentence
