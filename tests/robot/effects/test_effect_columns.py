"""Every column of an effect against a chain that is displaced, heated, loaded or bent numerically."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.robot.effects import EFFECTS, Effect, EffectContext, Law, MeasurementConditions
from cellapp.robot.effects.law import AMPLITUDE, LENGTH
from cellapp.robot.kinematics.transforms import rotation_from_vector, rotation_x, rotation_y, transform
from tests.robot.effects.cell import EYE, by_name, chain, context_of, offsets, shifts, slope, under
from tests.sure import sure

GRAVITY = 9.80665
CONTEXT = context_of(10)
RUN = context_of(60, seed=3)
CONDITIONS: Any = CONTEXT.conditions
RUN_CONDITIONS: Any = RUN.conditions


def laws(slug, name, context=CONTEXT):
    return [law for law in EFFECTS[slug].laws(context) if law.name == name]


def columns(slug, law=None, context=CONTEXT):
    """Columns by name under a law: itself, its name, or the only one of the effect."""
    law = law if isinstance(law, Law) else EFFECTS[slug].law(*filter(None, [law]))
    return by_name(EFFECTS[slug].columns(context, law))


def each_row(moved, context=CONTEXT, h=1e-5):
    """Derivative (n, 3) of ``moved(row, h)``, an SMR position."""
    return np.array([slope(partial(moved, row), h) for row in range(len(context))])


# -- wobble ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [1, 3, 6])
@pytest.mark.parametrize(("letter", "axis"), [("x", EYE[0]), ("y", EYE[1])])
@pytest.mark.parametrize(("wave", "function"), [("cos", np.cos), ("sin", np.sin)])
def test_an_axis_tilts_twice_a_turn(joint, letter, axis, wave, function):
    def moved(row, h):
        return chain(CONTEXT, row, twist={joint - 1: h * function(2.0 * CONTEXT.q[row, joint - 1]) * axis}).smr

    found = columns("joint_axis_wobble")
    column = found[f"wobble_{letter}{joint}_{wave}"]
    assert column.block == column.where == f"joint {joint}"
    np.testing.assert_allclose(shifts(column), each_row(moved), atol=1e-9)
    assert len(found) == 24


# -- thermal ---------------------------------------------------------------------------------------------------------


def grown(strain_of):
    """Derivative of the SMR by a strain (N,) of each row's links."""
    return each_row(lambda row, h: chain(CONTEXT, row, strain=h * strain_of(row)).smr)


def test_links_grow_with_the_air():
    warmer = CONDITIONS.air_c - CONDITIONS.air_c.mean()
    whole = columns("thermal_growth", laws("thermal_growth", "air")[0])
    assert list(whole) == ["growth"]
    assert (whole["growth"].lower, whole["growth"].upper, whole["growth"].unit) == (0.0, 4e-5, "1/K")
    np.testing.assert_allclose(shifts(whole["growth"]), grown(lambda row: np.full(6, warmer[row])), atol=1e-9)
    links = columns("thermal_growth", laws("thermal_growth", "air_links")[0])
    assert list(links) == [f"growth{i}" for i in range(1, 7)]
    for i in range(6):
        np.testing.assert_allclose(
            shifts(links[f"growth{i + 1}"]), grown(lambda row, i=i: warmer[row] * np.eye(6)[i]), atol=1e-9
        )


# -- base and tool ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(3))
def test_a_target_slips_in_the_flange(axis):
    moved = each_row(lambda row, h: chain(RUN, row, tool=h * EYE[axis]).smr, RUN)
    law = laws("target_slip", "onset", RUN)[20]
    column = columns("target_slip", law, RUN)[f"slip_{'xyz'[axis]}"]
    assert column.block == column.where == "tool"
    np.testing.assert_allclose(
        shifts(column), moved * (RUN_CONDITIONS.time_s >= law.constants["onset_s"])[:, None], atol=1e-9
    )


