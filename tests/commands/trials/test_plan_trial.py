"""Designed plans against random ones over seeds: figures of both arms, below the bound, the same for the same seed."""

from __future__ import annotations

import pytest

from cellapp.cell.planning.plan_quality import ERROR_NAMES
from cellapp.commands.trials.plan_trial import BARS, PlanTrialsResult, plan_trials
from tests.twin import small_twin

STOPS = 30


@pytest.fixture(scope="module")
def result() -> PlanTrialsResult:
    profile = small_twin(STOPS, plan={"effects": ("backlash",), "candidates": 400})
    return plan_trials(profile, (1, 2), STOPS)


def test_designed_stops_are_worth_more_than_random_ones(result: PlanTrialsResult) -> None:
    assert [(one.seed, one.arm) for one in result.trials] == [(1, "left"), (1, "right"), (2, "left"), (2, "right")]
    for one in result.trials:
        assert one.stops == STOPS
        assert one.candidates == 400
        assert all(one.equal[error] > STOPS for error in ERROR_NAMES)
    assert result.worth("left", "worst") > 1.2
    assert BARS.keys() == set(ERROR_NAMES), "every error has its bar"


def test_the_bound_is_above_what_is_reached_and_only_where_it_was_asked_for(result: PlanTrialsResult) -> None:
    for one in result.trials:
        assert (one.bound is not None) == (one.seed == 1)
        if one.bound is not None:
            # equals are read off other random plans: 10 % of chance
            assert all(one.bound[error] > 0.9 * one.equal[error] for error in ERROR_NAMES)


@pytest.mark.fast
def test_the_figures_survive_json(result: PlanTrialsResult) -> None:
    assert PlanTrialsResult.model_validate_json(result.model_dump_json()) == result
