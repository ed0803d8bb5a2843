"""Effects that offset joints, against potential energies, hand calculations and independent formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.estimation.motion.terms import JointState, JointTerm, Knee, Law
from cellapp.robot.effects import EFFECTS, MeasurementConditions, Wave
from cellapp.robot.effects.joint_compliance import SECOND_KNEE
from cellapp.robot.effects.periodic import LINES_MAX
from tests.robot.effects.cell import by_name, chain, context_of, offsets, under

GRAVITY = 9.80665
CONTEXT = context_of(12)
CONDITIONS: Any = CONTEXT.conditions


def laws(slug, name, context=CONTEXT):
    return [law for law in EFFECTS[slug].laws(context) if law.name == name]


def columns(slug, law, context=CONTEXT):
    return by_name(EFFECTS[slug].columns(context, law))


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
    found = columns("joint_compliance", EFFECTS["joint_compliance"].law("linear"))
    for j in range(6):
        np.testing.assert_allclose(offsets(found[f"compliance{j + 1}"]), expected[:, j], atol=1e-5)


def test_payload_compliance_follows_the_torque_of_the_payload_alone():
    expected = torques(np.zeros(6), CONDITIONS.payload_kg)
    found = columns("payload_compliance", EFFECTS["payload_compliance"].law())
    for j in range(6):
        np.testing.assert_allclose(offsets(found[f"payload_compliance{j + 1}"]), expected[:, j], atol=1e-5)


def test_a_load_off_its_center_adds_a_torque():
    """A shift of the load's centre along the flange's axes adds the difference of two loads' torques."""
    moved = 0.05
    found = columns("payload_compliance", EFFECTS["payload_compliance"].law())
    for k, letter in enumerate("xyz"):
        bodies = replace(CONTEXT.bodies, payload_center=CONTEXT.bodies.payload_center + moved * np.eye(3)[k])
        other = replace(CONTEXT, bodies=bodies)
        more = other.loads.torques_of(-1) - CONTEXT.loads.torques_of(-1)
        for j in range(6):
            column = found[f"center_{letter}{j + 1}"]
            assert (column.block, column.refines, column.unit) == (f"center of load {j + 1}", True, "rad/N")
            np.testing.assert_allclose(moved * offsets(column), more[:, j], atol=1e-5)


def test_moments_are_the_torque_body_by_body_and_sum_to_all():
    found = columns("joint_compliance", EFFECTS["joint_compliance"].law("linear"))
    assert [name for name in found if name.startswith("moment5")] == ["moment5_5", "moment5_6"]
    for i in range(6):
        expected = torques(np.where(np.arange(6) == i, CONTEXT.bodies.masses, 0.0), CONDITIONS.payload_kg * (i == 5))
        for j in range(i + 1):
            np.testing.assert_allclose(offsets(found[f"moment{j + 1}_{i + 1}"]), expected[:, j], atol=1e-5)
    for j in range(6):
        total = sum(offsets(found[f"moment{j + 1}_{i + 1}"]) for i in range(j, 6))
        np.testing.assert_allclose(total, CONTEXT.torques[:, j], atol=1e-9)


def test_a_body_without_mass_has_no_moment():
    masses = CONTEXT.bodies.masses * np.array([1, 1, 0, 1, 1, 1])
    context = replace(CONTEXT, bodies=replace(CONTEXT.bodies, masses=masses))
    found = columns("joint_compliance", EFFECTS["joint_compliance"].law("linear"), context)
    assert "moment2_3" not in found
    assert "moment2_4" in found


def test_an_upright_arm_has_no_torque_at_its_first_joint():
    """Exact zero: a scan would treat rounding errors like any other column."""
    axis = CONTEXT.geometry.T_M_B()[:3, 2]
    upright = replace(CONTEXT, up_M=axis)
    for law in (EFFECTS["joint_compliance"].law("linear"), laws("joint_compliance", "two_slope")[0]):
        of_first = [c for c in columns("joint_compliance", law, upright).values() if c.joint == 0]
        assert len(of_first) >= 8, "stiffness, load and six bodies"
        for column in of_first:
            assert not offsets(column).any(), column.name
    assert not offsets(
        columns("payload_compliance", EFFECTS["payload_compliance"].law(), upright)["payload_compliance1"]
    ).any()