@given(st.lists(st.sampled_from([0.0, 1.0, 2.5, 7.0, 8.0, 100.0, 250.0]), min_size=1, max_size=60), st.integers(0, 400))
def test_onsets_leave_readings_on_both_sides(moments, more):
    time = np.array([*moments, *np.linspace(0.0, 300.0, more)])
    q = np.zeros((len(time), 6))
    found = EFFECTS["base_step"].laws(replace(RUN, q=q, conditions=MeasurementConditions(time_s=time)))
    assert len(found) <= 120
    assert {law.tried for law in found} <= {len(found)}
    onsets = np.array([law.constants["onset_s"] for law in found])
    assert (np.diff(onsets) > 0.0).all()
    for onset in onsets:
        assert np.count_nonzero(time < onset) >= 8
        assert np.count_nonzero(time >= onset) >= 8


# -- pedestals -------------------------------------------------------------------------------------------------------


def own_moment(row):
    """Moment of gravity about the base's origin (3,) [Nm] in the tracker frame, body by body."""
    walked = chain(CONTEXT, row)
    origin = walked.frames[0][:3, 3]
    loads = [
        (mass, pose[:3, :3] @ center + pose[:3, 3])
        for mass, pose, center in zip(CONTEXT.bodies.masses, walked.frames[1:], CONTEXT.bodies.centers, strict=True)
    ]
    end = walked.frames[-1]
    loads.append((CONDITIONS.payload_kg[row], end[:3, :3] @ CONTEXT.bodies.payload_center + end[:3, 3]))
    return sum(np.cross(center - origin, -mass * GRAVITY * CONTEXT.up_M) for mass, center in loads)


def about(point, rotation):
    """The arm as a whole turned by a small ``rotation`` (3,) about a ``point`` (3,), both in the tracker frame."""
    R = rotation_from_vector(rotation)
    return transform(R, point - R @ point)


def test_a_pedestal_tilts_with_the_arms_moment():
    def moved(row, h):
        return chain(CONTEXT, row, outside=about(CONTEXT.geometry.T_M_B()[:3, 3], h * own_moment(row))).smr

    found = columns("pedestal_compliance", "isotropic")
    assert list(found) == ["pedestal_tilt"]
    np.testing.assert_allclose(shifts(found["pedestal_tilt"]), each_row(moved, h=1e-7), atol=1e-5)
    parts = columns("pedestal_compliance", "tilt")
    assert [column.block for column in parts.values()] == ["base", "base"]
    np.testing.assert_allclose(
        sum(shifts(column) for column in parts.values()), shifts(found["pedestal_tilt"]), atol=1e-9
    )


@pytest.mark.parametrize("rotation", [rotation_x(np.pi), rotation_x(np.pi / 2.0), rotation_y(np.pi / 2.0)])
def test_a_pedestal_on_a_wall_or_under_a_ceiling(rotation):
    """The whole moment counts, for any mounting of the arm."""
    up = rotation.T @ CONTEXT.geometry.T_M_B()[:3, 2]
    context = replace(CONTEXT, up_M=up)
    origin = context.geometry.T_M_B()[:3, 3]
    moments = context.loads.beyond(0)[1]
    np.testing.assert_allclose(moments @ up, 0.0, atol=1e-9)
    expected = np.cross(moments, context.p_M - origin)
    np.testing.assert_allclose(
        shifts(columns("pedestal_compliance", "isotropic", context)["pedestal_tilt"]), expected, atol=1e-9
    )


