"""Simulated campaigns: the engine survives every kind of fault, and a broken engine does not get past the oracle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving import motion
from cellapp.cell.driving.collect import CollectSession
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.cell.driving.supervision import Supervisor
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.estimation.readings import Reading
from cellapp.ground.errors import CellappError, InputError
from drivers.arms.protocol import ArmState
from tests.evidence.campaigning.campaign import Bench, Campaign, make_bench, run_campaign
from tests.evidence.campaigning.faults import KINDS, draw_faults
from tests.twin import PROFILES

STOPS = 30
SEEDS = (1, 2, 3, 6, 8, 9, 10, 12, 13, 14, 17, 18, 20, 21, 22, 24, 29, 30, 31, 33, 34, 39, 45, 47, 10531)
"""In these every kind of fault strikes, and several times those whose bad handling must be found.

In the last one a person's stop comes after another cause, and was recorded under the name of that.
"""
OTHER_SEEDS = tuple(seed for seed in range(32) if seed not in SEEDS)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return make_bench(load_profile(PROFILES / "twin.yaml"), STOPS)


@pytest.fixture(scope="module")
def campaigns(bench: Bench) -> list[Campaign]:
    return [run_campaign(bench, seed)[0] for seed in SEEDS]


def failures(bench: Bench, *seeds: int) -> set[str]:
    """Kinds of failures in the campaigns of some seeds."""
    return {failure.kind for seed in seeds for failure in run_campaign(bench, seed)[0].failures}


def seeds_with(campaigns: list[Campaign], *faults: str, count: int = 4) -> list[int]:
    """The first seeds whose campaign has one of these faults."""
    return [one.seed for one in campaigns if set(faults) & set(one.struck)][:count]


def test_the_engine_survives_the_campaigns(campaigns: list[Campaign]) -> None:
    assert [(one.seed, *map(str, one.failures)) for one in campaigns if one.failures] == []
    struck = {kind for one in campaigns for kind in one.struck}
    assert struck == set(KINDS), "every fault struck at least once"


@pytest.mark.slow
def test_the_engine_survives_more_campaigns(bench: Bench) -> None:
    assert failures(bench, *OTHER_SEEDS) == set()


def test_the_same_seed_is_the_same_campaign(bench: Bench) -> None:
    first, second, other = (run_campaign(bench, seed)[0] for seed in (7, 7, 8))
    assert replace(first, seconds=0.0) == replace(second, seconds=0.0)
    assert first.digest != other.digest


def test_faults_come_in_order_and_from_the_seed() -> None:
    first, second = (draw_faults(np.random.default_rng(1), ("left", "right"), 400, 100) for _ in range(2))
    assert first == second
    assert [fault.at_s for fault in first] == sorted(fault.at_s for fault in first)


# -- a broken engine is found -----------------------------------------------------------------------------------------


def test_going_on_without_a_person_is_found(
    bench: Bench, campaigns: list[Campaign], monkeypatch: pytest.MonkeyPatch
) -> None:
    def release_at_once(self: Supervisor, reason: str, shown: object) -> None:
        self.control.resume()
        self._release(self.reaction.causes)

    monkeypatch.setattr(Supervisor, "_hold_for_person", release_at_once)
    assert "motion after a stop" in failures(bench, *seeds_with(campaigns, "person stops"))


def test_arms_that_are_not_braked_are_found(
    bench: Bench, campaigns: list[Campaign], monkeypatch: pytest.MonkeyPatch
) -> None:
    def latch_only(self: StopReaction, cause: StopCause) -> None:
        self._causes = self._causes or (cause,)

    monkeypatch.setattr(StopReaction, "trigger", latch_only)
    assert "motion after a stop" in failures(bench, *seeds_with(campaigns, "protective stop", "computer stalls"))


def test_a_lost_reading_is_found(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    store = RunFile.add_stop

    def forgetful(self: RunFile, configuration: int, rows: Mapping[str, Reading], *others: Any) -> None:
        store(self, configuration, {} if configuration == 5 else rows, *others)

    monkeypatch.setattr(RunFile, "add_stop", forgetful)
    assert {"reading lost", "not listed"} <= failures(bench, 0)


def test_a_doubled_reading_is_found(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = CollectSession._measure

    def repeating(self: CollectSession, stop: int, states: Mapping[str, ArmState]) -> Any:
        rows, outcomes = measure(self, stop, states)
        if stop == 5:
            rows["right"] = replace(rows["right"], p_M=rows["left"].p_M)
        return rows, outcomes

    monkeypatch.setattr(CollectSession, "_measure", repeating)
    assert {"reading doubled", "reading false"} <= failures(bench, 0)


def test_a_wrong_smr_that_is_accepted_is_found(
    bench: Bench, campaigns: list[Campaign], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion, "WRONG_TARGET_M", 10.0)
    assert "reading false" in failures(bench, *seeds_with(campaigns, "wrong SMR"))


def test_a_missing_reading_without_a_reason_is_found(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = CollectSession._measure

    def silent(self: CollectSession, stop: int, states: Mapping[str, ArmState]) -> Any:
        rows, _ = measure(self, stop, states)
        return {name: row for name, row in rows.items() if stop != 5}, []

    monkeypatch.setattr(CollectSession, "_measure", silent)
    assert "not listed" in failures(bench, 0)


def test_an_unexpected_error_is_a_failure(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: CollectSession, stop: int, states: Mapping[str, ArmState]) -> Any:
        raise KeyError(stop)

    monkeypatch.setattr(CollectSession, "_measure", broken)
    campaign, _ = run_campaign(bench, 0)
    assert any("unexpected KeyError" in str(failure) for failure in campaign.failures)


def test_a_profile_of_real_devices_is_refused() -> None:
    with pytest.raises(InputError, match="simulated"):
        make_bench(load_profile(PROFILES / "twin-rtde.yaml"), STOPS)


def test_an_engine_that_fails_without_faults_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: CollectSession, stop: int, states: Mapping[str, ArmState]) -> Any:
        raise KeyError(stop)

    monkeypatch.setattr(CollectSession, "_measure", broken)
    with pytest.raises(CellappError, match="without faults"):
        make_bench(load_profile(PROFILES / "twin.yaml"), STOPS)
