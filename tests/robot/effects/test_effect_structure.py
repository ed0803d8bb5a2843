"""Effects that move frames: every column against a chain that is displaced, heated or bent numerically."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.robot.effects import EFFECTS, MeasurementConditions, TemperatureRecord
from cellapp.robot.effects.time_functions import lagged
from cellapp.robot.kinematics.transforms import rotation_from_vector, rotation_x, rotation_y, transform
from tests.robot.effects.cell import EYE, by_name, chain, context_of, shifts, slope, under

GRAVITY = 9.80665
CONTEXT = context_of(10)
RUN = context_of(60, seed=3)
CONDITIONS: Any = CONTEXT.conditions
RUN_CONDITIONS: Any = RUN.conditions


def laws(slug, name, context=CONTEXT):
    return [law for law in EFFECTS[slug].laws(context) if law.name == name]


def columns(slug, law, context=CONTEXT):
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

    found = columns("joint_axis_wobble", EFFECTS["joint_axis_wobble"].law())
    column = found[f"wobble_{letter}{joint}_{wave}"]
    assert column.block == column.where == f"joint {joint}"
    np.testing.assert_allclose(shifts(column), each_row(moved), atol=1e-9)
    assert len(found) == 24


@pytest.mark.parametrize("joint", [1, 4, 6])
@pytest.mark.parametrize(("letter", "axis"), [("x", EYE[0]), ("y", EYE[1])])
@pytest.mark.parametrize("cycles", [1, 3, 6])
def test_an_axis_tilts_with_any_cycles_of_its_joint(joint, letter, axis, cycles):
    def moved(row, h):
        return chain(CONTEXT, row, twist={joint - 1: h * np.sin(cycles * CONTEXT.q[row, joint - 1]) * axis}).smr

    found = columns("joint_axis_wobble", laws("joint_axis_wobble", "harmonics")[0])
    column = found[f"wobble_{letter}{joint}_sin{cycles}"]
    assert (column.block, column.cycles, column.where) == (f"joint {joint} {cycles} cycles", cycles, f"joint {joint}")
    assert column.refines == (cycles == 1), "one cycle is in part geometry"
    np.testing.assert_allclose(shifts(column), each_row(moved), atol=1e-9)
    assert len(found) == 6 * 6 * 4


@pytest.mark.parametrize("joint", [1, 4, 6])
@pytest.mark.parametrize(("letter", "axis"), list(zip("xyz", EYE, strict=True)))
@pytest.mark.parametrize("cycles", [1, 2, 5])
def test_an_axis_shifts_with_its_angle(joint, letter, axis, cycles):
    rotations, _ = CONTEXT.frames
    along = rotations[joint - 1] @ axis
    found = columns("joint_axis_runout", EFFECTS["joint_axis_runout"].law())
    column = found[f"runout_{letter}{joint}_cos{cycles}"]
    way = "axial" if letter == "z" else "radial"
    assert (column.block, column.where) == (f"joint {joint} {way} {cycles} cycles", f"joint {joint}")
    assert column.refines == (cycles == 1 and letter != "z")
    np.testing.assert_allclose(shifts(column), np.cos(cycles * CONTEXT.q[:, joint - 1])[:, None] * along, atol=1e-12)
    assert len(found) == 6 * 6 * 6


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


def test_links_grow_with_the_joints_at_their_ends():
    joints = CONDITIONS.joints_c - CONDITIONS.joints_c.mean(axis=0)
    ends = np.array([[(row[i] + row[min(i + 1, 5)]) / 2.0 for i in range(6)] for row in joints])
    whole = columns("thermal_growth", laws("thermal_growth", "joints")[0])["growth"]
    np.testing.assert_allclose(shifts(whole), grown(lambda row: ends[row]), atol=1e-9)
    links = columns("thermal_growth", laws("thermal_growth", "joints_links")[0])
    np.testing.assert_allclose(shifts(links["growth3"]), grown(lambda row: ends[row] * np.eye(6)[2]), atol=1e-9)


def test_links_grow_while_warming_up():
    found = laws("thermal_growth", "warm_up")
    assert [law.constants["tau_s"] for law in found] == [900.0, 1800.0, 3600.0, 7200.0, 14400.0]
    assert {law.tried for law in found} == {5}
    time = CONDITIONS.time_s
    strain = 1.0 - np.exp(-(time - time[0]) / 3600.0)
    column = columns("thermal_growth", found[2])["growth"]
    assert column.unit == "m/m"
    np.testing.assert_allclose(shifts(column), grown(lambda row: np.full(6, strain[row])), atol=1e-9)


def test_a_lag_follows_a_ramp_at_its_distance():
    """A first-order lag follows a ramp of slope b, from rest, with b (t - tau (1 - exp(-t / tau)))."""
    rng = np.random.default_rng(2)
    t = np.sort(rng.uniform(0.0, 18000.0, 3000))
    t -= t[0]
    mixed = rng.permutation(len(t))
    slopes = np.array([2e-3, -1e-3])
    for tau in (400.0, 2000.0):
        expected = (t - tau * -np.expm1(-t / tau))[:, None] * slopes + 25.0
        found = lagged((t[:, None] * slopes + 25.0)[mixed], t[mixed], tau)
        np.testing.assert_allclose(found, expected[mixed], atol=5e-3)
    np.testing.assert_allclose(lagged(np.full((5, 1), 21.5), np.arange(5.0) * 600.0, 900.0), 21.5)


def test_links_follow_their_joints_and_the_air_and_housings_grow():
    """Each column grows its own part of the arm, by its temperature above the mean."""
    law = laws("thermal_growth", "conduction_links")[2]
    conditions = CONDITIONS
    joints = conditions.joints_c - conditions.joints_c.mean(axis=0)
    air = conditions.air_c - conditions.air_c.mean()
    ends = np.array([[(row[i] + row[min(i + 1, 5)]) / 2.0 for i in range(6)] for row in joints - air[:, None]])
    behind = lagged(np.column_stack([ends, air]), conditions.time_s, law.constants["lag_s"])
    found = columns("thermal_growth", law)
    np.testing.assert_allclose(shifts(found["growth3"]), grown(lambda row: behind[row, 2] * np.eye(6)[2]), atol=1e-9)
    np.testing.assert_allclose(shifts(found["growth_air"]), grown(lambda row: np.full(6, behind[row, 6])), atol=1e-9)
    housings = each_row(
        lambda row, h: chain(CONTEXT, row, shift={j: h * joints[row, j] * EYE[2] for j in range(6)}).smr
    )
    np.testing.assert_allclose(shifts(found["growth_housings"]), housings, atol=1e-9)
    whole = columns("thermal_growth", laws("thermal_growth", "conduction")[2])
    np.testing.assert_allclose(
        shifts(whole["growth_joints"]), sum(shifts(found[f"growth{i}"]) for i in range(1, 7)), atol=1e-12
    )


@pytest.mark.parametrize("name", ["conduction", "conduction_links"])
def test_the_record_of_a_run_gives_link_temperatures_at_any_stop(name):
    """Independent of the conditions of the stops themselves, and of the order of the record."""
    law = laws("thermal_growth", name, RUN)[2]
    conditions, rows = RUN_CONDITIONS, np.array([41, 5, 20])
    mixed = np.random.default_rng(4).permutation(60)
    record = TemperatureRecord(conditions.time_s[mixed], conditions.joints_c[mixed], conditions.air_c[mixed])
    time_s = conditions.time_s[rows]
    some = replace(RUN, q=RUN.q[rows], conditions=MeasurementConditions(time_s=time_s, record=record))
    whole, part = columns("thermal_growth", law, RUN), columns("thermal_growth", law, some)
    followed = set(whole) - {"growth_housings"}  # which need the temperatures at the stop
    assert {"growth_air"} < followed
    for one in followed:
        np.testing.assert_allclose(shifts(part[one]), shifts(whole[one])[rows], rtol=1e-9, atol=1e-12)
        assert np.abs(shifts(part[one])).max() > 0.05
    settled = columns("thermal_growth", law, under(RUN, replace(conditions, record=None)))
    warmer = conditions.air_c - conditions.air_c.mean()
    expected = RUN.link_growth.sum(axis=0) * warmer[:, None]
    np.testing.assert_allclose(shifts(settled["growth_air"]), expected, atol=1e-12)
    assert not np.allclose(shifts(whole["growth_air"]), expected, atol=0.1), "the lag is seen"


def test_between_two_moments_of_the_record_link_temperatures_are_interpolated():
    law = laws("thermal_growth", "conduction", RUN)[2]
    conditions = RUN_CONDITIONS
    times = np.array(
        [conditions.time_s[7], conditions.time_s[7:9].mean(), conditions.time_s[8], conditions.time_s[-1], 1e9]
    )
    still = replace(
        RUN, q=np.tile(RUN.q[0], (5, 1)), conditions=MeasurementConditions(time_s=times, record=conditions.record)
    )
    grown_by_air = shifts(columns("thermal_growth", law, still)["growth_air"])
    np.testing.assert_allclose(grown_by_air[1], (grown_by_air[0] + grown_by_air[2]) / 2.0, rtol=1e-9)
    np.testing.assert_allclose(grown_by_air[4], grown_by_air[3])


def test_a_short_link_has_no_column_unless_requested():
    rows = CONTEXT.geometry.rows.copy()
    rows[5, 1] = 0.02
    context = replace(CONTEXT, geometry=replace(CONTEXT.geometry, rows=rows))
    law = laws("thermal_growth", "air_links")[0]
    assert "growth6" not in columns("thermal_growth", law, context)
    assert "growth6" in by_name(EFFECTS["thermal_growth"].columns(context, law, {"growth6"}))


# -- base and tool ---------------------------------------------------------------------------------------------------

TWISTS = {
    **{letter: lambda row, h, k=k: chain(RUN, row, shift={0: h * EYE[k]}).smr for k, letter in enumerate("xyz")},
    **{
        f"turn_{letter}": lambda row, h, k=k: chain(RUN, row, twist={0: h * EYE[k]}).smr
        for k, letter in enumerate("xyz")
    },
}


@pytest.mark.parametrize("way", TWISTS)
def test_base_drift_and_step(way):
    twisted = each_row(TWISTS[way], RUN)
    time = RUN_CONDITIONS.time_s
    along = ((time - time[0]) / (time[-1] - time[0]))[:, None]
    found = columns("base_drift", laws("base_drift", "linear", RUN)[0], RUN)
    assert {column.block for column in found.values()} == {"base"}
    column = found[f"base_drift_{way}"]
    assert column.unit == ("rad" if way.startswith("turn") else "m")
    np.testing.assert_allclose(shifts(column), twisted * along, atol=1e-9)
    bow = columns("base_drift", laws("base_drift", "quadratic", RUN)[0], RUN)[f"base_drift_{way}_bow"]
    np.testing.assert_allclose(shifts(bow), twisted * 4.0 * along * (1.0 - along), atol=1e-9)
    warm = laws("base_drift", "warm_up", RUN)[1]
    expected = twisted * (1.0 - np.exp(-(time - time[0]) / 1800.0))[:, None]
    np.testing.assert_allclose(shifts(columns("base_drift", warm, RUN)[f"base_drift_{way}"]), expected, atol=1e-9)
    law = laws("base_step", "onset", RUN)[11]
    column = columns("base_step", law, RUN)[f"base_step_{way}"]
    np.testing.assert_allclose(shifts(column), twisted * (time >= law.constants["onset_s"])[:, None], atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_a_target_slips_in_the_flange(axis):
    moved = each_row(lambda row, h: chain(RUN, row, tool=h * EYE[axis]).smr, RUN)
    law = laws("target_slip", "onset", RUN)[20]
    column = columns("target_slip", law, RUN)[f"slip_{'xyz'[axis]}"]
    assert column.block == column.where == "tool"
    np.testing.assert_allclose(
        shifts(column), moved * (RUN_CONDITIONS.time_s >= law.constants["onset_s"])[:, None], atol=1e-9
    )


@pytest.mark.parametrize("slug", ["base_step", "target_slip"])
def test_a_step_is_permanent(slug):
    law = EFFECTS[slug].laws(RUN)[0]
    after = EFFECTS[slug].columns(under(RUN, MeasurementConditions(time_s=np.full(60, 1e9))), law)
    for time_s in (None, np.full(60, np.nan)):
        for now, later in zip(EFFECTS[slug].columns(under(RUN, MeasurementConditions(time_s=time_s)), law), after):
            np.testing.assert_array_equal(shifts(now), shifts(later))
            assert shifts(now).any()


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


def test_onsets_reach_from_end_to_end():
    time = np.arange(400.0) * 45.0
    context = replace(RUN, q=np.zeros((400, 6)), conditions=MeasurementConditions(time_s=time))
    onsets = [law.constants["onset_s"] for law in EFFECTS["base_step"].laws(context)]
    assert len(onsets) == 120
    assert onsets[0] == 7.5 * 45.0
    assert onsets[-1] == 391.5 * 45.0
    assert np.diff(onsets).max() <= 4 * 45.0


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


def about(point, turn):
    """The arm as a whole turned by a small ``turn`` (3,) about a ``point`` (3,), both in the tracker frame."""
    R = rotation_from_vector(turn)
    return transform(R, point - R @ point)


def test_a_pedestal_tilts_with_the_arms_moment():
    def moved(row, h):
        return chain(CONTEXT, row, outside=about(CONTEXT.geometry.T_M_B()[:3, 3], h * own_moment(row))).smr

    found = columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("isotropic"))
    assert list(found) == ["pedestal_tilt"]
    np.testing.assert_allclose(shifts(found["pedestal_tilt"]), each_row(moved, h=1e-7), atol=1e-5)
    parts = columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("tilt"))
    assert [column.block for column in parts.values()] == ["base", "base"]
    np.testing.assert_allclose(
        sum(shifts(column) for column in parts.values()), shifts(found["pedestal_tilt"]), atol=1e-9
    )


def test_a_pedestal_tilts_each_way_with_its_own_moment():
    """The arm's own x and y, made horizontal."""
    axes = CONTEXT.geometry.T_M_B()[:3, :3]
    x = axes[:, 0] - (axes[:, 0] @ CONTEXT.up_M) * CONTEXT.up_M
    x /= np.linalg.norm(x)
    y = np.cross(CONTEXT.up_M, x)
    assert y @ axes[:, 1] > 0.99
    for letter, way in (("x", x), ("y", y)):
        for_one = [way * (own_moment(row) @ way) for row in range(len(CONTEXT))]
        origin = CONTEXT.geometry.T_M_B()[:3, 3]
        expected = each_row(
            lambda row, h, o=origin, w=for_one: chain(CONTEXT, row, outside=about(o, h * w[row])).smr, h=1e-7
        )
        found = columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("tilt"))[f"pedestal_tilt_{letter}"]
        np.testing.assert_allclose(shifts(found), expected, atol=1e-5)


