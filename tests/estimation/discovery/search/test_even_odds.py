"""A name is accepted at even odds at least; rivals that nothing distinguishes from it count with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.records import RunnerUp
from cellapp.estimation.discovery.search import stepwise
from cellapp.estimation.discovery.search.review import review
from cellapp.estimation.discovery.search.state import Posteriors, Review, SearchResult
from cellapp.estimation.readings import Readings
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION

TWIN = Path(__file__).parents[4] / "profiles" / "twin.yaml"
N = 90
SIGMA_M = 10e-6
PLAY = 1e-4
SLUGS = ("backlash", "base_step")


def searched(
    monkeypatch: pytest.MonkeyPatch, stated: Mapping[str, float], limited: Mapping[str, float] | None = None
) -> SearchResult:
    """The outcome for an arm with backlash, where the probabilities of effects are those stated, else 1.

    ``limited`` are those once rivals score less than the name.
    """
    profile = load_profile(TWIN)
    few = profile.discovery.model_copy(update={"null_simulations": 60, "false_alarm": 0.02})
    arm = profile.arms["left"]
    geometry = nominal_arm(arm).with_T_M_B(STATION)
    rng = np.random.default_rng(8)
    q = rng.uniform(-2.5, 2.5, (N, 6))
    approach = rng.choice([-1, 1], (N, 6)).astype(np.int8)
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=np.full(N, np.nan),
        q=q,
        approach=approach,
        p_M=smr_positions(geometry, q - PLAY * approach) + rng.normal(0.0, SIGMA_M, (N, 3)),
        sigma_m=np.full(N, SIGMA_M),
    )
    up_M = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(arm), up_M=up_M)
    data = ArmData.of(
        profile.model_copy(update={"discovery": few}), model, readings, measurement_conditions(readings), None
    )

    def probable(found: SearchResult, scan: object) -> Posteriors:
        out = all(max(one.alternatives.values(), default=0.0) < one.score for one in found.reviews)
        here = stated if limited is None or not out else limited
        return Posteriors(tuple(here.get(term.slug, 1.0) for term in found.fit.terms), here)

    monkeypatch.setattr(stepwise, "posteriors_of", probable)
    return stepwise.search(data, SLUGS, CancelToken())


def test_a_probable_name_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    found = searched(monkeypatch, {"backlash": 0.5})
    assert [term.slug for term in found.fit.terms] == ["backlash"]
    assert found.improbable == {}
    assert found.posteriors is not None


def test_an_improbable_name_is_dropped_and_not_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    found = searched(monkeypatch, {"backlash": 0.49})
    assert "backlash" not in {term.slug for term in found.fit.terms}
    assert found.improbable == {"backlash": 0.49}
    assert found.dropped[-1] == "backlash"


def test_rivals_in_one_answer_set_count_together(monkeypatch: pytest.MonkeyPatch) -> None:
    rival = RunnerUp(effect="friction_windup", statistic=50.0, distinguishable=False)
    monkeypatch.setattr(stepwise, "review", lambda *args: replace(review(*args), rivals=(rival,)))
    found = searched(monkeypatch, {"backlash": 0.4, "friction_windup": 0.3})
    assert [term.slug for term in found.fit.terms] == ["backlash"]
    found = searched(monkeypatch, {"backlash": 0.2, "friction_windup": 0.2})
    assert found.improbable == {"backlash": 0.4}, "of the whole answer set"
    found = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6})
    assert [term.slug for term in found.fit.terms] == ["backlash"], "no search without it ends as well"
    assert found.improbable == {}


def test_a_rival_in_whose_place_the_search_ends_worse_scores_less_than_the_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def led(*args: Any) -> Review:
        found = review(*args)
        rival = RunnerUp(effect="friction_windup", statistic=found.score + 20.0, distinguishable=False)
        return replace(found, rivals=(rival,), alternatives={rival.effect: rival.statistic})

    monkeypatch.setattr(stepwise, "review", led)
    (found,) = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6}).reviews
    assert found.alternatives["friction_windup"] < found.score
    alone = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6}, {"backlash": 0.1, "friction_windup": 0.2})
    assert alone.improbable == {"backlash": pytest.approx(0.3)}, "its answer set was probable by that rival only"


def test_a_name_gives_way_to_a_more_probable_rival_that_explains_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    rival = RunnerUp(effect="friction_windup", statistic=50.0, distinguishable=False)
    monkeypatch.setattr(stepwise, "review", lambda *args: replace(review(*args), rivals=(rival,)))
    monkeypatch.setattr(stepwise, "criterion", lambda fit: 0.0)  # of every model
    found = searched(monkeypatch, {"backlash": 0.3, "friction_windup": 0.6})
    assert "backlash" not in {term.slug for term in found.fit.terms}
    assert found.improbable == {"backlash": pytest.approx(0.9)}, "of the whole answer set"