@pytest.mark.parametrize("name", ["linear", "two_slope"])
def test_loads_and_bodies_only_refine_a_stiffness(name):
    """The load's torque, or one body's, may count more or less than the rest's: it alone is not compliance."""
    found = columns("joint_compliance", laws("joint_compliance", name)[0])
    main = {key for key, column in found.items() if not column.refines}
    assert main == {f"compliance{j}" for j in range(1, 7)}
    moments = {f"moment{j}_{i}" for j in range(1, 7) for i in range(j, 7)}
    loads = {f"load{j}" for j in range(1, 7)}
    softer = {f"soft{j}" for j in range(1, 7)} if name == "two_slope" else set()
    assert set(found) - main == moments | loads | softer
    load = torques(np.zeros(6), CONDITIONS.payload_kg)
    for j in range(6):
        column = found[f"load{j + 1}"]
        assert (column.block, column.joint) == (f"load {j + 1}", j)
        np.testing.assert_allclose(offsets(column), load[:, j], atol=1e-5)
    for key in moments | loads:
        assert found[key].lower == -found[key].upper < 0.0, "more or less than the rest"
    blocks = [column.block for key, column in found.items() if key not in main]
    assert len(set(blocks)) == len(blocks), "each by itself"


def test_two_slopes_meet_at_the_knee():
    stiffest = np.abs(CONTEXT.torques).max(axis=0)
    found = laws("joint_compliance", "two_slope")
    assert [law.constants["knee2"] / stiffest[1] for law in found] == pytest.approx([0.2, 0.35, 0.5, 0.65])
    assert {law.tried for law in found} == {4}
    law = found[2]
    parts = columns("joint_compliance", law)
    torque, knee = CONTEXT.torques[:, 1], law.constants["knee2"]
    turned = 1e-5 * offsets(parts["compliance2"]) + 4e-6 * offsets(parts["soft2"])
    inside = np.abs(torque) < knee
    assert 0 < np.count_nonzero(inside) < len(torque)
    np.testing.assert_allclose(turned[inside], 1.4e-5 * torque[inside])
    np.testing.assert_allclose(turned[~inside], (1e-5 * torque + 4e-6 * knee * np.sign(torque))[~inside])


def test_a_second_knee_adds_to_the_first():
    """As ``JointTerm`` has it in motion; a joint without a second knee has the first alone."""
    knees = {"knee2": 20.0, "second_knee2": 60.0, "knee3": 10.0}
    parts = columns("joint_compliance", EFFECTS["joint_compliance"].law("three_slope", knees))
    for j, low, high in ((1, 20.0, 60.0), (2, 10.0, 0.0)):
        torque = CONTEXT.torques[:, j]
        state = JointState(CONTEXT.q, 0.0 * CONTEXT.q, 0.0 * CONTEXT.q, CONTEXT.torques)
        for name, knee in (("soft", Knee(low)), ("middle", Knee(high, SECOND_KNEE))):
            column = offsets(parts[f"{name}{j + 1}"])
            np.testing.assert_allclose(column, np.clip(torque, -knee.torque, knee.torque))
            term = JointTerm(Law.COMPLIANCE, j, knee=knee)
            assert (term.name, term.unit) == (f"{name}{j + 1}", "rad/Nm")
            np.testing.assert_allclose(term.offset(state), column)


def test_eccentricity_is_one_cycle_and_ovality_two():
    found = columns("encoder_eccentricity", EFFECTS["encoder_eccentricity"].law())
    np.testing.assert_allclose(offsets(found["cos1q4"]), np.cos(CONTEXT.q[:, 3]))
    np.testing.assert_allclose(offsets(found["sin1q6"]), np.sin(CONTEXT.q[:, 5]))
    found = columns("transmission_error", EFFECTS["transmission_error"].law("two"))
    assert list(found)[:2] == ["cos2q1", "sin2q1"]
    assert {column.block for column in found.values()} == {f"joint {j}" for j in range(1, 7)}
    np.testing.assert_allclose(offsets(found["sin2q5"]), np.sin(2.0 * CONTEXT.q[:, 4]))


def test_every_line_is_a_block_with_the_price_of_the_search():
    (law,) = laws("transmission_error", "lines")
    assert law.tried == LINES_MAX - 1 == 209
    found = columns("transmission_error", law)
    assert len(found) == 2 * 6 * 209
    assert {found["cos101q3"].block, found["sin101q3"].block} == {"joint 3 line 101"}
    assert len({column.block for column in found.values()}) == 6 * 209
    for name, column in found.items():
        assert isinstance(column.wave, Wave)
        assert column.joint is not None
        assert name == f"{'sin' if column.wave.sine else 'cos'}{column.cycles}q{column.joint + 1}"
        expected = column.wave(CONTEXT.q[:, column.joint])
        np.testing.assert_allclose(offsets(column), expected, atol=1e-12)