def test_a_pedestal_tilts_with_the_other_arm():
    other = CONDITIONS.other_moment_M
    above = other - other.mean(axis=0)
    isotropic, tilt, general = EFFECTS["pedestal_coupling"].laws(CONTEXT)
    assert [law.name for law in (isotropic, tilt, general)] == ["isotropic", "tilt", "general"]
    level = CONTEXT.up_M
    above = above - (above @ level)[:, None] * level
    origin = CONTEXT.geometry.T_M_B()[:3, 3]
    found = columns("pedestal_coupling", isotropic)
    np.testing.assert_allclose(shifts(found["coupling"]), np.cross(above, CONTEXT.p_M - origin), atol=1e-9)
    four = columns("pedestal_coupling", tilt)
    assert list(four) == [f"coupling_tilt_{way}_{by}" for way in "xy" for by in "xy"]
    both = shifts(four["coupling_tilt_x_x"]) + shifts(four["coupling_tilt_y_y"])
    np.testing.assert_allclose(both, shifts(found["coupling"]), atol=1e-9)
    ten = columns("pedestal_coupling", general)
    assert len(ten) == 10
    assert {column.block for column in ten.values()} == {"base"}
    base = CONTEXT.geometry.T_M_B()[:3, :3]
    x = base[:, 0] - (base[:, 0] @ level) * level
    x /= np.linalg.norm(x)
    np.testing.assert_allclose(
        shifts(ten["coupling_shift_z_y"]), (above @ np.cross(level, x))[:, None] * base[:, 2], atol=1e-9
    )
    np.testing.assert_allclose(
        shifts(four["coupling_tilt_y_x"]),
        (above @ x)[:, None] * np.cross(np.cross(level, x), CONTEXT.p_M - origin),
        atol=1e-9,
    )


# -- beams -----------------------------------------------------------------------------------------------------------


def test_a_horizontal_cantilever_hangs_down():
    """Textbook: F L^3 / 3 EI at the end of a beam with a load there, seen at the joint beyond."""
    rows = CONTEXT.geometry.rows.copy()
    rows[:] = 0.0
    rows[0, 2] = 0.8
    context = replace(
        CONTEXT,
        q=np.zeros((1, 6)),
        conditions=MeasurementConditions(),
        geometry=replace(CONTEXT.geometry.with_T_M_B(np.eye(4)), rows=rows, tool=np.zeros(3)),
        bodies=replace(CONTEXT.bodies, masses=np.zeros(6), payload_mass=10.0, payload_center=np.zeros(3)),
        up_M=np.array([0.0, 0.0, 1.0]),
    )
    column = columns("link_bending", "bending", context)["flexibility1"]
    np.testing.assert_allclose(shifts(column), [[0.0, 0.0, -10.0 * GRAVITY * 0.8**3 / 3.0]], atol=1e-12)
    sheared = columns("link_bending", "bending", context)["shear1"]
    assert (sheared.block, sheared.refines, sheared.unit) == ("link 1 shear", True, "1/N")
    np.testing.assert_allclose(shifts(sheared), [[0.0, 0.0, -10.0 * GRAVITY * 0.8]], atol=1e-12)


# -- Effects of tracker and target, against a tracker with errors of range and angles, and an inclined SMR -------------


def read(p, *, longer=0.0, stretched=0.0, azimuth=0.0, elevation=0.0):
    """Reading of a point (3,) by a tracker with errors of range and angles."""
    rho = np.linalg.norm(p) * (1.0 + stretched) + longer
    az, el = np.arctan2(p[1], p[0]) + azimuth, np.arcsin(p[2] / np.linalg.norm(p)) + elevation
    return rho * np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])


def misread(**errors):
    """Derivative (n, 3) of the reading by errors that depend on azimuth and elevation."""

    def of(p):
        az, el = np.arctan2(p[1], p[0]), np.arcsin(p[2] / np.linalg.norm(p))
        return slope(lambda h: read(p, **{k: h * error(az, el) for k, error in errors.items()}))

    return np.array([of(p) for p in CONTEXT.p_M])


def test_a_scale_stretches_all_distances():
    column = columns("tracker_scale")["scale"]
    assert column.unit == "m/m"
    np.testing.assert_allclose(shifts(column), misread(stretched=lambda az, el: 1.0), atol=1e-9)


def test_a_distance_offset_lengthens_all_distances():
    column = columns("tracker_distance_offset")["distance_offset"]
    assert column.unit == "m"
    np.testing.assert_allclose(shifts(column), misread(longer=lambda az, el: 1.0), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("wave", "function"), [("cos", np.cos), ("sin", np.sin)])
