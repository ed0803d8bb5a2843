"""What a plan would have named: the curve over the size, one blind trial, rounds of them, command, run and page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.planning.plan import make_stops
from cellapp.cell.run import RunFile
from cellapp.commands.report.sections import detectability_section
from cellapp.commands.trials.detectability import (
    DetectabilityResult,
    NamingTrial,
    PlannedCell,
    TrialCell,
    detectability_at,
    naming_trial,
    plan_detects,
    stored_detectability,
    trial_cell,
)
from cellapp.estimation.uncertainty.detection_curve import NamingCurve
from cellapp.ground.errors import InputError
from cellapp.ground.executors import Gathered, PoolWork, TimeLimit
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken, Notice, Progress
from tests.program import app
from tests.sure import sure
from tests.twin import altered, whole_twin
from tests.verbs import plan_new_run


def twin(stops: int = 60) -> Profile:
    """The twin with few random stops whose search sets its threshold from few simulations."""
    profile = whole_twin()
    quarter = stops // 4
    splits = {"identify": quarter, "train": stops - 2 * quarter, "validate_": quarter, "pair_identify": quarter,
              "pair_validate": quarter}  # fmt: skip
    return altered(
        profile,
        plan={"stops": stops, "reserve": 0, "method": "random"},
        splits=splits,
        discovery={"null_simulations": 20},
    )


@pytest.fixture(scope="module")
def planned() -> PlannedCell:
    """The stops of a simulated cell."""
    profile = twin()
    return PlannedCell.of(profile, make_stops(profile)[0])


@pytest.fixture(scope="module")
def cell(planned: PlannedCell) -> TrialCell:
    """That cell."""
    return trial_cell(planned)


# -- the curve --------------------------------------------------------------------------------------------------------


def test_intervals_hold_the_true_size_as_often_as_they_say() -> None:
    rng = np.random.default_rng(20)
    held, errors = [], []
    for _ in range(60):
        middle, width = np.log(rng.uniform(0.02, 0.2)), rng.uniform(0.1, 0.5)
        true = float(np.exp(middle + width * np.log(0.95 / 0.05)))
        sizes, found = list[float](), list[bool]()
        for place in range(4):
            asked = NamingCurve.of(0.005, 1.0, sizes, found).next_sizes(0.95) if place else [0.02, 0.04, 0.08, 0.16]
            sizes += asked
            found += (rng.random(4) < 1.0 / (1.0 + np.exp(-(np.log(asked) - middle) / width))).tolist()
        low, value, high = NamingCurve.of(0.005, 1.0, sizes, found).size_at(0.95, (0.05, 0.5, 0.95))
        held.append(low <= true <= high)
        errors.append(np.log(value / true))
    assert np.mean(held) >= 0.8
    assert abs(np.median(errors)) < 0.25


def test_what_is_never_found_has_no_size_and_what_is_missed_at_any_size_has_none_either() -> None:
    never = NamingCurve.of(0.01, 1.0, [0.3, 1.0, 1.0, 1.0, 1.0, 1.0], [False] * 6)
    assert never.size_at(0.95, (0.5,))[0] > 1.0
    half = NamingCurve.of(0.01, 1.0, [0.5, 1.0] * 10, [True, False] * 10)
    assert half.size_at(0.95, (0.5,)) == [np.inf]
    assert all(0.01 <= size <= 1.0 for size in half.next_sizes(0.95))


# -- one trial --------------------------------------------------------------------------------------------------------


def test_a_large_effect_is_named_and_a_small_one_is_not(cell: TrialCell) -> None:
    asked = NamingTrial(arm="left", effect="target_slip", size_mm=0.3, seed=7)
    found = naming_trial(cell, asked)
    assert "target_slip" in found.accepted
    assert found.named
    assert 0.2 < found.visible < 1.0
    assert naming_trial(cell, asked) == found
    assert naming_trial(cell, asked.model_copy(update={"size_mm": 0.001})).accepted == ()


# -- rounds -----------------------------------------------------------------------------------------------------------

TRUE_MM = {"backlash": 0.03, "target_slip": 0.1}


def _imitated(asked: NamingTrial) -> NamingTrial:
    """A search that names two effects from some size on, never the tracker's scale, and takes the rest for another."""
    if asked.effect == "pedestal_coupling":
        return asked
    if asked.effect == "tracker_scale":
        return asked.model_copy(update={"visible": 0.01})
    if asked.size_mm < TRUE_MM.get(asked.effect, 1e9):
        return asked.model_copy(update={"visible": 0.9, "accepted": ("joint_drift",) if asked.size_mm > 0.1 else ()})
    return asked.model_copy(update={"visible": 0.9, "accepted": (asked.effect,)})


