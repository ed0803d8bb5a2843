"""Trials of new targets: what they draw, what they count, and one small cell from plan to measured targets."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.planning.plan import plan_stops
from cellapp.commands.trials.measured import measured_plan
from cellapp.commands.trials.target_draws import draw_hidden, draw_pairs, draw_targets
from cellapp.commands.trials.target_records import (
    CALIBRATED,
    RELOCATED,
    ArmFigures,
    PairFigures,
    StateFigures,
    TargetTrial,
    TargetTrialsResult,
)
from cellapp.commands.trials.target_tables import target_trial_sentences, target_trial_tables
from cellapp.commands.trials.target_trial import target_trials
from cellapp.estimation.calibration.calibrate import calibrate_readings
from cellapp.ground.errors import InputError
from tests.twin import finished_twin, small_twin

ARM = ArmFigures(
    targets=200,
    refused=0,
    nominal_mm=2.0,
    compensated_mm=0.03,
    floor_mm=0.025,
    changed_mm=0.0,
    paper_mm=0.3,
    within_95=0.95,
    coordinates_95=0.95,
)
PAIR = PairFigures(targets=200, refused=0, nominal_mm=1.0, compensated_mm=0.03, floor_mm=0.02, paper_mm=0.2)


def result_of(arm: ArmFigures, pair: PairFigures | None = PAIR, state: str = CALIBRATED) -> TargetTrialsResult:
    states = {state: StateFigures(arms={"left": arm}, pair=pair)}
    trial = TargetTrial(seed=0, effects={}, states=states, location="located", seconds=1.0, push_seconds=1.0)
    return TargetTrialsResult(profile="twin", trials=(trial, trial))


def changed(**values: float) -> ArmFigures:
    return ARM.model_copy(update=values)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("result", "complaint"),
    [
        pytest.param(result_of(ARM), "", id="all bars kept"),
        pytest.param(result_of(changed(nominal_mm=0.4)), "13.3 times below nominal", id="nominal"),
        pytest.param(result_of(changed(floor_mm=0.019)), "1.58 times the floor", id="floor"),
        pytest.param(result_of(changed(within_95=0.98)), "98.0% of measurements", id="too wide"),
        pytest.param(result_of(changed(coordinates_95=0.92)), "92.0% of coordinates", id="too narrow"),
        pytest.param(
            result_of(ARM, PAIR.model_copy(update={"paper_mm": 0.045})), "cooperative error 33% below", id="paper"
        ),
        pytest.param(result_of(ARM, None), "", id="no pair"),
    ],
)
def test_bars(result: TargetTrialsResult, complaint: str) -> None:
    complaints = result.complaints()
    assert len(complaints) == bool(complaint)
    assert complaint in "".join(complaints)
    assert bool(complaint) == any(text.startswith("Missed") for text in target_trial_sentences(result))


@pytest.mark.fast
def test_hidden_effects_are_the_seed_s_and_keep_the_cell_s_own() -> None:
    profile = small_twin()
    assert profile.plant is not None
    drawn = [draw_hidden(profile, seed, 3000.0) for seed in range(12)]
    assert drawn[3] == draw_hidden(profile, 3, 3000.0)
    for hidden, laws in drawn:
        assert set(hidden) == set(laws) == {"left", "right"}
        for name, own in profile.plant.effects.items():
            assert set(own) <= set(hidden[name])
    assert len({tuple(hidden["left"]) for hidden, _ in drawn}) > 6
    assert {laws["left"] for _, laws in drawn} == {"same", "other"}


def test_a_cell_from_plan_to_measured_targets() -> None:
    """Few stops: the bars are not for them; errors must still fall far below those of the published geometry."""
    profile = finished_twin(60)
    profile = profile.model_copy(update={"plan": profile.plan.model_copy(update={"method": "random"})})
    result = target_trials(profile, [3], targets=6, pairs=0)
    assert TargetTrialsResult.from_json(result.to_json(), "test") == result
    (trial,) = result.trials
    for name, arm in trial.states[CALIBRATED].arms.items():
        assert arm.targets + arm.refused == 6
        assert arm.targets >= 3
        assert arm.compensated_mm < 0.3 * arm.nominal_mm
        assert 0.015 < arm.floor_mm < 0.035, "the tracker at 3 to 5 m"
        assert trial.effects[name].hidden
    assert (trial.location == "located") == (RELOCATED in trial.states)
    assert len(target_trial_tables(result)) == 1 + 2 * len(trial.states)


def test_drawn_targets_can_be_reached() -> None:
    profile = small_twin()
    plan = {name: q[:30] for name, q in plan_stops(profile).items()}
    model = calibrate_readings(profile, measured_plan(profile, plan, 1)).model
    singles, pairs = draw_targets(profile, model, 3, 5), draw_pairs(profile, model, 2, 5)
    assert singles == draw_targets(profile, model, 3, 5)
    assert [target.arm for target in singles] == ["left"] * 3 + ["right"] * 3
    assert all(target.approach is not None and set(target.approach) <= {-1, 1} for target in singles)
    for target in pairs:
        assert target.partner is not None
        assert np.linalg.norm(target.partner.position) > 0.05, "the arms keep their clearance"


@pytest.mark.fast
def test_a_real_cell_is_refused() -> None:
    profile = small_twin().model_copy(update={"plant": None})
    with pytest.raises(InputError, match="need a section 'plant' and two arms"):
        target_trials(profile, [0], 1, 0)
