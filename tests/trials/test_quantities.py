"""The trial of torques, with few stops."""

from __future__ import annotations

import numpy as np

from cellapp.cell.driving.cell import build_plant
from tests.trials.kinds import Bench
from tests.trials.quantities import NOISE_NM, Found, found_in, held_torques, lines


def test_effects_of_an_arm_with_torques_are_named_and_counted() -> None:
    bench = Bench(1, 60)
    profile = bench.profile()
    found = found_in(profile, bench.measured(profile), bench.truth())
    assert "joint_compliance" in found.names
    assert 0.9 < found.compliance < 1.1
    missed = Found((), 1.0, 1.0, float("nan"))
    wrong = Found(("backlash", "joint_compliance"), 1.0, 1.0, 1.1)
    table = list(lines({"points": [missed, wrong, wrong]}))
    assert table[1] == "points | 3 | 0 | 2 | 1.000 | 1.000 | 10.0%"


def test_drives_hold_the_arm_against_gravity() -> None:
    bench = Bench(1, 40)
    profile, q = bench.profile(), bench.q(40, 1)
    held = held_torques(profile, q, 1)
    raised = q.copy()
    raised[:, 0] += 1.0  # about the upright axis nothing changes
    assert np.abs(held[:, 0]).max() < 6.0 * NOISE_NM + 1.0
    assert np.abs(held_torques(profile, raised, 1) - held).max() < 2.0
    assert 30.0 < np.abs(held[:, 1]).max() < 200.0
    assert build_plant(profile).names == ("left",)