def imitation(asked: Sequence[NamingTrial], all_may_fail: bool) -> Gathered[NamingTrial]:
    """Answers of a search that is known."""
    return Gathered(tuple(_imitated(one) for one in asked), {})


def detectability_by(
    planned: PlannedCell,
    trials: int,
    limit: TimeLimit,
    search: Callable[[Sequence[NamingTrial], bool], Gathered[NamingTrial]] = imitation,
) -> DetectabilityResult:
    """What trials by another search give."""

    def gather(function: Any, prepare: Any, given: Any, found: Any, job: Any, work: Any, *, all_may_fail: bool) -> Any:
        return search([*given.values()], all_may_fail)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("cellapp.commands.trials.detectability.gather", gather)
        told = list[Progress]()
        found = plan_detects(planned, trials, 3, PoolWork(job=JobToken(told.append)), limit)
    assert isinstance(told[0].detail, Notice)
    assert limit.words() in told[0].detail.text
    return found


@pytest.fixture(scope="module")
def result(planned: PlannedCell) -> DetectabilityResult:
    """What such a search gives."""
    return detectability_by(planned, 16, TimeLimit.from_now(None))


def test_sizes_are_those_from_which_the_search_names(result: DetectabilityResult) -> None:
    arm = result.arms["left"]
    found = {one.effect: one for one in arm.effects}
    for effect, true_mm in TRUE_MM.items():
        named = sure(found[effect].named_from)
        assert named.low_mm < 1.5 * true_mm
        assert sure(named.high_mm) > true_mm
        assert found[effect].trials == 16
    lost = found["joint_compliance"]
    assert lost.named_from is None
    assert lost.trials < 16
    assert lost.not_up_to_mm == pytest.approx(1.0, rel=0.5)
    assert "taken for" in lost.limit
    assert "geometry follows 99%" in found["tracker_scale"].limit
    assert found["pedestal_coupling"].limit == "it does not move the SMR at these stops"
    assert found["payload_compliance"].limit == "payload does not vary"
    assert found["payload_compliance"].trials == 0


def test_trials_that_cannot_be_computed_are_said_and_not_asked_for_again(planned: PlannedCell) -> None:
    asked = list[NamingTrial]()

    def failing(given: Sequence[NamingTrial], all_may_fail: bool) -> Gathered[NamingTrial]:
        """No trial of an effect in one arm can be computed, and only the first of another."""
        asked.extend(given)
        assert all_may_fail == (len(asked) > len(given))
        lost = [
            (one.arm, one.effect) == ("left", "backlash") or (one.effect == "target_slip" and one.size_mm < 0.03)
            for one in given
        ]
        found = imitation(given, all_may_fail).results
        failures = {f"{one.arm}, {one.effect}, {one.seed}": "refused" for one, no in zip(given, lost) if no}
        return Gathered(tuple(None if no else one for one, no in zip(found, lost)), failures)

    found = detectability_by(planned, 8, TimeLimit.from_now(None), failing)
    assert len(set(asked)) == len(asked)
    effects = {name: {one.effect: one for one in arm.effects} for name, arm in found.arms.items()}
    assert effects["left"]["backlash"].trials == 0
    assert effects["left"]["backlash"].limit == "no trial could be computed"
    assert effects["right"]["backlash"].trials == 8
    assert 0 < effects["left"]["target_slip"].trials < 8
    assert len(found.failed) == len(asked) - len(found.trials)
    assert not found.ended_by_time


def test_a_run_keeps_it_and_its_report_shows_it(
    result: DetectabilityResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[PlannedCell, int, int]]()

    def detects(planned: PlannedCell, trials: int, seed: int, work: PoolWork, limit: TimeLimit) -> DetectabilityResult:
        assert limit.minutes == 3.0
        asked.append((planned, trials, seed))
        return result

    monkeypatch.setattr("cellapp.commands.trials.detectability.plan_detects", detects)
    plan_new_run(twin(stops=30), tmp_path / "run")
    CliRunner().invoke(
        app,
        ["trials", "power", str(tmp_path / "run"), "--trials", "8", "--minutes", "3", "--seed", "5"],
        catch_exceptions=False,
    )
    ((planned, trials, seed),) = asked
    assert (len(planned.time_s), trials, seed) == (30, 8, 5)
    with RunFile.open(tmp_path / "run") as run:
        assert stored_detectability(run) == result
        section = detectability_section(run)
    assert "blind trials" in sure(section).message
    assert len(sure(section).parts) == len(result.arms)


def test_a_run_without_a_plan_is_refused(tmp_path: Path) -> None:
    RunFile.create(tmp_path / "run", twin()).close()
    with pytest.raises(InputError, match="plan"):
        detectability_at(tmp_path / "run", 8, 0, PoolWork(), TimeLimit.from_now(None))
