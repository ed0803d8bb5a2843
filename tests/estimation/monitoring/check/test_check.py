"""The check finds, names and solves for what changed, and calls an unchanged cell valid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check import CheckBelief, Conclusion, SequentialTest, check_belief, choose_stops
from cellapp.estimation.monitoring.check.belief import Power, arm_belief
from cellapp.estimation.monitoring.check.linear import GROWTH, calibration_motions, directions_of, stop_rows, visibility
from cellapp.estimation.prior.belief import Measured, Prior, posterior
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, parameter_names
from cellapp.robot.kinematics.transforms import apply, invert, rotation_from_vector, transform
from cellapp.robot.model import CellModel
from tests.estimation.monitoring.check.conftest import (
    SIGMA_M,
    SimulatedCell,
    free,
    moved_base,
    readings_of,
    with_parameter,
)
from tests.twin import small_twin

PLANNED = 16


def visible_changes(cell: SimulatedCell) -> list[Power]:
    """The changes that stops at all candidates show."""
    return [one for one in choose_stops(cell.belief, cell.candidates, PLANNED).power if one.visible]


def positions(cell: SimulatedCell) -> Measured:
    """The readings of its calibration without orientation."""
    return cell.belief.arms["only"].positions


def checked(cell: SimulatedCell, changed: dict[str, Geometry] | None = None) -> tuple[Conclusion, SequentialTest]:
    """The check of a cell, stop by stop, of which some arms have another true geometry now."""
    stops = choose_stops(cell.belief, cell.candidates, PLANNED).order
    readings = cell.measured(stops, 0, **(changed or {}))
    test = SequentialTest(cell.belief, PLANNED)
    for stop in range(PLANNED):
        if test.add({name: its.take([stop]) for name, its in readings.items()}).sure:
            break
    return test.conclusion(), test


@pytest.mark.parametrize("cell", ["pair", "single", "seven"])
def test_unchanged_cell_is_valid_before_the_last_stop(cell: str, request: pytest.FixtureRequest) -> None:
    found, test = checked(request.getfixturevalue(cell))
    assert found.verdict == "valid"
    assert not found.changes
    assert found.T_new_old is None
    assert found.sure_after < PLANNED
    assert test.state.sure
    assert not test.state.changed
    for arm in found.arms.values():
        assert arm.rms_mm == pytest.approx(arm.expected_mm, rel=0.5)
        assert arm.left_mm is not None
        assert arm.left_mm < 0.02


@pytest.mark.parametrize(
    ("word", "change", "what"),
    [("a2", 5e-5, "length a of link 2"), ("theta2", -5e-5, "zero of joint 2"), ("a3", -1e-4, "length a of link 3")],
)
def test_changed_parameter_is_named_with_its_size(pair: SimulatedCell, word: str, change: float, what: str) -> None:
    place = parameter_names(6).index(word)
    found, _ = checked(pair, {"left": with_parameter(pair.true["left"], place, change)})
    assert found.verdict == "arm changed"
    (one,) = found.changes
    assert (one.arm, one.what) == ("left", what)
    assert one.value is not None
    assert one.standard_error is not None
    assert abs(one.value - change) < 4.0 * one.standard_error
    assert one.p_value < 1e-4
    assert found.arms["left"].left_mm == pytest.approx(one.moved_mm, rel=0.1)
    assert found.arms["right"].left_mm is not None
    assert found.arms["right"].left_mm < 0.02


@pytest.mark.parametrize(("word", "joint"), [("theta5", 5), ("theta6", 6)])
def test_orientation_names_a_joint_whose_axis_passes_near_the_probe(
    probed: SimulatedCell, word: str, joint: int
) -> None:
    place = parameter_names(6).index(word)
    found, test = checked(probed, {"only": with_parameter(probed.true["only"], place, 1.5e-4)})
    assert found.verdict == "arm changed"
    (one,) = found.changes
    assert one.what == f"zero of joint {joint}"
    assert one.value == pytest.approx(1.5e-4, abs=4.0 * (one.standard_error or 0.0))
    assert one.turned_mrad == pytest.approx(0.15, rel=0.2)
    assert found.arms["only"].rms_mrad is not None
    assert found.arms["only"].expected_mrad == pytest.approx(0.07, rel=0.2)  # 40 urad about each axis
    shown = {one.what for one, seen in zip(test._design.directions, test._design.visible, strict=True) if seen}
    assert f"zero of joint {joint}" in shown


def test_positions_alone_do_not_show_it(probed: SimulatedCell) -> None:
    cell = replace(
        probed,
        belief=replace(probed.belief, arms={"only": replace(probed.belief.arms["only"], measured=positions(probed))}),
    )
    assert not any("zero of joint 6" in one.what for one in visible_changes(cell))
    assert any("zero of joint 6" in one.what for one in visible_changes(probed))


@pytest.mark.parametrize("size", [1e-4, 0.03], ids=["small", "large"])
def test_moved_tracker_and_base_turn_orientations_too(probed: SimulatedCell, size: float) -> None:
    changed = moved_base(probed.true["only"], [size, -size, size], [size, size, -size])
    found, _ = checked(free(probed), {"only": changed})
    assert found.verdict in ("valid", "cannot say")  # a station that was set up anew is no change
    assert not found.changes
    assert found.T_new_old is not None
    points = probed.belief.arms["only"].positions.readings.p_M
    true = apply(transform(rotation_from_vector([size, size, -size]), [size, -size, size]), points)
    assert np.linalg.norm(apply(found.T_new_old, points) - true, axis=1).max() < 6e-5


@pytest.mark.parametrize("size", [1e-4, 0.03], ids=["small", "large"])
def test_moved_tracker_is_solved_for(pair: SimulatedCell, size: float) -> None:
    shift, turn = [size, -2 * size, size], [0.5 * size, size, -size]
    changed = {name: moved_base(true, shift, turn) for name, true in pair.true.items()}
    found, _ = checked(pair, changed)
    assert found.verdict == "tracker moved"
    assert found.T_new_old is not None
    points = pair.belief.arms["left"].measured.readings.p_M
    true = apply(transform(rotation_from_vector(turn), shift), points)
    assert np.linalg.norm(apply(found.T_new_old, points) - true, axis=1).max() < 6e-5


@pytest.mark.parametrize("size", [2e-4, 0.02], ids=["small", "large"])
def test_moved_base_is_solved_for(pair: SimulatedCell, size: float) -> None:
    changed = moved_base(pair.true["right"], [size, size, -size], [size, -size, size])
    found, _ = checked(pair, {"right": changed})
    assert found.verdict == "base moved"
    assert found.changes[0].what == "base of arm right"
    # where the base is depends on the zeros of the calibration; that it carries the arm's points there does not
    arm = pair.belief.arms["right"]
    motion = found.moved_bases["right"] @ invert(arm.model.geometry.T_M_B())
    true = changed.T_M_B() @ invert(pair.true["right"].T_M_B())
    points = arm.measured.readings.p_M
    assert np.linalg.norm(apply(motion, points) - apply(true, points), axis=1).max() < 6e-5


def test_remounted_smr_is_solved_for(pair: SimulatedCell) -> None:
    true = pair.true["left"]
    tool = true.tool + np.array([3e-4, -2e-4, 4e-4])
    found, _ = checked(pair, {"left": replace(true, tool=tool)})
    assert found.verdict == "smr moved"
    before = pair.belief.arms["left"].model.geometry.tool
    np.testing.assert_allclose(found.smr_offsets_F["left"] - before, tool - true.tool, atol=5e-5)


def test_of_one_arm_a_moved_tracker_and_a_moved_base_are_the_same(single: SimulatedCell) -> None:
    found, _ = checked(single, {"only": moved_base(single.true["only"], [2e-4, 1e-4, -1e-4], [2e-4, 1e-4, 1e-4])})
    assert found.verdict == "tracker moved"
    assert found.changes[0].rivals == ("base of arm only",)
    assert any("base of arm only" in note for note in found.notes)


def test_tracker_that_was_set_up_anew_is_no_change(pair: SimulatedCell) -> None:
    shift, turn = [0.02, -0.03, 0.01], [0.01, 0.02, -0.01]
    moved = {name: moved_base(true, shift, turn) for name, true in pair.true.items()}
    found, _ = checked(free(pair), moved)
    assert found.verdict == "valid"
    assert found.T_new_old is not None
    np.testing.assert_allclose(found.T_new_old, transform(rotation_from_vector(turn), shift), atol=2e-4)
    place = parameter_names(6).index("a2")
    changed = moved | {"left": with_parameter(moved["left"], place, 5e-5)}
    found, _ = checked(free(pair), changed)
    assert found.verdict == "arm changed"
    assert found.changes[0].what == "length a of link 2"


def test_first_points_only_tell_where_a_tracker_that_was_set_up_anew_stands(single: SimulatedCell) -> None:
    far = {"only": moved_base(single.true["only"], [0.3, -0.2, 0.1], [0.1, 0.2, -0.1])}
    cell = free(single)
    readings = cell.measured([3, 8, 20], 0, **far)["only"]
    test = SequentialTest(cell.belief, PLANNED)
    for stop in range(3):
        state = test.add({"only": readings.take([stop])})
        assert not state.changed
        assert not state.sure
    assert state.p_value > 1e-3


def test_two_changes_are_both_named(pair: SimulatedCell) -> None:
    names = parameter_names(6)
    left = with_parameter(pair.true["left"], names.index("a2"), 2e-4)
    right = with_parameter(pair.true["right"], names.index("theta2"), 3e-4)
    found, _ = checked(pair, {"left": left, "right": right})
    assert {(one.arm, one.what) for one in found.changes} == {
        ("left", "length a of link 2"),
        ("right", "zero of joint 2"),
    }


def test_what_no_change_explains_is_said(pair: SimulatedCell) -> None:
    stops = choose_stops(pair.belief, pair.candidates, PLANNED).order
    readings = pair.measured(stops, 0)
    wild = np.random.default_rng(5).normal(0.0, 2e-4, (PLANNED, 3))
    readings["left"].p_M.flat[:] += wild.ravel()
    test = SequentialTest(pair.belief, PLANNED)
    test.add(readings)
    assert test.conclusion().verdict == "not explained"


def test_bad_readings_are_refused(pair: SimulatedCell) -> None:
    test = SequentialTest(pair.belief, PLANNED)
    with pytest.raises(InputError, match="no stop was measured"):
        test.conclusion()
    readings = pair.measured([0, 1], 0)
    with pytest.raises(InputError, match="no arm 'third'"):
        test.add({"third": readings["left"]})
    readings["left"].p_M[0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        test.add(readings)
    assert test.state.stops == 0


def test_stops_without_one_of_the_arms_count_in_their_order(pair: SimulatedCell) -> None:
    readings = pair.measured([0, 1, 2, 3, 4, 5], 0)
    late = {"left": readings["left"], "right": readings["right"].take([0, 4, 5])}
    whole, parts = SequentialTest(pair.belief, PLANNED), SequentialTest(pair.belief, PLANNED)
    whole.add(late)
    seen = []
    for stop in range(6):
        some = {name: its.take(its.configuration == stop) for name, its in late.items()}
        seen.append(parts.add(some).stops)
    assert seen == [1, 2, 3, 4, 5, 6]
    assert parts.state.p_value == pytest.approx(whole.state.p_value, rel=1e-9)
    assert parts.state.log_evidence == pytest.approx(whole.state.log_evidence, rel=1e-9)


def test_one_point_that_stands_alone_is_no_change(pair: SimulatedCell) -> None:
    stops = choose_stops(pair.belief, pair.candidates, PLANNED).order
    readings = pair.measured(stops, 0)
    readings["left"].p_M[3] += [4e-4, -3e-4, 5e-4]
    test = SequentialTest(pair.belief, PLANNED)
    test.add(readings)
    found = test.conclusion()
    assert found.verdict == "cannot say"
    assert not found.changes
    assert all(arm.left_mm is None for arm in found.arms.values())
    assert any("one point alone" in note for note in found.notes)


def test_few_noisy_stops_cannot_say_and_state_what_they_would_find(pair: SimulatedCell) -> None:
    readings = pair.measured([1, 2], 0)
    test = SequentialTest(pair.belief, 2)
    state = test.add(readings)
    found = test.conclusion()
    assert state.sure
    assert not state.changed
    assert found.verdict == "cannot say"
    assert found.weak
    assert all(one.visible and one.detected > 5e-5 for one in found.weak if one.kind != "effect")
    assert any("found from" in note for note in found.notes)


def test_a_warmer_arm_has_grown(pair: SimulatedCell) -> None:
    true = pair.true["left"]
    rows = true.rows.copy()
    rows[:, 1:3] *= 1.0 + 1.2e-4  # ten degrees of steel, five of aluminium
    found, _ = checked(pair, {"left": replace(true, rows=rows)})
    assert found.verdict == "arm changed"
    assert found.changes[0].what == GROWTH
    assert found.changes[0].value == pytest.approx(1.2e-4, rel=0.3)


def test_motions_that_do_not_converge_are_an_error_and_no_verdict(
    pair: SimulatedCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = moved_base(pair.true["right"], [0.3, -0.2, 0.1], [1.0, -0.5, 0.5])
    monkeypatch.setattr("cellapp.estimation.monitoring.check.naming._STEPS", 1)
    with pytest.raises(NotConverged, match="fit of motions to the stops did not converge: the last of at most 1 steps"):
        checked(pair, {"right": changed})


# -- What a calibration promises: relocated trackers, scatter that was not learned from, effects of the day ------------

T = transform(rotation_from_vector(np.array([0.2, -0.3, 1.2])), np.array([0.4, -1.0, 0.2]))


@pytest.fixture(scope="module")
def profile() -> Profile:
    return small_twin()


def stored(pair: SimulatedCell) -> tuple[CellModel, dict[str, Readings]]:
    """The pair as a calibration in a run."""
    arms = pair.belief.arms
    return CellModel({name: arm.model for name, arm in arms.items()}), {
        name: arm.measured.readings for name, arm in arms.items()
    }


def seen_from(readings: dict[str, Readings]) -> dict[str, Readings]:
    """The readings in the frame of a tracker that stands elsewhere."""
    return {
        name: replace(its, p_M=apply(T, its.p_M))  # the noise is the same in all directions
        for name, its in readings.items()
    }


def test_a_relocated_calibration_says_the_same_in_the_new_frame(pair: SimulatedCell, profile: Profile) -> None:
    model, known = stored(pair)
    here = check_belief(profile, model, known)
    there = check_belief(profile, model, known, T_new_old=T)
    readings = pair.measured([3, 50, 17, 90, 120, 61], 2)
    tests = [SequentialTest(here, 10), SequentialTest(there, 10)]
    ours, theirs = tests[0].add(readings), tests[1].add(seen_from(readings))
    assert theirs.p_value == pytest.approx(ours.p_value, rel=1e-3)
    # the tracker turns about other axes, which are other alternatives; all others are the same
    assert theirs.log_valid == pytest.approx(ours.log_valid, abs=0.3)
    assert tests[1].conclusion().verdict == tests[0].conclusion().verdict


def test_an_arm_without_readings_is_refused(pair: SimulatedCell, profile: Profile) -> None:
    model, known = stored(pair)
    with pytest.raises(InputError, match="arm 'right': the calibration has no readings"):
        check_belief(profile, model, {"left": known["left"]})


def test_expected_errors_are_those_of_new_readings(pair: SimulatedCell) -> None:
    rng = np.random.default_rng(11)
    q = {name: rng.uniform(-2.0, 2.0, (200, 6)) for name in pair.true}
    readings = {
        name: readings_of(true, q[name], np.random.default_rng([k, 5]))
        for k, (name, true) in enumerate(pair.true.items())
    }
    stops = stop_rows(pair.belief, readings, directions_of(pair.belief))
    white = np.linalg.solve(stops.factor, stops.left.ravel())
    assert float(white @ white) / len(white) == pytest.approx(1.0, abs=0.15)


def posterior_of(pair: SimulatedCell, readings: Readings, conditions: MeasurementConditions) -> CheckBelief:
    arm = pair.belief.arms["left"]
    bare = replace(arm.model, effects=())
    prior = Prior(arm.columns, bare.nominal, np.zeros(len(arm.columns)), 1e6 * np.eye(len(arm.columns)))
    measured = Measured.of(readings, conditions)
    return CheckBelief({"left": arm_belief(posterior(bare, measured, prior), measured, bare)})


def test_readings_that_were_not_learned_from_show_the_scatter(pair: SimulatedCell) -> None:
    its = pair.belief.arms["left"].measured.readings
    words = tuple("validate" if k % 3 == 0 else "identify" for k in range(len(its)))
    conditions = MeasurementConditions(approach=its.approach)
    calm = posterior_of(pair, replace(its, split=words), conditions).arms["left"]
    assert calm.noise_m == pytest.approx(SIGMA_M, rel=0.02)
    rough = its.p_M.copy()
    rough[::3] += np.random.default_rng(1).normal(0.0, 4 * SIGMA_M, (len(rough[::3]), 3))
    wild = posterior_of(pair, replace(its, split=words, p_M=rough), conditions).arms["left"]
    assert 2.5 * SIGMA_M < wild.noise_m < 5.5 * SIGMA_M
    assert wild.scatter_m > calm.scatter_m


def test_drift_of_the_day_hides_as_large_a_motion_of_the_base(pair: SimulatedCell) -> None:
    arm = pair.belief.arms["left"]
    its = arm.measured.readings
    conditions = MeasurementConditions(approach=its.approach, time_s=np.linspace(0.0, 4000.0, len(its)))
    effect = EFFECTS["base_drift"]
    context = arm.model.context(its.q, conditions=conditions)
    law = effect.laws(context)[0]
    columns = effect.columns(context, law)[:3]
    values = np.full(3, 1e-4)
    term = EffectTerm(
        "base_drift", tuple(c.name for c in columns), values, 0 * values, tuple(c.unit for c in columns), law
    )
    drifting = replace(arm.model, effects=(term,))
    readings = replace(its, p_M=its.p_M + drifting.predict(its.q, conditions=conditions) - arm.model.predict(its.q))
    measured = Measured.of(readings, conditions)
    count = len(arm.columns) + 3
    prior = Prior(arm.columns, arm.model.nominal, np.zeros(count), np.diag(np.r_[np.full(count - 3, 1e6), 0, 0, 0]))
    belief = arm_belief(posterior(drifting, measured, prior), measured, drifting)
    assert belief.day_m == pytest.approx(1e-4, rel=0.2)  # sqrt(3) 0.1 mm at the end, a third of its square on average
    still, moved = CheckBelief({"left": arm}), CheckBelief({"left": belief})
    here = {"left": pair.measured([1, 20, 40, 60], 0)["left"]}
    gained = [stop_rows(one, here, directions_of(one)) for one in (still, moved)]
    spread = [np.sqrt(np.mean(np.sum(one.factor**2, axis=1))) for one in gained]
    assert spread[0] < 2.0 * SIGMA_M
    assert 4e-5 < spread[1] < 1e-4


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 8))
def test_stops_are_judged_alike_in_any_order(pair: SimulatedCell, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.permutation(100)[:count]
    readings = pair.measured(rows, seed)
    order: NDArray[np.intp] = rng.permutation(count)
    first, second = SequentialTest(pair.belief, 10), SequentialTest(pair.belief, 10)
    ours = first.add(readings)
    theirs = second.add({name: its.take(order) for name, its in readings.items()})
    assert theirs.p_value == pytest.approx(ours.p_value, rel=1e-6)
    assert theirs.log_evidence == pytest.approx(ours.log_evidence, rel=1e-6, abs=1e-6)


def test_what_the_tracker_can_follow_is_less_visible(single: SimulatedCell, pair: SimulatedCell) -> None:
    for cell, visible in ((single, False), (pair, True)):
        directions = directions_of(cell.belief)
        moved, seen = visibility(cell.belief, directions, calibration_motions(cell.belief, directions))
        lengths = [k for k, one in enumerate(directions) if one.what.startswith("length d of link 1")]
        assert all(seen[k] == visible for k in lengths)
        assert moved[lengths].max() < 5e-5
        free = replace(cell.belief, station_free=True)
        assert not visibility(free, directions, calibration_motions(free, directions))[1][:6].any()


def test_stops_are_approached_from_where_the_arm_is(pair: SimulatedCell) -> None:
    homes = {name: q[5] for name, q in pair.candidates.items()}
    few = {name: q[:40] for name, q in pair.candidates.items()}
    chosen = choose_stops(pair.belief, few, 60, start=homes)
    assert sorted(chosen.order.tolist()) == list(range(40))
    plays = [one for one in chosen.power if one.kind == "effect" and "backlash" in one.what]
    assert len(plays) == 12
    assert min(one.noncentrality for one in plays) > chosen.needed
