"""Pictures of a fit: values of the terms, partial residuals, and the axis of each picture."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.accepted import dominant_cycles, pictures, term_movements
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectColumn, Wave, joint_column
from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.twin import PROFILES

N = 120
SIGMA_M = 10e-6
UP = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])


def wave_column(joint: int, count: int, sine: bool) -> EffectColumn:
    wave = Wave(count, sine)
    return joint_column(f"wave {count} {sine}", "rad", joint, np.zeros(2), -1.0, 1.0, wave=wave)


def test_cycles_hold_the_middle_of_the_power():
    waves = [(k, sine) for k in range(2, 12) for sine in (False, True)]
    columns = [wave_column(1, k, sine) for k, sine in waves]
    amplitudes = {3: 1.0, 5: 10.0, 6: 12.0, 9: 8.0, 11: 1.0}
    values = [-amplitudes.get(k, 0.0) * 1e-6 if sine else 0.0 for k, sine in waves]
    found = dominant_cycles([*columns, wave_column(0, 2, False)], np.array([*values, 4e-6]))
    assert list(found) == ["1", "2"]
    written = json.loads(found["1"].model_dump_json(by_alias=True))
    assert written == {"from": 2, "to": 2, "peak": 2, "rms_urad": pytest.approx(4.0 / math.sqrt(2.0))}
    assert (found["2"].first, found["2"].last, found["2"].peak) == (5, 9, 6)
    assert found["2"].rms_urad == pytest.approx(math.sqrt((1 + 100 + 144 + 64 + 1) / 2.0))


def test_columns_that_are_not_periodic_have_no_cycles():
    assert dominant_cycles([joint_column("half_play1", "rad", 0, np.ones(2), 0.0, 1.0)], np.ones(1)) == {}
    assert dominant_cycles([wave_column(0, 3, False), wave_column(0, 3, True)], np.zeros(2)) == {}


def fitted(bend, *terms, off_axis_m=0.1):
    """Data and a fit of ``terms`` to readings with joint offsets ``bend(q, approach)``."""
    profile = load_profile(PROFILES / "twin.yaml")
    geometry = nominal_arm(profile.arms["left"]).with_T_M_B(STATION)
    named = dict(zip(parameter_names(6), geometry.vector(), strict=True)) | {"tx": off_axis_m, "ty": 0.0}
    geometry = geometry.with_vector(np.array(list(named.values())))
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.5, 2.5, (N, 6))
    approach = rng.choice([-1, 1], (N, 6)).astype(np.int8)
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=60.0 * np.arange(N, dtype=np.float64),
        q=q,
        approach=approach,
        p_M=smr_positions(geometry, q + bend(q, approach)) + rng.normal(0.0, SIGMA_M, (N, 3)),
        sigma_m=np.full(N, SIGMA_M),
    )
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(profile.arms["left"]), up_M=UP)
    data = ArmData.of(profile, model, readings, measurement_conditions(readings))
    return data, fit_terms(data, tuple(terms))


def made(bend, *terms, off_axis_m=0.1):
    """Pictures of ``fitted``."""
    found = pictures(*fitted(bend, *terms, off_axis_m=off_axis_m))
    for picture in found:
        assert len(picture.x) == len(picture.measured) == len(picture.computed) == len(picture.band) > 0
        assert list(picture.x) == sorted(picture.x)
        assert min(picture.band) >= 0.0
        json.dumps(picture.model_dump(), allow_nan=False)
    return found


def only(joint, values):
    """Offsets of one joint (counted from 1)."""
    bent = np.zeros((len(values), 6))
    bent[:, joint - 1] = values
    return bent


def test_backlash_has_two_levels():
    part = ModelTerm("backlash", EFFECTS["backlash"].law("constant"), ("half_play2",))
    (picture,) = made(lambda q, approach: only(2, -2e-4 * approach[:, 1]), part)
    assert picture.title.endswith(", joint 2")
    assert picture.x_label == "approach direction of joint 2"
    assert picture.y_label == "offset of joint 2 [urad]"
    assert picture.curve is None
    assert set(picture.x) == {-1.0, 1.0}
    computed = np.array(picture.computed)
    assert np.abs(computed) == pytest.approx(200.0, abs=5.0 * picture.band[0])
    assert (np.sign(computed) == -np.sign(picture.x)).all()
    # the dots scatter about what was computed and hold it
    off = np.array(picture.measured) - computed
    assert abs(np.median(off)) < 10.0
    assert np.sqrt(np.mean(off**2)) < 60.0


def test_a_wave_has_its_curve_over_the_whole_turn():
    part = ModelTerm("transmission_error", EFFECTS["transmission_error"].law("lines"), ("cos3q1", "sin3q1"))
    (picture,) = made(lambda q, approach: only(1, 3e-4 * np.sin(3.0 * q[:, 0])), part)
    assert picture.x_label == "joint 1 [deg]"
    assert -180.0 <= picture.x[0] <= picture.x[-1] <= 180.0
    curve = picture.curve
    assert (curve.x[0], curve.x[-1]) == (-180.0, 180.0)
    off = np.array(curve.value) - 300.0 * np.sin(3.0 * np.radians(curve.x))
    assert (np.abs(off) < 5.0 * np.array(curve.band) + 0.1).all()
    assert np.interp(picture.x, curve.x, curve.value) == pytest.approx(picture.computed, abs=1.0)


def test_fast_lines_are_laid_over_one_another_and_slow_ones_are_not():
    names = tuple(f"{wave}{k}q2" for k in (2, 60, 120) for wave in ("cos", "sin"))
    part = ModelTerm("transmission_error", EFFECTS["transmission_error"].law("gear", {"ratio": 60.0}), names)
    slow, fast = made(lambda q, approach: only(2, 1e-4 * np.sin(2.0 * q[:, 1]) + 3e-4 * np.cos(60.0 * q[:, 1])), part)
    assert (slow.curve.x[0], slow.curve.x[-1]) == (-180.0, 180.0)
    assert np.ptp(slow.computed) == pytest.approx(200.0, rel=0.2)
    assert fast.x_label == "joint 2, within a cycle of 6 deg [deg]"
    assert "60 cycles per revolution" in fast.title
    assert 0.0 <= fast.x[0] <= fast.x[-1] <= 6.0 == fast.curve.x[-1]
    off = np.array(fast.curve.value) - 300.0 * np.cos(60.0 * np.radians(fast.curve.x))
    assert (np.abs(off) < 5.0 * np.array(fast.curve.band) + 0.1).all()


def test_a_drift_of_the_base_is_drawn_along_its_direction_against_time():
    law = EFFECTS["base_drift"].law("linear", {"first_s": 0.0, "last_s": 60.0 * (N - 1)})
    part = ModelTerm("base_drift", law, ("base_drift_x", "base_drift_y", "base_drift_z"))
    (picture,) = made(lambda q, approach: np.zeros((N, 6)), part)
    assert picture.x_label == "time [h]"
    assert picture.x[-1] == pytest.approx((N - 1) / 60.0, rel=1e-4)
    assert "of the tracker frame" in picture.title
    # nothing drifted: what was computed is within its own uncertainty
    assert np.abs(picture.computed).max() < 5.0 * max(picture.band)


def test_axes_that_wobble_are_drawn_one_by_one():
    names = tuple(f"wobble_{way}{joint}_{wave}" for joint in (1, 3) for way in "xy" for wave in ("cos", "sin"))
    first, second = made(
        lambda q, approach: np.zeros((N, 6)), ModelTerm("joint_axis_wobble", EFFECTS["joint_axis_wobble"].law(), names)
    )
    assert {first.x_label, second.x_label} == {"joint 1 [deg]", "joint 3 [deg]"}


def test_a_data_driven_term_is_drawn_against_each_of_its_variables():
    law = EFFECTS["unknown"].law(
        "joint 3|q1|time", {"order": 3.0, "order2": 2.0, "low2": 0.0, "high2": 60.0 * N, "typical2": 0.0}
    )
    part = ModelTerm("unknown", law, ("joint_3.sin1_q1", "joint_3.cos1_q1"))
    first, second = made(lambda q, approach: only(3, 2e-4 * np.sin(q[:, 0])), part)
    assert (first.x_label, second.x_label) == ("joint 1 [deg]", "time [h]")
    assert first.y_label == second.y_label == "offset of joint 3 [urad]"
    assert sorted(first.computed) == sorted(second.computed)
    law = EFFECTS["unknown"].law("tracker radial|range", {"order": 2.0, "low": 1.0, "high": 5.0, "typical": 3.0})
    (radial,) = made(lambda q, approach: np.zeros((N, 6)), ModelTerm("unknown", law, ("tracker_radial.p2_range",)))
    assert radial.x_label == "distance from the tracker [m]"
    assert "tracker radial" in radial.title


def test_a_joint_that_does_not_move_the_smr_has_no_picture():
    part = ModelTerm("backlash", EFFECTS["backlash"].law("constant"), ("half_play2", "half_play6"))
    for off_axis, seen in ((0.2, ["joint 2", "joint 6"]), (0.002, ["joint 2"])):
        found = made(lambda q, approach: np.zeros((N, 6)), part, off_axis_m=off_axis)
        assert sorted(picture.title[-7:] for picture in found) == seen


def test_the_joint_that_moves_the_smr_most_comes_first_in_pictures_and_movements():
    plays = {1: 20e-6, 2: 200e-6, 3: 100e-6}
    part = ModelTerm("backlash", EFFECTS["backlash"].law("constant"), tuple(f"half_play{joint}" for joint in plays))

    def bend(q, approach):
        return -approach * np.array([*plays.values(), 0.0, 0.0, 0.0])

    data, fit = fitted(bend, part)
    assert [picture.title[-7:] for picture in pictures(data, fit)] == ["joint 2", "joint 3", "joint 1"]
    movements = term_movements(fit, 0)
    assert [(place.where, place.parameters) for place in movements] == [
        (f"joint {joint}", (f"half_play{joint}",)) for joint in (2, 3, 1)
    ]
    # by finite displacements: the arm with and without the play of joint 2
    q, approach = data.readings.q, data.readings.approach
    turned = q - np.where(np.arange(6) == 1, 200e-6, 0.0) * approach
    moved = smr_positions(fit.model.geometry, turned) - smr_positions(fit.model.geometry, q)
    assert movements[0].moves_mm == pytest.approx(1e3 * np.sqrt(np.mean(np.sum(moved**2, axis=1))), rel=0.1)


def test_the_rms_of_a_curve_has_the_standard_error_of_its_coefficients():
    columns = [wave_column(0, 2, False), wave_column(0, 2, True), wave_column(1, 3, True)]
    values, covariance = np.array([3e-5, 4e-5, 1e-5]), np.diag([1e-6, 1e-6, 5e-6]) ** 2
    found = dominant_cycles(columns, values, covariance)
    drawn = np.random.default_rng(1).normal(values[:2], 1e-6, (20_000, 2))
    spread = np.sqrt(0.5 * np.sum(drawn**2, axis=1)).std() * 1e6
    assert found["1"].rms_standard_error_urad == pytest.approx(spread, rel=0.03)
    assert found["2"].rms_standard_error_urad == pytest.approx(5.0 / math.sqrt(2.0))
