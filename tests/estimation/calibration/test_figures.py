"""Figures that the project promises, each with its limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import import_csv
from cellapp.commands.calibrate.run import draw_missing_splits
from cellapp.commands.trials.coverage import coverage
from cellapp.commands.trials.parameter_sets import parameter_set_trials
from cellapp.estimation.calibration.calibrate import calibrate_arm

ROOT = Path(__file__).parents[3]
READINGS = ROOT / "tests" / "fixtures" / "ur10-real" / "readings.csv"


@pytest.mark.parametrize("seed", [None, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_a_real_ur10_ends_at_or_below_0_455_mm(tmp_path, seed):
    profile = load_profile(ROOT / "profiles" / "ur10-real.yaml")
    if seed is not None:
        profile = profile.model_copy(update={"seed": seed})
    with import_csv(profile, READINGS, tmp_path / "run") as run:
        draw_missing_splits(run)
        readings = run.readings("left")
    calibration, notes = calibrate_arm(profile, "left", readings)
    assert notes == []
    assert calibration.counts == {"identify": 300, "train": 0, "validate": 2473}
    position = calibration.validate["geometry"].position_mm
    assert position.n == 2473
    assert position.mean <= 0.455
    assert calibration.validate["nominal"].position_mm.mean > 0.8
    # the priors keep the tool where a probe can be: about 0.1 m along the last axis
    assert np.linalg.norm(calibration.model.geometry.tool - [0.0, 0.0, 0.093]) < 2e-3


@pytest.mark.parametrize("arm", ["right", pytest.param("left", marks=pytest.mark.long)])
def test_stated_95_percent_intervals_hold_the_truth_93_to_97_percent_of_the_time(arm):
    result = coverage(load_profile(ROOT / "profiles" / "twin.yaml"), arm, runs=200)
    assert result.runs == 200
    assert result.intervals == 200 * 27
    assert 0.93 <= result.share <= 0.97
    assert result.scatter == pytest.approx(1.0, abs=0.02)
    assert min(result.by_parameter.values()) > 0.88  # 4.5 standard deviations of 200 draws


def test_the_redundant_model_does_not_converge_and_the_reduced_one_does():
    # of six, one or two converge all the same: which ones depends on the linear algebra library
    result = parameter_set_trials(load_profile(ROOT / "profiles" / "twin.yaml"), seeds=range(3))
    assert result.failed == ()
    by_name = {(trial.parameter_set, trial.solver): trial for trial in result.arms["left"]}
    redundant, reduced = by_name["full", "plain"], by_name["auto", "plain"]
    assert (redundant.parameters, reduced.parameters) == (34, 27)
    assert by_name["paper", "plain"].parameters == 26
    assert redundant.converged < redundant.seeds
    assert redundant.iterations > 100
    assert reduced.converged == reduced.seeds
    assert reduced.iterations <= 4
    assert reduced.mean_mm < redundant.mean_mm
    assert reduced.max_mm < redundant.max_mm
    ours = by_name["full", "cellapp"]
    assert ours.converged == ours.seeds
