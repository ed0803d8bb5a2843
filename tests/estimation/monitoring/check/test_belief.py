"""What a calibration promises: relocated trackers, scatter that was not learned from, effects of the day."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check import CheckBelief, SequentialTest, check_belief, choose_stops
from cellapp.estimation.monitoring.check.belief import arm_belief
from cellapp.estimation.monitoring.check.linear import calibration_motions, directions_of, stop_rows, visibility
from cellapp.estimation.prior.belief import Measured, Prior, posterior
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.transforms import apply, rotation_from_vector, transform
from cellapp.robot.model import CellModel
from tests.estimation.monitoring.check.conftest import SIGMA_M, SimulatedCell, readings_of
from tests.twin import small_twin

pytestmark = pytest.mark.fast
T = transform(rotation_from_vector(np.array([0.2, -0.3, 1.2])), np.array([0.4, -1.0, 0.2]))


@pytest.fixture(scope="module")
def profile() -> Profile:
    return small_twin()


def stored(pair: SimulatedCell) -> tuple[CellModel, dict[str, Readings]]:
    """The pair as a calibration in a run."""
    arms = pair.belief.arms
    return CellModel({name: arm.stored for name, arm in arms.items()}), {
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
    prior = Prior(arm.columns, arm.stored.nominal, np.zeros(len(arm.columns)), 1e6 * np.eye(len(arm.columns)))
    measured = Measured.of(readings, conditions)
    return CheckBelief({"left": arm_belief(arm.stored, posterior(arm.stored, measured, prior), measured)})


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
    context = arm.stored.context(its.q, conditions=conditions)
    law = effect.laws(context)[0]
    columns = effect.columns(context, law)[:3]
    values = np.full(3, 1e-4)
    term = EffectTerm(
        "base_drift", tuple(c.name for c in columns), values, 0 * values, tuple(c.unit for c in columns), law
    )
    drifting = replace(arm.stored, effects=(term,))
    readings = replace(its, p_M=its.p_M + drifting.predict(its.q, conditions=conditions) - arm.stored.predict(its.q))
    measured = Measured.of(readings, conditions)
    count = len(arm.columns) + 3
    prior = Prior(arm.columns, arm.stored.nominal, np.zeros(count), np.diag(np.r_[np.full(count - 3, 1e6), 0, 0, 0]))
    belief = arm_belief(drifting, posterior(drifting, measured, prior), measured)
    assert belief.day_m == pytest.approx(1e-4, rel=0.2)  # sqrt(3) 0.1 mm at the end, a third of its square on average
    still, moved = CheckBelief({"left": arm}), CheckBelief({"left": belief})
    here = {"left": pair.measured([1, 20, 40, 60], 0)["left"]}
    gained = [stop_rows(one, here, directions_of(one)) for one in (still, moved)]
    spread = [np.sqrt(np.mean(np.sum(one.factor**2, axis=1))) for one in gained]
    assert spread[0] < 2.0 * SIGMA_M
    assert 4e-5 < spread[1] < 1e-4


@pytest.mark.slow
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


@pytest.mark.slow
def test_stops_are_approached_from_where_the_arm_is(pair: SimulatedCell) -> None:
    homes = {name: q[5] for name, q in pair.candidates.items()}
    few = {name: q[:40] for name, q in pair.candidates.items()}
    chosen = choose_stops(pair.belief, few, 60, start=homes)
    assert sorted(chosen.order.tolist()) == list(range(40))
    plays = [one for one in chosen.power if one.kind == "effect" and "backlash" in one.what]
    assert len(plays) == 12
    assert min(one.noncentrality for one in plays) > chosen.needed