def test_a_frame_also_turns_across_the_moment_and_shifts():
    found = columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("general"))
    assert len(found) == 15
    main = [name for name, column in found.items() if not column.refines]
    assert main == ["pedestal_tilt_x", "pedestal_tilt_y"]
    assert {found[name].block for name in set(found) - set(main)} == {"base turns", "base shifts", "base weight"}
    base = CONTEXT.geometry.T_M_B()[:3, :3]
    lever = CONTEXT.p_M - CONTEXT.geometry.T_M_B()[:3, 3]
    up = base.T @ CONTEXT.up_M
    x = np.array([1.0, 0.0, 0.0]) - up[0] * up
    x = base @ (x / np.linalg.norm(x))
    moment_M = CONTEXT.loads.beyond(0)[1]
    expected = (moment_M @ x)[:, None] * np.cross(CONTEXT.up_M, lever)
    np.testing.assert_allclose(shifts(found["pedestal_turn_z_x"]), expected, atol=1e-9)
    y = np.cross(CONTEXT.up_M, x)
    np.testing.assert_allclose(
        shifts(found["pedestal_turn_x_y"]), (moment_M @ y)[:, None] * np.cross(x, lever), atol=1e-9
    )
    weight = CONTEXT.loads.masses.sum(axis=0) * GRAVITY
    np.testing.assert_allclose(shifts(found["pedestal_weight_x"]), weight[:, None] * np.cross(x, lever), atol=1e-9)
    np.testing.assert_allclose(shifts(found["pedestal_shift_y_x"]), (moment_M @ x)[:, None] * base[:, 1], atol=1e-9)