def test_angles_err_with_their_own_orders(order, wave, function):
    found = columns("tracker_angle_error", "orders")
    column = found[f"azimuth_{wave}{order}"]
    assert column.block == f"azimuth {order}"
    np.testing.assert_allclose(shifts(column), misread(azimuth=lambda az, el: function(order * az)), atol=1e-9)
    column = found[f"elevation_{wave}{order}"]
    assert column.block == f"elevation {order}"
    np.testing.assert_allclose(shifts(column), misread(elevation=lambda az, el: function(order * el)), atol=1e-9)
    assert len(found) == 8


def looking(towards):
    """A context whose SMR faces, at its first stop, along ``towards`` (3,) of the tracker frame."""
    return replace(CONTEXT, smr_normal=CONTEXT.frames[0][-1][0].T @ towards)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 50.0, 89.0])
def test_an_inclined_target_has_radial_and_lateral_errors(degrees):
    beam = CONTEXT.p_M[0] / np.linalg.norm(CONTEXT.p_M[0])
    aside = np.cross(beam, [0.3, -0.5, 0.8])
    aside /= np.linalg.norm(aside)
    angle = np.deg2rad(degrees)
    found = columns("target_incidence", "lateral", looking(-np.cos(angle) * beam + np.sin(angle) * aside))
    np.testing.assert_allclose(shifts(found["incidence_radial"])[0], (1.0 - np.cos(angle)) * beam, atol=1e-12)
    np.testing.assert_allclose(shifts(found["incidence_lateral"])[0], np.sin(angle) * aside, atol=1e-12)


# -- Effects in the joints: compliance, eccentricity, drives, backlash, friction, settling, drift ----------------------


def energy(row, joints, masses, payload):
    """Potential energy [J] of bodies and payload, with the joints displaced."""
    walked = chain(CONTEXT, row, joints=joints)
    heights = [
        CONTEXT.up_M @ (pose[:3, :3] @ center + pose[:3, 3])
        for pose, center in zip(walked.frames[1:], CONTEXT.bodies.centers, strict=True)
    ]
    end = walked.frames[-1]
    load = CONTEXT.up_M @ (end[:3, :3] @ CONTEXT.bodies.payload_center + end[:3, 3])
    return GRAVITY * (masses @ np.array(heights) + payload * load)


def torques(masses, payload):
    """Negative gradient of the energy by each joint (n, N) [Nm]; ``masses`` (N,), ``payload`` (n,)."""
    h = 1e-5
    return np.array(
        [
            [
                -(energy(row, h * step, masses, payload[row]) - energy(row, -h * step, masses, payload[row])) / (2 * h)
                for step in np.eye(6)
            ]
            for row in range(len(CONTEXT))
        ]
    )


def test_compliance_follows_the_torque_of_arm_and_payload():
    expected = torques(CONTEXT.bodies.masses, CONDITIONS.payload_kg)
    assert np.abs(expected).max() > 50.0
    found = columns("joint_compliance", "linear")
    for j in range(6):
        np.testing.assert_allclose(offsets(found[f"compliance{j + 1}"]), expected[:, j], atol=1e-5)


def test_payload_compliance_follows_the_torque_of_the_payload_alone():
    expected = torques(np.zeros(6), CONDITIONS.payload_kg)
    found = columns("payload_compliance")
    for j in range(6):
        np.testing.assert_allclose(offsets(found[f"payload_compliance{j + 1}"]), expected[:, j], atol=1e-5)


def test_two_slopes_meet_at_the_knee():
    stiffest = np.abs(CONTEXT.torques).max(axis=0)
    found = laws("joint_compliance", "two_slope")
    assert [law.constants["knee2"] / stiffest[1] for law in found] == pytest.approx([0.2, 0.35, 0.5, 0.65])
    assert {law.tried for law in found} == {4}
    law = found[2]
    parts = columns("joint_compliance", law)
    torque, knee = CONTEXT.torques[:, 1], law.constants["knee2"]
    rotated = 1e-5 * offsets(parts["compliance2"]) + 4e-6 * offsets(parts["soft2"])
    inside = np.abs(torque) < knee
    assert 0 < np.count_nonzero(inside) < len(torque)
    np.testing.assert_allclose(rotated[inside], 1.4e-5 * torque[inside])
    np.testing.assert_allclose(rotated[~inside], (1e-5 * torque + 4e-6 * knee * np.sign(torque))[~inside])


