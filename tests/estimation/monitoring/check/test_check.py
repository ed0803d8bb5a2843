"""The check finds, names and solves for what changed, and calls an unchanged cell valid."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2, kstest

from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.discovery.prior_fit import Prior, posterior
from cellapp.estimation.monitoring.belief import CheckBelief, arm_belief, check_belief
from cellapp.estimation.monitoring.causes import Design, MinPValueTest, after, log_valid
from cellapp.estimation.monitoring.linear import Moments, StopRows, directions_of, stop_rows
from cellapp.estimation.monitoring.records import CheckResult
from cellapp.estimation.monitoring.sequential import SequentialTest
from cellapp.estimation.readings import Readings, joined
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, parameter_names
from cellapp.robot.kinematics.transforms import apply, invert, rotation_from_vector, transform
from cellapp.robot.model import CellModel
from tests.arms import effect_term
from tests.estimation.monitoring.check.conftest import (
    SIGMA_M,
    SimulatedCell,
    decided_prefix,
    first_stops,
    moved_base,
    with_parameter,
)
from tests.sure import sure
from tests.twin import small_twin

PLANNED = 16
SLOWLY = partial(pytest.param, marks=pytest.mark.slow)


def checked(cell: SimulatedCell, changed: dict[str, Geometry] | None = None) -> tuple[CheckResult, SequentialTest]:
    """The check of a cell, stop by stop, of which some arms have another true geometry now."""
    stops = cell.chosen(PLANNED)
    readings = cell.measured(stops, 0, **(changed or {}))
    test = SequentialTest(cell.design, PLANNED)
    for stop in range(PLANNED):
        if test.add({name: its.take([stop]) for name, its in readings.items()}).sure:
            break
    return test.conclusion(), test


@pytest.mark.parametrize("cell", ["pair", SLOWLY("single"), "seven"])
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
        assert sure(arm.left_mm) < 0.02


@pytest.mark.parametrize(
    ("word", "change", "what"),
    [
        ("a2", 5e-5, "length a of link 2"),
        ("theta2", -5e-5, "zero of joint 2"),
        SLOWLY("a3", -1e-4, "length a of link 3"),
    ],
)
def test_changed_parameter_is_named_with_its_size(pair: SimulatedCell, word: str, change: float, what: str) -> None:
    place = parameter_names(6).index(word)
    found, _ = checked(pair, {"left": with_parameter(pair.true["left"], place, change)})
    assert found.verdict == "arm changed"
    (one,) = found.changes
    assert (one.arm, one.what) == ("left", what)
    assert abs(sure(one.value) - change) < 4.0 * sure(one.standard_error)
    assert one.p_value < 1e-4
    assert found.arms["left"].left_mm == pytest.approx(one.moved_mm, rel=0.1)
    assert sure(found.arms["right"].left_mm) < 0.02


@pytest.mark.parametrize(("word", "joint"), [SLOWLY("theta5", 5), ("theta6", 6)])
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


@pytest.mark.parametrize("size", [1e-4, SLOWLY(0.03)], ids=["small", "large"])
def test_moved_tracker_is_solved_for(pair: SimulatedCell, size: float) -> None:
    shift, rotation = [size, -2 * size, size], [0.5 * size, size, -size]
    changed = {name: moved_base(true, shift, rotation) for name, true in pair.true.items()}
    found, _ = checked(pair, changed)
    assert found.verdict == "tracker moved"
    points = pair.belief.arms["left"].measured.readings.p_M
    true = apply(transform(rotation_from_vector(rotation), shift), points)
    assert np.linalg.norm(apply(np.array(sure(found.T_new_old)), points) - true, axis=1).max() < 6e-5


@pytest.mark.parametrize("size", [SLOWLY(2e-4), 0.02], ids=["small", "large"])
def test_moved_base_is_solved_for(pair: SimulatedCell, size: float) -> None:
    changed = moved_base(pair.true["right"], [size, size, -size], [size, -size, size])
    found, _ = checked(pair, {"right": changed})
    assert found.verdict == "base moved"
    assert found.changes[0].what == "base of arm right"
    # where the base is depends on the zeros of the calibration; that it carries the arm's points there does not
    arm = pair.belief.arms["right"]
    motion = np.array(found.moved_bases["right"]) @ invert(arm.model.geometry.T_M_B())
    true = changed.T_M_B() @ invert(pair.true["right"].T_M_B())
    points = arm.measured.readings.p_M
    assert np.linalg.norm(apply(motion, points) - apply(true, points), axis=1).max() < 6e-5


def test_remounted_smr_is_solved_for(pair: SimulatedCell) -> None:
    true = pair.true["left"]
    tool = true.tool + np.array([3e-4, -2e-4, 4e-4])
    found, _ = checked(pair, {"left": replace(true, tool=tool)})
    assert found.verdict == "smr moved"
    before = pair.belief.arms["left"].model.geometry.tool
    np.testing.assert_allclose(np.array(found.smr_offsets_F["left"]) - before, tool - true.tool, atol=5e-5)


def test_a_station_that_was_located_since_is_as_uncertain_as_it_states(pair: SimulatedCell) -> None:
    off = transform(rotation_from_vector([1e-4, -1e-4, 1e-4]), np.array([1e-4, 2e-4, -1e-4]))
    moved = {name: true.with_T_M_B(off @ true.T_M_B()) for name, true in pair.true.items()}
    assert checked(pair, moved)[0].verdict == "tracker moved"
    located = replace(pair, belief=replace(pair.belief, station=np.diag([2e-4**2] * 3 + [1e-4**2] * 3)))
    found, _ = checked(located, moved)
    assert found.verdict == "valid"
    place = parameter_names(6).index("a2")
    found, _ = checked(located, moved | {"left": with_parameter(moved["left"], place, 1e-4)})
    assert (found.verdict, found.changes[0].what) == ("arm changed", "length a of link 2")


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
    stops = pair.chosen(PLANNED)
    readings = pair.measured(stops, 0)
    wild = np.random.default_rng(5).normal(0.0, 2e-4, (PLANNED, 3))
    readings["left"].p_M.flat[:] += wild.ravel()
    test = SequentialTest(pair.design, PLANNED)
    test.add(readings)
    assert test.conclusion().verdict == "not explained"


def test_bad_readings_are_refused(pair: SimulatedCell) -> None:
    test = SequentialTest(pair.design, PLANNED)
    with pytest.raises(InputError, match="no stop was measured"):
        test.conclusion()
    readings = pair.measured([0, 1], 0)
    with pytest.raises(InputError, match="no arm 'third'"):
        test.add({"third": readings["left"]})
    readings["left"].p_M[0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        test.add(readings)
    assert test.state.stops == 0


def test_one_point_that_stands_alone_is_no_change(pair: SimulatedCell) -> None:
    stops = pair.chosen(PLANNED)
    readings = pair.measured(stops, 0)
    readings["left"].p_M[3] += [4e-4, -3e-4, 5e-4]
    test = SequentialTest(pair.design, PLANNED)
    test.add(readings)
    found = test.conclusion()
    assert found.verdict == "not decided"
    assert not found.changes
    assert all(arm.left_mm is None for arm in found.arms.values())
    assert any("one point alone" in note for note in found.notes)


def test_few_noisy_stops_decide_nothing_and_state_what_they_would_find(pair: SimulatedCell) -> None:
    readings = pair.measured([1, 2], 0)
    test = SequentialTest(pair.design, 2)
    state = test.add(readings)
    found = test.conclusion()
    assert state.sure
    assert not state.changed
    assert found.verdict == "not decided"
    assert found.weak
    visible = {(arm, what): size for arm, own in found.visible.items() for what, size in own.items()}
    assert all(one.detected > visible[one.arm, one.what] for one in found.weak if one.unit == "rad")
    assert min(visible.values()) >= 1e-9
    assert any("found from" in note for note in found.notes)


def test_motions_that_do_not_converge_are_an_error_and_no_verdict(
    pair: SimulatedCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = moved_base(pair.true["right"], [0.3, -0.2, 0.1], [1.0, -0.5, 0.5])
    monkeypatch.setattr("cellapp.estimation.monitoring.causes._STEPS", 0)
    with pytest.raises(NotConverged, match="fit of a motion to the stops did not converge: 0 steps were not enough"):
        checked(pair, {"right": changed})


# -- What a calibration promises: relocated trackers, scatter that was not learned from, effects of the day ------------


@pytest.fixture(scope="module")
def profile() -> Profile:
    return small_twin()


def stored(pair: SimulatedCell) -> tuple[CellModel, dict[str, Readings]]:
    """The pair as a calibration in a run."""
    arms = pair.belief.arms
    return CellModel({name: arm.model for name, arm in arms.items()}), {
        name: arm.measured.readings for name, arm in arms.items()
    }


def test_an_arm_without_readings_is_refused(pair: SimulatedCell, profile: Profile) -> None:
    model, known = stored(pair)
    with pytest.raises(InputError, match="arm 'right': the calibration has no readings"):
        check_belief(profile, model, {"left": known["left"]})


def posterior_of(pair: SimulatedCell, readings: Readings, conditions: MeasurementConditions) -> CheckBelief:
    arm = pair.belief.arms["left"]
    bare = replace(arm.model, effects=())
    prior = Prior(arm.columns, bare.nominal, np.zeros(len(arm.columns)), 1e6 * np.eye(len(arm.columns)))
    measured = measured_quantities(readings, conditions)
    return CheckBelief({"left": arm_belief(posterior(bare, measured, prior), measured)})


def test_what_comes_again_is_expected_and_what_may_not_is_scatter(pair: SimulatedCell) -> None:
    its = pair.belief.arms["left"].measured.readings
    conditions = MeasurementConditions(approach=its.approach)
    calm = posterior_of(pair, its, conditions).arms["left"]
    assert [calm.of_points.noise, calm.of_points.again] == [pytest.approx(SIGMA_M, rel=0.02), pytest.approx(0.0)]
    errors = np.random.default_rng(1).normal(0.0, 10 * SIGMA_M, its.p_M.shape)
    wild = posterior_of(pair, replace(its, p_M=its.p_M + errors), conditions)
    scatter = wild.arms["left"].of_points
    assert scatter.whole == pytest.approx(10 * SIGMA_M, rel=0.1)
    assert scatter.again > 0.9
    assert 2.0 * SIGMA_M < scatter.noise < 4.0 * SIGMA_M  # of the tracker and the arm's repeatability, then and now
    here = pair.measured([1, 20, 40, 60], 0)["left"]
    here = replace(here, p_M=here.p_M + errors[[1, 20, 40, 60]])
    for belief, expected in ((wild, 3.0), (CheckBelief({"left": calm}), 10.0)):
        left = stop_rows(belief, {"left": here}, directions_of(belief)).residuals
        assert np.sqrt(np.mean(left**2)) == pytest.approx(expected * SIGMA_M, rel=0.6)


def test_stops_with_long_levers_scatter_as_stated_when_joints_do_not_repeat(pair: SimulatedCell) -> None:
    known, rng, found = pair.belief.arms["left"], np.random.default_rng(5), []
    its, model = known.measured.readings, known.model

    def again(stops: NDArray[np.intp], seed: int) -> Readings:
        here = replace(pair.measured(stops, seed)["left"], approach=its.approach[stops])
        new = model.predict(here.q + rng.normal(0.0, 5e-5, here.q.shape)) - model.predict(here.q)
        return replace(here, p_M=here.p_M + new)

    far = np.argsort(np.linalg.norm(its.p_M - model.geometry.T_M_B()[:3, 3], axis=1))[-12:]
    for seed in range(6):
        calibrated = again(np.arange(len(its)), seed)
        belief = posterior_of(pair, calibrated, MeasurementConditions(approach=its.approach))
        moments = Moments.of(stop_rows(belief, {"left": again(far, 100 + seed)}, directions_of(belief)))
        found.append(moments.white @ moments.white / len(moments.white))
    assert 0.6 < np.mean(found) < 1.5


def test_the_same_side_of_a_stop_that_was_measured_from_both_comes_again(pair: SimulatedCell) -> None:
    its = pair.belief.arms["left"].measured.readings
    its = joined([replace(its, approach=np.full_like(its.approach, side)) for side in (-1, 1)])
    errors = 2e-4 * np.repeat([-1.0, 1.0], len(its) // 2)[:, None]
    known = replace(its, p_M=its.p_M + errors)
    belief = posterior_of(pair, known, MeasurementConditions(approach=its.approach))
    for rows in ([1, 20, 40], np.array([1, 20, 40]) + len(its) // 2):
        left = stop_rows(belief, {"left": known.take(np.asarray(rows))}, directions_of(belief)).residuals
        assert np.sqrt(np.mean(left**2)) < 5e-5


def test_drift_of_the_day_hides_as_large_a_motion_of_the_base(pair: SimulatedCell) -> None:
    arm = pair.belief.arms["left"]
    its = arm.measured.readings
    conditions = MeasurementConditions(approach=its.approach, time_s=np.linspace(0.0, 4000.0, len(its)))
    effect = EFFECTS["base_drift"]
    context = arm.model.context(its.q, conditions=conditions)
    law = effect.laws(context)[0]
    columns = effect.columns(context, law)[:3]
    drifting = replace(arm.model, effects=(effect_term("base_drift", {c.name: 1e-4 for c in columns}, "m", law=law),))
    readings = replace(its, p_M=its.p_M + drifting.predict(its.q, conditions=conditions) - arm.model.predict(its.q))
    measured = measured_quantities(readings, conditions)
    count = len(arm.columns) + 3
    prior = Prior(arm.columns, arm.model.nominal, np.zeros(count), np.diag(np.r_[np.full(count - 3, 1e6), 0, 0, 0]))
    belief = arm_belief(posterior(drifting, measured, prior), measured)
    assert belief.day_m == pytest.approx(1e-4, rel=0.2)  # sqrt(3) 0.1 mm at the end, a third of its square on average
    still, moved = CheckBelief({"left": arm}), CheckBelief({"left": belief})
    here = {"left": pair.measured([1, 20, 40, 60], 0)["left"]}
    gained = [stop_rows(one, here, directions_of(one)) for one in (still, moved)]
    spread = [np.sqrt(np.mean(np.sum(one.factor**2, axis=1))) for one in gained]
    assert spread[0] < 2.0 * SIGMA_M
    assert 4e-5 < spread[1] < 1e-4


# -- Statistics of a check: p-values, false alarms, power --------------------------------------------------------------


PLANNED_OF_STATISTICS = 12
SAMPLES = 200
COUNTS = range(1, PLANNED_OF_STATISTICS + 1)


@pytest.fixture(scope="module")
def checked_of_statistics(pair: SimulatedCell) -> tuple[Design, StopRows]:
    """A check of the pair after twelve stops."""
    return of(pair)


def of(cell: SimulatedCell) -> tuple[Design, StopRows]:
    order = cell.chosen(PLANNED_OF_STATISTICS)
    return cell.design, stop_rows(cell.belief, cell.measured(order, 0), cell.design.directions)


def drawn(moments: Moments, count: int, direction: int | None = None) -> list[Moments]:
    """Moments of readings drawn from the belief, with or without one step of a direction."""
    shift = 0.0 if direction is None else moments.directions[direction]
    white = np.random.default_rng(8).standard_normal((count, len(moments.white))) + shift
    return [replace(moments, white=row) for row in white]


def at_most(count: int, chance: float) -> int:
    """The number of cases of a chance that is exceeded once in 10000."""
    return int(binom.isf(1e-4, count, chance))


def test_p_values_without_a_change_are_uniform(checked_of_statistics: tuple[Design, StopRows]) -> None:
    design, stops = checked_of_statistics
    moments = Moments.of(stops)
    test = MinPValueTest.of(moments, design.alternatives)
    count = 8000
    white = np.random.default_rng(3).standard_normal((len(moments.white), count))
    least = test.p_values(white).min(axis=0)
    # as many draws stand behind the correction: the two distributions differ by 0.008 sd anywhere
    assert kstest([test.corrected(float(p)) for p in least], "uniform").statistic < 0.03
    assert np.sum(least <= test.critical(0.01)) <= at_most(count, 0.012)  # its quantile is known to a tenth
    assert kstest(chi2.sf(np.sum(white**2, axis=0), len(white)), "uniform").statistic < 0.022


@pytest.mark.slow
def test_whole_check_keeps_its_false_alarms(checked_of_statistics: tuple[Design, StopRows]) -> None:
    design, stops = checked_of_statistics
    count = SAMPLES // 2
    noise = np.random.default_rng(4).standard_normal((count, len(stops.factor))) @ stops.factor.T
    loose = replace(design, false_alarm=0.1)
    found = [decided_prefix(loose, replace(stops, measured=stops.expected + row.reshape(-1, 3))) for row in noise]
    assert sum(one.changed for one in found) <= at_most(count, 0.1)
    assert np.mean([one.stops for one in found]) < PLANNED_OF_STATISTICS


def test_looking_after_every_stop_keeps_what_is_stated(checked_of_statistics: tuple[Design, StopRows]) -> None:
    """A change is found, or a visible one called valid, at any of the stops no more often than at the stated rate."""
    design, stops = checked_of_statistics
    whole, limit = Moments.of(stops), 0.1
    tests = [MinPValueTest.of(Moments.of(first_stops(stops, count)), design.alternatives) for count in COUNTS]

    def parts(moments: Moments) -> list[Moments]:
        """The first stops of whitened readings, which are those of the first stops alone."""
        ends = stops.stop_ends[np.array(COUNTS) - 1].tolist()
        return [replace(moments, white=moments.white[:d], directions=moments.directions[:, :d]) for d in ends]

    def alarms(moments: Moments) -> bool:
        looks = zip(tests, parts(moments), strict=True)
        return any(test.bound(test.least(one)) * len(COUNTS) <= limit for test, one in looks)

    assert sum(map(alarms, drawn(whole, SAMPLES))) <= at_most(SAMPLES, limit)
    weakest = int(np.argmin(np.where(design.visible, whole.information, np.inf)))
    missed = sum(
        any(log_valid(one, design.alternatives, design.visible) >= -np.log(limit) for one in parts(moments))
        for moments in drawn(whole, SAMPLES, weakest)
    )
    assert missed <= at_most(SAMPLES, limit)


def test_chosen_stops_show_the_weakest_change_better_than_random_ones(pair: SimulatedCell) -> None:
    order = pair.chosen(PLANNED_OF_STATISTICS)
    assert len(set(order.tolist())) == PLANNED_OF_STATISTICS

    def weakest(order: NDArray[np.intp]) -> float:
        moments = Moments.of(stop_rows(pair.belief, pair.measured(order, 0), pair.design.directions))
        return float(moments.information[pair.design.visible].min())

    rng = np.random.default_rng(0)
    some = [rng.permutation(150)[:PLANNED_OF_STATISTICS] for _ in range(10)]
    half = PLANNED_OF_STATISTICS // 2 + 1
    assert weakest(order[:half]) > max(weakest(one[:half]) for one in some)
    assert weakest(order) > np.median([weakest(one) for one in some])


def test_a_fit_takes_its_degrees_of_freedom(checked_of_statistics: tuple[Design, StopRows]) -> None:
    _, stops = checked_of_statistics
    moments = after(Moments.of(stops), [0, 1, 2, 9])
    assert moments.degrees == 6 * PLANNED_OF_STATISTICS - 4
    draws = np.random.default_rng(1).standard_normal((4000, len(moments.white)))
    left = draws - (draws @ moments.fitted.T) @ moments.fitted
    p_values = MinPValueTest.of(moments, ()).p_values(left.T)[-1]
    assert kstest(p_values, "uniform").statistic < 0.035