def test_a_gear_has_two_cycles_its_ratio_and_twice_that_at_any_joint():
    found = columns("transmission_error", EFFECTS["transmission_error"].law("gear", {"ratio": 100.0}))
    assert list(found)[:6] == ["cos2q1", "sin2q1", "cos100q1", "sin100q1", "cos200q1", "sin200q1"]
    assert {column.block for column in found.values()} == {
        f"joint {j} line {n}" for j in range(1, 7) for n in (2, 100, 200)
    }
    for n in (2, 100, 200):
        np.testing.assert_allclose(offsets(found[f"cos{n}q4"]), np.cos(n * CONTEXT.q[:, 3]), atol=1e-12)
        np.testing.assert_allclose(offsets(found[f"sin{n}q4"]), np.sin(n * CONTEXT.q[:, 3]), atol=1e-12)


@pytest.mark.parametrize(
    ("names", "ratios"),
    [
        (["cos2q1", "sin2q1"], []),
        (["cos51q3", "sin51q3"], [51.0]),
        (["cos100q3", "sin100q3"], [50.0, 100.0]),
        (["cos4q1", "sin100q3"], [4.0, 50.0, 100.0]),
    ],
)
def test_a_line_that_was_found_proposes_the_gears_it_may_belong_to(names, ratios):
    """A line is at the ratio or at twice that; two cycles per revolution are of any gear."""
    effect = EFFECTS["transmission_error"]
    found = effect.refinements(CONTEXT, effect.law("lines"), names)
    assert [(law.name, law.constants["ratio"]) for law in found] == [("gear", ratio) for ratio in ratios]
    assert {law.tried for law in found} <= {LINES_MAX - 1}, "choosing a ratio costs as much as choosing a line"
    assert not any(law.name == "gear" for law in effect.laws(CONTEXT))


def test_a_curve_has_the_cycles_of_the_joints_that_carry_a_prior():
    law = EFFECTS["transmission_error"].law("curve", {"cycles": 5.0, "length4": 0.3, "amplitude4": 1e-4})
    found = columns("transmission_error", law)
    assert list(found) == ["cos2q4", "sin2q4", "cos3q4", "sin3q4", "cos4q4", "sin4q4", "cos5q4", "sin5q4"]
    assert {column.block for column in found.values()} == {"joint 4"}
    assert not any(law.name == "curve" for law in EFFECTS["transmission_error"].laws(CONTEXT))


def test_a_joint_lags_half_the_play():
    found = columns("backlash", EFFECTS["backlash"].law("constant"))
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
    both = columns("friction_windup", EFFECTS["friction_windup"].law("both"))
    assert both["dry2"].block == both["windup2"].block == "joint 2"
    np.testing.assert_allclose(offsets(both["dry2"]), -signs)
    np.testing.assert_allclose(offsets(both["windup2"]), -signs * load)
    alone = columns("friction_windup", EFFECTS["friction_windup"].law("load"))
    assert list(alone) == [f"windup{j}" for j in range(1, 7)]
    np.testing.assert_allclose(offsets(alone["windup2"]), -signs * load)


def test_an_unsettled_joint_lags_behind_its_motion():
    step, dwell = CONDITIONS.step[:, 0], CONDITIONS.dwell_s
    np.testing.assert_allclose(
        offsets(columns("unsettled_measurement", EFFECTS["unsettled_measurement"].law("step"))["lag1"]), -step
    )
    found = laws("unsettled_measurement", "creep")
    assert found[-1].constants["tau_s"] == pytest.approx(30.0)
    for law in found:
        expected = -step * np.exp(-dwell / law.constants["tau_s"])
        np.testing.assert_allclose(offsets(columns("unsettled_measurement", law)["lag1"]), expected)
    no_dwell = under(CONTEXT, MeasurementConditions(step=CONDITIONS.step))
    np.testing.assert_allclose(
        offsets(columns("unsettled_measurement", found[-1], no_dwell)["lag1"]), -step * np.exp(-np.median(dwell) / 30.0)
    )


def test_creep_that_is_over_before_any_reading_is_not_tried():
    patient = replace(CONTEXT.conditions, dwell_s=CONDITIONS.dwell_s + 20.0)
    quick, slow = (
        laws("unsettled_measurement", "creep"),
        laws("unsettled_measurement", "creep", under(CONTEXT, patient)),
    )
    assert len(quick) == quick[0].tried == 8
    assert 0 < len(slow) == slow[0].tried < 8
    assert min(law.constants["tau_s"] for law in slow) > 2.0


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


@given(late=st.floats(0.0, 1e6))
def test_after_the_run_a_drift_is_constant(late):
    (law,) = laws("joint_drift", "linear")
    last = float(CONDITIONS.time_s[-1])
    context = replace(CONTEXT, q=CONTEXT.q[:1], conditions=MeasurementConditions(time_s=np.array([last + late])))
    assert offsets(columns("joint_drift", law, context)["drift1"])[0] == 1.0
    now = replace(context, conditions=MeasurementConditions())
    assert offsets(columns("joint_drift", law, now)["drift1"])[0] == 1.0