def test_eccentricity_is_one_cycle_and_ovality_two():
    found = columns("encoder_eccentricity")
    np.testing.assert_allclose(offsets(found["cos1q4"]), np.cos(CONTEXT.q[:, 3]))
    np.testing.assert_allclose(offsets(found["sin1q6"]), np.sin(CONTEXT.q[:, 5]))
    found = columns("transmission_error", "two")
    assert list(found)[:2] == ["cos2q1", "sin2q1"]
    assert {column.block for column in found.values()} == {f"joint {j}" for j in range(1, 7)}
    np.testing.assert_allclose(offsets(found["sin2q5"]), np.sin(2.0 * CONTEXT.q[:, 4]))


def test_a_joint_lags_half_the_play():
    found = columns("backlash", "constant")
    for j in range(6):
        column = found[f"half_play{j + 1}"]
        np.testing.assert_array_equal(offsets(column), -CONDITIONS.approach[:, j])
        assert (column.lower, column.unit) == (0.0, "rad")


def test_hysteresis_saturates_with_the_step():
    found = laws("backlash", "saturating")
    assert [law.constants["width"] for law in found] == [0.02, 0.05, 0.1, 0.2, 0.4, 0.8]
    assert {law.tried for law in found} == {6}
    step = CONDITIONS.step[:, 2]
    np.testing.assert_allclose(
        offsets(columns("backlash", found[3])["half_play3"]), -np.sign(step) * np.tanh(np.abs(step) / 0.2)
    )
    only_signs = under(CONTEXT, MeasurementConditions(approach=CONDITIONS.approach))
    typical = np.median(np.abs(CONDITIONS.step[:, 2]))
    np.testing.assert_allclose(
        offsets(columns("backlash", found[3], only_signs)["half_play3"]), -np.sign(step) * np.tanh(typical / 0.2)
    )


def test_an_unknown_approach_is_no_lost_motion():
    nothing_known = under(CONTEXT, MeasurementConditions())
    for slug in ("backlash", "friction_windup", "unsettled_measurement"):
        for law in EFFECTS[slug].laws(CONTEXT):
            for column in columns(slug, law, nothing_known).values():
                assert not offsets(column).any()


def test_friction_winds_up_with_the_load():
    signs, load = CONDITIONS.approach[:, 1], np.abs(CONTEXT.torques[:, 1])
    both = columns("friction_windup", "both")
    assert both["dry2"].block == both["windup2"].block == "joint 2"
    np.testing.assert_allclose(offsets(both["dry2"]), -signs)
    np.testing.assert_allclose(offsets(both["windup2"]), -signs * load)
    alone = columns("friction_windup", "load")
    assert list(alone) == [f"windup{j}" for j in range(1, 7)]
    np.testing.assert_allclose(offsets(alone["windup2"]), -signs * load)


def test_rounding_errors_of_a_vertical_axis_are_no_load():
    upright = replace(CONTEXT, up_M=CONTEXT.frames[0][0][0, :, 2])
    assert upright.loads.joint_torques()[:, 0].any()
    assert not offsets(columns("friction_windup", "load", upright)["windup1"]).any()
    assert not offsets(columns("joint_compliance", "linear", upright)["compliance1"]).any()


def test_an_unsettled_joint_lags_behind_its_motion():
    step, dwell = CONDITIONS.step[:, 0], CONDITIONS.dwell_s
    np.testing.assert_allclose(offsets(columns("unsettled_measurement", "step")["lag1"]), -step)
    found = laws("unsettled_measurement", "creep")
    assert found[-1].constants["tau_s"] == pytest.approx(30.0)
    for law in found:
        expected = -step * np.exp(-dwell / law.constants["tau_s"])
        np.testing.assert_allclose(offsets(columns("unsettled_measurement", law)["lag1"]), expected)
    no_dwell = under(CONTEXT, MeasurementConditions(step=CONDITIONS.step))
    np.testing.assert_allclose(
        offsets(columns("unsettled_measurement", found[-1], no_dwell)["lag1"]), -step * np.exp(-np.median(dwell) / 30.0)
    )


