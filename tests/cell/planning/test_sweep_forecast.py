"""What stops and sweeps are expected to tell of an arm before anything moves."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.sweeps import SweepDesign
from cellapp.robot.paths.sweep import Sweep
from tests.twin import small_twin


@pytest.fixture(scope="module")
def profile():
    return small_twin()


def test_what_a_sweep_tells_is_of_the_effects_that_the_plan_is_for(profile):
    """A joint that turns far and evenly tells of its lines; one that hardly moves tells nothing of them."""
    q = np.array(profile.arms["left"].home) + np.random.default_rng(3).uniform(-0.5, 0.5, (12, 6))
    rows = np.zeros((4, 6))
    still, lively = rows.copy(), rows.copy()
    still[0, 5] = 0.3
    lively[:, 0] = 0.3
    told = {}
    for slugs in ((), ("transmission_error",), ("transmission_error", "backlash")):
        plan = profile.plan.model_copy(update={"effects": slugs})
        design = SweepDesign.of(profile.model_copy(update={"plan": plan}), "left")
        before = design.before(q, np.ones_like(q))
        assert np.isfinite(before).all()
        gains = [
            np.linalg.slogdet(before + design.told(Sweep(q[0], sine, rows, 20.0)))[1] - np.linalg.slogdet(before)[1]
            for sine in (still, lively)
        ]
        told[slugs] = gains[1] - gains[0]
        assert gains[1] > gains[0] > 0.0
    assert told[()] < told["transmission_error",] < told["transmission_error", "backlash"]
