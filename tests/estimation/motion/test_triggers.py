"""Pulses of a hardware trigger tell the clocks' offset to a cycle, and which of several delays is meant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.motion.identify import RecordedArm, identify_from_motion
from cellapp.estimation.motion.streams import checked, triggered_clock
from cellapp.robot.kinematics.chain import nominal_geometry
from tests.estimation.motion.simulated import UR10, record, sweep, true_arm

PERIOD_S = 0.008
OFFSET_S, RATE_PPM = 412.3, 20.0


def apart(rng: np.random.Generator, first_s: float, last_s: float, count: int) -> np.ndarray:
    """Times at irregular distances."""
    step_s = (last_s - first_s) / count
    return np.asarray(first_s + step_s * (np.arange(count) + rng.uniform(0.1, 0.7, count)))


def pulses(rng: np.random.Generator, at_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps of both clocks: the controller's are those of its next cycle."""
    controller = np.ceil(at_s / PERIOD_S) * PERIOD_S
    return controller, OFFSET_S + (1.0 + 1e-6 * RATE_PPM) * at_s + rng.uniform(-5e-6, 5e-6, len(at_s))


@pytest.mark.fast
@pytest.mark.parametrize("span_s", [5.0, 600.0])
def test_the_offset_is_known_to_a_cycle(span_s: float) -> None:
    rng = np.random.default_rng(5)
    controller, tracker = pulses(rng, apart(rng, 0.0, span_s, 12))
    middle_s = OFFSET_S + 0.5 * span_s
    found = triggered_clock(controller, tracker, middle_s, PERIOD_S)
    assert found is not None
    true_s = OFFSET_S + 1e-6 * RATE_PPM * 0.5 * span_s
    assert abs(found.offset_s - true_s) < PERIOD_S
    assert PERIOD_S / 2.0 < found.standard_error_s < PERIOD_S
    assert found.pulses == 12
    check = checked(found, true_s, 1e-4)
    assert check is not None
    assert check.agrees
    far = checked(found, true_s + 0.04, 1e-4)
    assert far is not None
    assert not far.agrees
    assert checked(None, 0.0, 1.0) is None


@pytest.mark.fast
def test_pulses_may_be_missing_on_either_side_and_none_are_made_up() -> None:
    rng = np.random.default_rng(6)
    controller, tracker = pulses(rng, apart(rng, 0.0, 60.0, 12))
    found = triggered_clock(np.delete(controller, [0, 3, 7]), np.delete(tracker, [1, 11]), OFFSET_S + 30.0, PERIOD_S)
    assert found is not None
    assert found.pulses == 7
    assert abs(found.offset_s - OFFSET_S) < PERIOD_S
    assert triggered_clock(controller[:2], tracker, OFFSET_S, PERIOD_S) is None
    assert triggered_clock(np.empty(0), np.empty(0), OFFSET_S, PERIOD_S) is None
    assert triggered_clock(controller, rng.uniform(0.0, 1e4, 12), OFFSET_S, PERIOD_S) is None


def test_a_motion_that_repeats_is_placed_by_its_pulses_and_the_estimate_is_checked() -> None:
    rng = np.random.default_rng(7)
    arm = true_arm(rng)
    motion = sweep(rng, 6, base_hz=0.2)  # the same every 5 s
    one = record(rng, arm, motion, seconds=40.0, offset=OFFSET_S, rate_ppm=RATE_PPM)
    late = replace(one, points=replace(one.points, time_s=one.points.time_s + 5.0))  # a whole turn later
    controller, tracker = pulses(rng, apart(rng, 5.0, 35.0, 6))
    told = replace(
        late,
        joints=replace(late.joints, triggers_s=controller),
        points=replace(late.points, triggers_s=tracker + 5.0),
    )
    nominal = nominal_geometry(UR10, np.zeros(3))
    fit = identify_from_motion(RecordedArm(nominal, [told], tool_unknown=True))
    (clock,) = fit.clocks.values()
    assert clock.offset_s == pytest.approx(OFFSET_S + 5.0 + 20e-6 * 20.0, abs=2e-3)
    assert clock.trigger is not None
    assert clock.trigger.agrees
    assert abs(clock.trigger.difference_s) < PERIOD_S
    assert not any("the motion repeats" in sentence for sentence in fit.undetermined)