def test_a_pedestal_tilts_about_a_pivot_below():
    height = 0.7
    base = CONTEXT.geometry.T_M_B()
    pivot = base[:3, 3] - height * base[:3, 2]
    expected = each_row(lambda row, h: chain(CONTEXT, row, outside=about(pivot, h * own_moment(row))).smr, h=1e-7)
    found = columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("pivot"))
    assert [column.unit for column in found.values()] == ["rad/Nm", "rad/Nm", "m/Nm", "m/Nm"]
    tilted = shifts(found["pedestal_tilt_x"]) + shifts(found["pedestal_tilt_y"])
    swayed = shifts(found["pedestal_sway_x"]) + shifts(found["pedestal_sway_y"])
    np.testing.assert_allclose(tilted + height * swayed, expected, atol=1e-5)


@pytest.mark.parametrize("turn", [rotation_x(np.pi), rotation_x(np.pi / 2.0), rotation_y(np.pi / 2.0)])
def test_a_pedestal_on_a_wall_or_under_a_ceiling(turn):
    """The whole moment counts, for any mounting of the arm."""
    up = turn.T @ CONTEXT.geometry.T_M_B()[:3, 2]
    context = replace(CONTEXT, up_M=up)
    origin = context.geometry.T_M_B()[:3, 3]
    moments = context.loads.beyond(0)[1]
    np.testing.assert_allclose(moments @ up, 0.0, atol=1e-9)
    expected = np.cross(moments, context.p_M - origin)
    np.testing.assert_allclose(
        shifts(
            columns("pedestal_compliance", EFFECTS["pedestal_compliance"].law("isotropic"), context)["pedestal_tilt"]
        ),
        expected,
        atol=1e-9,
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


def test_an_unknown_pose_of_the_other_arm_counts_as_the_mean():
    for law in EFFECTS["pedestal_coupling"].laws(CONTEXT):
        for column in columns("pedestal_coupling", law, under(CONTEXT, MeasurementConditions())).values():
            assert not shifts(column).any()


# -- beams -----------------------------------------------------------------------------------------------------------


def beam_by_integration(row, link, *, torsion, own_weight, slices=4000):
    """Shift of the SMR (3,) for EI = 1 (or GJ = 1): each slice of the beam rotates all that is beyond it.

    ``dP = int M_part(x) x (P - r(x)) dx``, M(x) the moment at x of every weight beyond x, added up body by body.
    """
    walked = chain(CONTEXT, row)
    start, end = walked.frames[link - 1][:3, 3], walked.frames[link][:3, 3]
    length = np.linalg.norm(end - start)
    e = (end - start) / length
    x = (np.arange(slices) + 0.5) / slices * length
    r = start + x[:, None] * e
    moment = np.zeros((slices, 3))
    bodies = CONTEXT.bodies
    for body in range(link, 6):
        pose = walked.frames[body + 1]
        center = pose[:3, :3] @ bodies.centers[body] + pose[:3, 3]
        moment += np.cross(center - r, -bodies.masses[body] * GRAVITY * CONTEXT.up_M)
    flange = walked.frames[-1]
    load = flange[:3, :3] @ bodies.payload_center + flange[:3, 3]
    moment += np.cross(load - r, -CONDITIONS.payload_kg[row] * GRAVITY * CONTEXT.up_M)
    if own_weight:
        pose = walked.frames[link]
        center = pose[:3, :3] @ bodies.centers[link - 1] + pose[:3, 3]
        held = x < (center - start) @ e
        moment += held[:, None] * np.cross(center - r, -bodies.masses[link - 1] * GRAVITY * CONTEXT.up_M)
    along = (moment @ e)[:, None] * e
    turned = along if torsion else moment - along
    return np.cross(turned, walked.smr - r).sum(axis=0) * length / slices


@pytest.mark.parametrize("link", [2, 3])
@pytest.mark.parametrize("own_weight", [False, True])
def test_a_link_bends_and_twists_as_a_beam(link, own_weight):
    law = EFFECTS["link_bending"].law("bending_torsion_own_weight" if own_weight else "bending_torsion")
    found = columns("link_bending", law)
    for name, torsion in ((f"flexibility{link}", False), (f"torsion{link}", True)):
        expected = [
            beam_by_integration(row, link, torsion=torsion, own_weight=own_weight) for row in range(len(CONTEXT))
        ]
        column = found[name]
        assert column.block == column.where == f"link {link}"
        assert (column.lower, column.unit) == (0.0, "1/(N m^2)")
        # where the own weight begins is resolved to one slice: 1/4000 of its moment
        np.testing.assert_allclose(shifts(column), expected, atol=2e-2 if own_weight else 1e-4)
        assert np.abs(expected).max() > 1.0


def test_bending_under_the_own_weight_may_be_a_parameter_of_its_own():
    free = columns("link_bending", EFFECTS["link_bending"].law("bending_torsion_free_weight"))
    own = columns("link_bending", EFFECTS["link_bending"].law("bending_torsion_own_weight"))
    bare = columns("link_bending", EFFECTS["link_bending"].law("bending_torsion"))
    for link in (2, 3):
        column = free[f"own_weight{link}"]
        assert (column.block, column.refines) == (f"link {link} own weight", True)
        assert free[f"flexibility{link}"].block == free[f"torsion{link}"].block == f"link {link}"
        bent = shifts(own[f"flexibility{link}"]) - shifts(bare[f"flexibility{link}"])
        np.testing.assert_allclose(shifts(column), bent, atol=1e-9)
        assert np.abs(bent).max() > 0.1
        np.testing.assert_allclose(shifts(free[f"flexibility{link}"]), shifts(bare[f"flexibility{link}"]), atol=1e-12)
        np.testing.assert_allclose(shifts(free[f"torsion{link}"]), shifts(own[f"torsion{link}"]), atol=1e-12)


def test_the_long_links_bend():
    """Upper arm and forearm of a UR; the others are short and stiff."""
    for arm in ("left", "right"):
        context = context_of(5, arm=arm)
        assert list(columns("link_bending", EFFECTS["link_bending"].law("bending"), context)) == [
            "flexibility2",
            "shear2",
            "flexibility3",
            "shear3",
        ]
        torsion = columns("link_bending", EFFECTS["link_bending"].law("bending_torsion"), context)
        assert list(torsion) == [f"{name}{link}" for link in (2, 3) for name in ("flexibility", "shear", "torsion")]


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
    column = columns("link_bending", EFFECTS["link_bending"].law("bending"), context)["flexibility1"]
    np.testing.assert_allclose(shifts(column), [[0.0, 0.0, -10.0 * GRAVITY * 0.8**3 / 3.0]], atol=1e-12)
    sheared = columns("link_bending", EFFECTS["link_bending"].law("bending"), context)["shear1"]
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
    column = columns("tracker_scale", EFFECTS["tracker_scale"].law())["scale"]
    assert column.unit == "m/m"
    np.testing.assert_allclose(shifts(column), misread(stretched=lambda az, el: 1.0), atol=1e-9)


def test_a_scale_may_follow_the_air():
    law = next(law for law in EFFECTS["tracker_scale"].laws(CONTEXT) if law.name == "air")
    column = columns("tracker_scale", law)["scale_air"]
    air_c = CONTEXT.conditions.air_c
    assert air_c is not None
    assert column.unit == "1/K"
    np.testing.assert_allclose(shifts(column), (air_c - air_c.mean())[:, None] * CONTEXT.p_M, atol=1e-12)


def test_a_distance_offset_lengthens_all_distances():
    column = columns("tracker_distance_offset", EFFECTS["tracker_distance_offset"].law())["distance_offset"]
    assert column.unit == "m"
    np.testing.assert_allclose(shifts(column), misread(longer=lambda az, el: 1.0), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("wave", "function"), [("cos", np.cos), ("sin", np.sin)])
def test_angles_err_with_their_own_orders(order, wave, function):
    found = columns("tracker_angle_error", EFFECTS["tracker_angle_error"].law("orders"))
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


def test_a_target_that_faces_the_tracker_has_no_error():
    back = -CONTEXT.p_M[0] / np.linalg.norm(CONTEXT.p_M[0])
    for column in columns("target_incidence", EFFECTS["target_incidence"].law("lateral"), looking(back)).values():
        np.testing.assert_allclose(shifts(column)[0], 0.0, atol=1e-12)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 50.0, 89.0])
def test_an_inclined_target_has_radial_and_lateral_errors(degrees):
    beam = CONTEXT.p_M[0] / np.linalg.norm(CONTEXT.p_M[0])
    aside = np.cross(beam, [0.3, -0.5, 0.8])
    aside /= np.linalg.norm(aside)
    angle = np.deg2rad(degrees)
    found = columns(
        "target_incidence",
        EFFECTS["target_incidence"].law("lateral"),
        looking(-np.cos(angle) * beam + np.sin(angle) * aside),
    )
    np.testing.assert_allclose(shifts(found["incidence_radial"])[0], (1.0 - np.cos(angle)) * beam, atol=1e-12)
    np.testing.assert_allclose(shifts(found["incidence_lateral"])[0], np.sin(angle) * aside, atol=1e-12)


def test_the_simplest_law_of_incidence_is_radial():
    assert list(columns("target_incidence", EFFECTS["target_incidence"].law("radial"))) == ["incidence_radial"]
    assert [law.name for law in EFFECTS["target_incidence"].laws(CONTEXT)] == ["radial", "lateral"]
