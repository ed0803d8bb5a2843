"""The trial of the check: changed plants, what is counted, which bars are missed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.trials.check_changes import effect_changes, rigid_changes
from cellapp.commands.trials.check_records import CheckedChange, CheckTrialResult, Share
from cellapp.commands.trials.check_tables import check_trial_sentences, check_trial_tables
from cellapp.commands.trials.check_trial import CheckPlan, check_trials
from cellapp.commands.trials.measured import measured_by
from cellapp.estimation.monitoring.check.model import LENGTH_M
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.interfaces.cli.app import app
from drivers.plant import Plant
from tests.twin import PROFILES, small_twin

Q = {name: np.random.default_rng(3).uniform(-1.5, 1.5, (12, 6)) for name in ("left", "right")}


@pytest.fixture(scope="module")
def result() -> CheckTrialResult:
    """Of one arm on few stops."""
    profile = load_profile(PROFILES / "twin.yaml")
    assert profile.plant is not None
    plant = profile.plant.model_copy(update={"effects": {"right": profile.plant.effects["right"]}})
    alone = profile.model_copy(update={"arms": {"right": profile.arms["right"]}, "plant": plant})
    return check_trials(CheckPlan(profile=alone, earlier=100, planned=12, unchanged=4), [3])


def test_visible_changes_of_the_plant_are_detected_and_named(result: CheckTrialResult) -> None:
    assert result.false_alarms().count == 0
    assert result.found().value == 1.0
    parameters = result.some("parameter", visible=True)
    assert len(parameters) > 8
    assert np.mean([one.listed for one in parameters]) > 0.8
    assert all(one.alarm for one in (*result.some("tracker"), *result.some("smr")))
    solved = [one.solved_mm for one in result.some("tracker") if one.solved_mm is not None]
    assert solved
    assert max(solved) < 0.1
    assert all(one.moved_mm == pytest.approx(1e3 * LENGTH_M, rel=0.02) for one in result.some("effect"))


def test_tables_and_sentences_state_the_bars(result: CheckTrialResult) -> None:
    first, statistics, hardest = check_trial_tables(result)
    assert first.rows[0][0] == "nothing"
    assert next(iter(statistics.rows))[0] == "stop by stop"
    assert hardest.rows
    assert any("at most 1 %" in text for text in check_trial_sentences(result))
    assert not result.complaints()
    assert CheckTrialResult.from_json(result.to_json(), "result") == result
    missed = [one.model_copy(update={"verdict": "valid"}) for one in result.checks]
    alarms = [one.model_copy(update={"verdict": "arm changed"}) for one in result.some("unchanged")]
    bad = result.model_copy(update={"checks": (*alarms, *(one for one in missed if one.group != "unchanged"))})
    assert [text.split()[0] for text in bad.complaints()] == ["false", "0.0%"]


@pytest.mark.fast
def test_intervals_are_those_of_the_binomial_distribution() -> None:
    share = Share.of([True] * 2 + [False] * 98)
    np.testing.assert_allclose((share.low, share.high), (0.00243, 0.07038), atol=1e-5)
    assert Share.of([False] * 100).high == pytest.approx(0.03622, abs=1e-5)
    every = Share.of([True] * 100)
    np.testing.assert_allclose((every.low, every.high), (0.96378, 1.0), atol=1e-5)
    assert (Share.of([]).low, Share.of([]).high) == (0.0, 1.0)


def points(profile: Profile, plant: Plant) -> dict[str, np.ndarray]:
    found = measured_by(plant, home_positions(profile), Q, 0, noise=False)
    return {name: its.p_M for name, its in found.items()}


def test_changed_plants_move_what_they_say() -> None:
    profile = small_twin()
    before = points(profile, build_plant(profile))

    def together(plant: Plant) -> np.ndarray:
        return np.concatenate(list(points(profile, plant).values()))

    for change in effect_changes(profile, LENGTH_M, together):
        after = points(profile, change.plant)
        other = "left" if change.arm == "right" else "right"
        np.testing.assert_allclose(after[other], before[other], atol=1e-12)
        moved = after[change.arm] - before[change.arm]
        assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(LENGTH_M, rel=0.02)
    for change in rigid_changes(profile, (1e-3,), np.random.default_rng(1)):
        after = points(profile, change.plant)
        if change.group == "smr":
            np.testing.assert_allclose(np.linalg.norm(after[change.arm] - before[change.arm], axis=1), 1e-3, rtol=1e-3)
            continue
        assert change.motion is not None
        expected = before if change.group == "tracker" else {change.arm: before[change.arm]}
        for arm, p_M in expected.items():
            np.testing.assert_allclose(after[arm], p_M @ change.motion[:3, :3].T + change.motion[:3, 3], atol=1e-6)


@pytest.mark.fast
def test_a_profile_without_a_simulated_cell_is_refused() -> None:
    with pytest.raises(InputError, match="section 'plant'"):
        check_trials(CheckPlan(profile=load_profile(Path(PROFILES) / "ur10-ur5.yaml")), [0])


@pytest.mark.fast
def test_only_what_changed_counts_as_an_alarm() -> None:
    one = CheckedChange(
        seed=0, group="unchanged", arm="", what="", visible=False, moved_mm=0.0, verdict="cannot say", stops=20
    )
    assert not one.alarm
    assert one.model_copy(update={"verdict": "not explained"}).alarm


@pytest.mark.fast
def test_the_command_refuses_a_series_that_is_not_there() -> None:
    outcome = CliRunner().invoke(app, ["trials", "check", "--real", "Z"])
    assert isinstance(outcome.exception, InputError)
    assert "'Z' is not a series" in str(outcome.exception)
