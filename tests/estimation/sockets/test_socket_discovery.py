"""Discovery from a ball in sockets: elastic joints are found and predict other places; noise gives no names."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.calibration.socket_identification import OF_THE_TRACKER
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.cross_validation import may_leave_placements_out, placement_gains
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.joint_fit import fit_terms
from tests.estimation.sockets.led_arm import ELASTIC, led, panda


def test_elastic_joints_are_named_and_predict_other_places() -> None:
    arm = led(3, elastic=True, gauge_m=0.1)
    calibrated, _ = calibrate_arm(panda(), "left", arm.readings)
    found = discover_arm(panda(), "left", calibrated.model, arm.readings)
    assert [term.slug for term in found.terms] == ["joint_compliance"]
    held_out = found.result.heldout_position_mm
    assert held_out is not None
    assert held_out.after.mean < 0.1
    assert held_out.after.mean < 0.7 * held_out.before.mean
    term = found.terms[0]
    by_name = dict(zip(term.names, term.values.tolist(), strict=True))
    stiffness = ELASTIC["joint_compliance"]["stiffness"]
    for joint in (2, 3, 4):
        np.testing.assert_allclose(by_name[f"compliance{joint}"], 1.0 / stiffness[joint - 1], rtol=0.35)
    gauge = found.result.validate_["effects"].gauge_mm
    assert gauge is not None
    assert gauge.mean < 0.1


def test_a_stiff_arm_gets_no_names_and_no_tracker_is_blamed() -> None:
    arm = led(1, gauge_m=0.1)
    calibrated, _ = calibrate_arm(panda(), "left", arm.readings)
    found = discover_arm(panda(), "left", calibrated.model, arm.readings)
    assert not found.terms
    assert found.result.verdict == "nothing missing"
    blind = {one.effect: one.reason for one in found.result.invisible}
    assert all("no tracker" in blind[slug] for slug in OF_THE_TRACKER)


def test_left_out_placements_count_by_their_scatter_about_their_own_points() -> None:
    arm = led(1, gauge_m=0.1)
    calibrated, _ = calibrate_arm(panda(), "left", arm.readings)
    learn = arm.readings.take(arm.readings.in_split("identify"))
    data = ArmData.of(panda(), calibrated.model, learn, measurement_conditions(learn))
    fit = fit_terms(data, ())
    assert may_leave_placements_out(data)
    # a shift that is the same at both points of a block is no more than another place of the block
    of_block = np.array([float(str(name).startswith("place0")) for name in learn.point or ()])
    shift = np.concatenate([of_block, np.zeros(2 * len(learn))])[None]
    gains = placement_gains(data, fit, shift)
    assert gains.shape == (4,)
    np.testing.assert_allclose(gains, 0.0, atol=1e-6)