def test_joint_zeros_drift():
    time = CONDITIONS.time_s
    (law,) = laws("joint_drift", "linear")
    column = columns("joint_drift", law)["drift4"]
    assert (column.unit, column.joint) == ("rad", 3)
    np.testing.assert_allclose(offsets(column), (time - time[0]) / (time[-1] - time[0]))
    for law in laws("joint_drift", "warm_up"):
        expected = 1.0 - np.exp(-(time - time[0]) / law.constants["tau_s"])
        np.testing.assert_allclose(offsets(columns("joint_drift", law)["drift4"]), expected)
    (law,) = laws("joint_drift", "joint_temperature")
    column = columns("joint_drift", law)["drift4"]
    joints_c = CONDITIONS.joints_c[:, 3]
    assert column.unit == "rad/K"
    np.testing.assert_allclose(offsets(column), joints_c - joints_c.mean())


# -- Effects turn a probe as they move points of it --------------------------------------------------------------------


TURNED = replace(CONTEXT, conditions=replace(CONTEXT.conditions, R_M_S=np.tile(EYE, (10, 1, 1))))
R_M_F = CONTEXT.frames[0][-1]


def every_law(effect: Effect, context: EffectContext) -> list[Law]:
    smooth = []
    for law in effect.smooth_laws(context):
        lengths = {} if law.lengths is None else {LENGTH.name: law.lengths.start}
        smooth.append(effect.form(law.form).law({**law.constants, AMPLITUDE.name: 1.0, **lengths}))
    return [*effect.laws(context), *smooth]


def further_out(lever: np.ndarray) -> EffectContext:
    """The same stops with the SMR (3,) [m] further from the flange."""
    return replace(CONTEXT, geometry=replace(CONTEXT.geometry, tool=CONTEXT.geometry.tool + lever))


@pytest.mark.parametrize("slug", [slug for slug in EFFECTS if slug != "unknown"])
def test_every_column_turns_the_probe_as_it_moves_points_of_it(slug):
    effect = EFFECTS[slug]
    for law in every_law(effect, CONTEXT):
        here, rotated = (by_name(effect.columns(context, law)) for context in (CONTEXT, TURNED))
        assert list(here) == list(rotated)
        levers = [by_name(effect.columns(further_out(lever), law)) for lever in EYE]
        for name, column in rotated.items():
            if column.joint is not None:
                np.testing.assert_array_equal(column.offset, here[name].offset)
                continue
            own = sure(here[name].shift_M)
            if effect.of_reading:  # of the reading of a point: the probe itself does not turn
                assert not sure(column.shift_M).any()
                continue
            size = np.abs(own).max()
            for axis, further in enumerate(levers):
                other = sure(further[name].shift_M)
                moved = other - own
                np.testing.assert_allclose(moved, np.cross(sure(column.shift_M), R_M_F[:, :, axis]), atol=1e-9 * size)


def test_readings_of_both_kinds_stand_side_by_side():
    """In one context the rows of positions are as they are alone, those of orientations too."""
    R_M_S = np.tile(EYE, (10, 1, 1))
    R_M_S[::2] = np.nan
    both = replace(CONTEXT, conditions=replace(CONTEXT.conditions, R_M_S=R_M_S))
    law = EFFECTS["pedestal_compliance"].law("general")
    mixed, alone, rotated = (
        np.array([one.shift_M for one in EFFECTS["pedestal_compliance"].columns(context, law)])
        for context in (both, CONTEXT, TURNED)
    )
    np.testing.assert_array_equal(mixed[:, ::2], alone[:, ::2])
    np.testing.assert_array_equal(mixed[:, 1::2], rotated[:, 1::2])
