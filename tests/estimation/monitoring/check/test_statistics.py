"""Error rates of the check are those that it states, by simulation with the belief's own covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import binom, chi2, kstest, ncx2

from cellapp.estimation.monitoring.check import choose_stops
from cellapp.estimation.monitoring.check.linear import Moments, StopRows, stop_rows
from cellapp.estimation.monitoring.check.naming import Design, MinPValueTest, after, looks, with_station
from cellapp.estimation.monitoring.check.sequential import design_of
from cellapp.robot.kinematics.transforms import apply, invert, rotation_from_vector, transform
from tests.estimation.monitoring.check.conftest import SimulatedCell, free
from tests.evidence.shared.estimates import decided_prefix, first_stops

PLANNED = 12
DRAWS = 200


@pytest.fixture(scope="module")
def checked(pair: SimulatedCell) -> tuple[Design, StopRows]:
    """A check of the pair after twelve stops."""
    return of(pair)


def of(cell: SimulatedCell) -> tuple[Design, StopRows]:
    design = design_of(cell.belief)
    order = choose_stops(cell.belief, cell.candidates, PLANNED).order
    return design, stop_rows(cell.belief, cell.measured(order, 0), design.directions)


def drawn(moments: Moments, count: int, direction: int | None = None) -> list[Moments]:
    """Moments of readings drawn from the belief, with or without one step of a direction."""
    shift = 0.0 if direction is None else moments.directions[direction]
    white = np.random.default_rng(8).standard_normal((count, len(moments.white))) + shift
    return [replace(moments, white=row) for row in white]


def at_most(count: int, chance: float) -> int:
    """The number of cases of a chance that is exceeded once in 10000."""
    return int(binom.isf(1e-4, count, chance))


def test_p_values_without_a_change_are_uniform(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    moments = Moments.of(stops)
    test = MinPValueTest.of(moments, design.alternatives)
    count = 8000
    white = np.random.default_rng(3).standard_normal((len(moments.white), count))
    least = test.p_values(white).min(axis=0)
    # as many draws stand behind the correction: the two distributions differ by 0.008 sd anywhere
    assert kstest([test.corrected(float(p)) for p in least], "uniform").statistic < 0.03
    assert np.sum(least <= test.critical(0.01)) <= at_most(count, 0.012)  # its quantile is known to a tenth
    assert kstest(chi2.sf(np.sum(white**2, axis=0), len(white)), "uniform").statistic < 0.022


def test_correction_is_milder_than_bonferroni_and_never_helps(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    test = MinPValueTest.of(Moments.of(stops), design.alternatives)
    for p in (1e-8, 1e-5, 1e-3, 0.3, 1.0):
        assert p <= test.corrected(p) <= (len(design.alternatives) + 1) * p + 1e-9
        assert test.significant(p, 0.01) == (test.corrected(p) <= 0.01)


def test_looking_after_every_stop_does_not_raise_false_alarms(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    moments, limit = Moments.of(stops), 0.1
    alarms = sum(
        bool(np.any(looks(one, design.alternatives, design.visible).log_evidence >= -np.log(limit)))
        for one in drawn(moments, DRAWS)
    )
    assert alarms <= at_most(DRAWS, limit)


@pytest.mark.slow
def test_whole_check_keeps_its_false_alarms(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    count = DRAWS // 2
    noise = np.random.default_rng(4).standard_normal((count, len(stops.factor))) @ stops.factor.T
    loose = replace(design, false_alarm=0.1)
    found = [decided_prefix(loose, replace(stops, measured=stops.expected + row.reshape(-1, 3)))[1] for row in noise]
    assert sum(one.changed for one in found) <= at_most(count, 0.1)
    assert np.mean([one.stops for one in found]) < PLANNED


def test_a_visible_change_is_called_valid_no_more_often_than_stated(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    moments = Moments.of(stops)
    weakest = int(np.argmin(np.where(design.visible, moments.information[-1], np.inf)))
    missed = sum(
        bool(np.any(looks(one, design.alternatives, design.visible).log_valid >= -np.log(0.1)))
        for one in drawn(moments, DRAWS, weakest)
    )
    assert missed <= at_most(DRAWS, 0.1)


def test_power_of_the_last_test_is_as_computed(checked: tuple[Design, StopRows]) -> None:
    design, stops = checked
    moments = Moments.of(stops)
    test = MinPValueTest.of(moments, design.alternatives)
    critical = test.critical(0.01)
    single = [k for one in design.alternatives if len(one.members) == 1 for k in one.members]
    direction = min(single, key=lambda k: abs(float(moments.information[-1][k]) - 12.0))
    place = next(k for k, one in enumerate(design.alternatives) if one.members == (direction,))
    white = np.array([one.white for one in drawn(moments, 2000, direction)]).T
    power = float(np.mean(test.p_values(white)[place] <= critical))
    assert power == pytest.approx(
        ncx2.sf(chi2.isf(critical, 1), 1, float(moments.information[-1][direction])), abs=0.05
    )


def test_a_tracker_that_was_set_up_anew_leaves_no_trace(pair: SimulatedCell) -> None:
    design, stops = of(free(pair))
    motion = transform(rotation_from_vector(np.array([0.01, -0.02, 0.03])), np.array([0.05, 0.02, -0.04]))
    moved = replace(stops, measured=apply(motion, stops.measured))
    for one in (stops, moved):
        fitted = Moments.of(with_station(design, one)[0])
        assert fitted.degrees[-1] == 6 * PLANNED - 6
        assert np.abs(fitted.fitted @ fitted.white).max() < 0.01
    ours, theirs = (Moments.of(with_station(design, one)[0]) for one in (stops, moved))
    np.testing.assert_allclose(ours.white, theirs.white, atol=1e-4)
    found = with_station(design, moved)[1] @ invert(with_station(design, stops)[1])
    np.testing.assert_allclose(found, motion, atol=1e-7)
    own = [k for k, one in enumerate(design.directions) if one.kind == "tracker"]
    assert ours.information[-1][own].max() < 1.0
    assert not design.visible[own].any()


@settings(max_examples=15, deadline=None)
@given(count=st.integers(1, PLANNED), seed=st.integers(0, 1000))
def test_first_stops_are_what_all_stops_say_of_them(checked: tuple[Design, StopRows], count: int, seed: int) -> None:
    design, stops = checked
    noise = np.random.default_rng(seed).standard_normal(len(stops.factor)) @ stops.factor.T
    stops = replace(stops, measured=stops.expected + noise.reshape(-1, 3))
    every = looks(Moments.of(stops), design.alternatives, design.visible)
    some = looks(Moments.of(first_stops(stops, count)), design.alternatives, design.visible)
    np.testing.assert_allclose(some.log_evidence[-1], every.log_evidence[count - 1], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(some.log_valid[-1], every.log_valid[count - 1], rtol=1e-6, atol=1e-9)
    assert np.all(np.diff(Moments.of(stops).information, axis=0) >= -1e-9)


def test_chosen_stops_show_the_weakest_change_better_than_random_ones(pair: SimulatedCell) -> None:
    design = design_of(pair.belief)
    chosen = choose_stops(pair.belief, pair.candidates, PLANNED)
    assert len(set(chosen.order.tolist())) == PLANNED

    def weakest(order: NDArray[np.intp]) -> NDArray[np.float64]:
        moments = Moments.of(stop_rows(pair.belief, pair.measured(order, 0), design.directions))
        return np.asarray(moments.information[:, design.visible].min(axis=1))

    ours = weakest(chosen.order)
    rng = np.random.default_rng(0)
    random = np.array([weakest(rng.permutation(150)[:PLANNED]) for _ in range(10)])
    assert ours[-1] > random[:, -1].max()
    assert ours[PLANNED // 2] > np.median(random[:, PLANNED // 2])
    assert chosen.weakest is not None
    assert chosen.weakest.noncentrality == pytest.approx(ours[-1], rel=0.3)


def test_a_fit_takes_its_degrees_of_freedom(checked: tuple[Design, StopRows]) -> None:
    _, stops = checked
    moments = after(Moments.of(stops), [0, 1, 2, 9])
    assert moments.degrees[-1] == 6 * PLANNED - 4
    draws = np.random.default_rng(1).standard_normal((4000, len(moments.white)))
    left = draws - (draws @ moments.fitted.T) @ moments.fitted
    p_values = MinPValueTest.of(moments, ()).p_values(left.T)[-1]
    assert kstest(p_values, "uniform").statistic < 0.035
