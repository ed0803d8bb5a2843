"""Effects that appear, vanish, grow or shrink, and those of which that cannot be said."""

from __future__ import annotations

import pytest

from cellapp.estimation.monitoring.fleet.effects import EffectComparison, compare_effects
from cellapp.estimation.monitoring.fleet.record import EffectRecord
from tests.estimation.monitoring.fleet.drawn import arm, effect

pytestmark = pytest.mark.fast

SURE = 1e-6
SEEN = {"backlash": {"half_play1": 6e-6}}


def one(before: tuple[EffectRecord, ...] | None, after: tuple[EffectRecord, ...] | None, **first) -> EffectComparison:
    (found,) = compare_effects(arm(None, effects=before, **first), arm(None, effects=after, smallest=SEEN))
    return found


def backlash(value: float, error: float = 1e-6) -> EffectRecord:
    return effect("backlash", {"half_play1": value}, error)


def test_an_effect_appears_only_beyond_what_the_first_run_could_see() -> None:
    new = one((), (backlash(40e-6),), smallest=SEEN)
    assert new.state == "appeared"
    assert new.p_value is not None
    assert new.p_value < SURE
    weak = one((), (backlash(8e-6),), smallest=SEEN)
    assert weak.p_value is not None
    assert weak.p_value > 0.1, "the first run may have had as much unseen"
    unknown = one((), (backlash(8e-6),))
    assert unknown.p_value is not None
    assert unknown.p_value > 0.1


def test_an_effect_vanishes_only_if_the_newest_run_would_have_seen_it() -> None:
    assert one((backlash(40e-6),), ()).state == "vanished"
    assert one((backlash(40e-6),), ()).difference == -40e-6
    p_value = one((backlash(7e-6),), ()).p_value
    assert p_value is not None
    assert p_value > 0.1


@pytest.mark.parametrize(("now", "state"), [(60e-6, "grew"), (20e-6, "shrank")])
def test_sizes_are_compared_by_their_standard_errors(now: float, state: str) -> None:
    found = one((backlash(40e-6),), (backlash(now),))
    assert (found.state, found.parameter, found.tests) == (state, "half_play1", 1)
    assert found.p_value is not None
    assert found.p_value < SURE
    wide = one((backlash(40e-6, 20e-6),), (backlash(now, 20e-6),))
    assert wide.p_value is not None
    assert wide.p_value > 0.1


def test_a_play_that_changes_its_sign_is_compared_with_it() -> None:
    found = one((backlash(40e-6),), (backlash(-40e-6),))
    assert found.difference == -80e-6


def test_another_parameter_of_an_effect_that_was_there() -> None:
    before, after = backlash(40e-6), effect("backlash", {"half_play1": 40e-6, "half_play2": 50e-6})
    assert one((before,), (after,)).parameter == "half_play2"
    assert one((before,), (after,)).state == "grew"
    assert one((after,), (before,)).state == "shrank"
    weak = one((before,), (effect("backlash", {"half_play1": 40e-6, "half_play2": 6e-6}),))
    assert weak.p_value == 1.0


def test_parameters_that_stand_for_each_other_are_not_judged() -> None:
    before = effect("joint_compliance", {"compliance2": 1e-4, "compliance4": 1e-4})
    after = effect("joint_compliance", {"compliance2": 1e-4, "moment4_5": 3e-4}, size_mm=0.2)
    same = one((before,), (after,))
    assert (same.tests, same.parameter) == (1, "compliance2")
    assert same.p_value == pytest.approx(1.0)


def test_an_effect_that_the_first_run_could_not_show_is_not_judged() -> None:
    found = one((), (backlash(40e-6),), unseen=("backlash",))
    assert (found.state, found.p_value, found.tests) == ("not judged", None, 0)


def test_an_effect_of_the_day_is_no_change_of_the_arm() -> None:
    drift = effect("base_drift", {"base_drift_x": 1e-3})
    assert one((), (drift,)).state == "not judged"
    assert one((drift,), ()).tests == 0


def test_a_run_that_was_not_searched_says_nothing() -> None:
    assert compare_effects(arm(None), arm(None, effects=(backlash(1e-4),))) == ()


def test_effects_that_the_data_cannot_tell_apart_are_one() -> None:
    wind_up = effect("friction_windup", {"windup1": 1e-4}, instead=("backlash",))
    first, last = arm(None, effects=(backlash(40e-6),)), arm(None, effects=(wind_up,))
    found = {one.effect: one for one in compare_effects(first, last)}
    assert {one.state for one in found.values()} == {"renamed"}
    assert found["backlash"].instead_of == ("friction_windup",)
    assert found["friction_windup"].instead_of == ("backlash",)


def curve(size_mm: float) -> EffectRecord:
    return effect("unknown", {}, size_mm=size_mm)


def test_a_free_curve_appears_if_it_is_larger_than_all_that_was_unexplained() -> None:
    stays = one((curve(0.05),), (curve(0.15),))
    assert (stays.state, stays.tests) == ("stays", 0)
    new = one((), (curve(0.2),))
    assert new.state == "appeared"
    assert new.p_value is not None
    assert new.p_value < SURE
    hidden = one((), (curve(0.03),))
    assert hidden.p_value is not None
    assert hidden.p_value > 0.1, "no larger than all that was unexplained in the first run"


def test_terms_of_one_effect_at_two_places_are_one_effect() -> None:
    terms = (backlash(40e-6), effect("backlash", {"half_play4": 40e-6}))
    found = one(terms, terms)
    assert (found.state, found.tests) == ("stays", 2) if found.p_value is None else found.tests == 2
    assert found.p_value == 1.0
