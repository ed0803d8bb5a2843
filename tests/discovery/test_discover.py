"""Hidden effects are named, with values inside their own uncertainty; nothing is named where nothing is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cellapp.calibration.calibrate import calibrate_run
from cellapp.collection.cell import build_plant
from cellapp.discovery.discover import discover_run
from cellapp.errors import InputError
from cellapp.model import CellModel
from cellapp.planning.plan import plan_stops
from cellapp.profile import load_profile
from cellapp.run import Readings, RunFile, import_csv

ROOT = Path(__file__).parents[2]
STIFFNESS = [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]
PLAY = [2.0e-4, 2.0e-4, 1.0e-4, 0.0, 0.0, 0.0]
ECCENTRIC = {"joints": [1], "eccentricity": [2.0e-6], "radius": [0.025], "phase": [0.3]}


@pytest.fixture(scope="module")
def plan():
    """One plan for all cells of this module: planning is not what is tested here."""
    return plan_stops(load_profile(ROOT / "profiles" / "twin.yaml"))


def measured_run(folder, plan, effects, seed=7, noise_seed=0):
    """A run of a twin with ``effects`` by arm, measured in one go by the plant."""
    profile = load_profile(ROOT / "profiles" / "twin.yaml")
    settings = profile.plant.model_copy(update={"effects": effects, "seed": seed})
    without = profile.network.model_copy(update={"kind": "none"})  # trained networks are tested elsewhere
    profile = profile.model_copy(update={"plant": settings, "network": without})
    plant, rng = build_plant(profile), np.random.default_rng(noise_seed)

    def fill(run):
        for name, q in plan.items():
            approach = np.sign(np.diff(np.vstack([np.zeros(6), q]), axis=0)).astype(np.int8)
            points, covariance = plant.measure_positions(plant.smr_positions(name, q, approach=approach), rng)
            readings = Readings(
                configuration=np.arange(len(q)),
                time_s=np.arange(len(q), dtype=np.float64),
                q=q,
                approach=approach,
                p_M=points,
                covariance_M=covariance,
            )
            run.add_readings(name, readings)

    return RunFile.create(folder, profile, fill)


def discovered(folder, plan, effects, **seeds):
    with measured_run(folder, plan, effects, **seeds) as run:
        calibration = calibrate_run(run)
        return calibration, discover_run(run), json.loads(run.read_result("calibrate"))


def names(discovery):
    return {finding.term.slug for finding in discovery.findings}


def test_nothing_is_named_in_a_cell_without_effects(tmp_path, plan):
    for seed in range(4):
        _, found, _ = discovered(tmp_path / str(seed), plan, {}, seed=seed, noise_seed=seed)
        for discovery in found.values():
            assert names(discovery) == set()
            assert discovery.verdict == "nothing missing"
            assert discovery.after_mm == pytest.approx(discovery.noise_floor_mm, rel=0.25)


@pytest.mark.parametrize("seed", [7, 1, 30])
def test_hidden_effects_are_named_and_measured(tmp_path, plan, seed):
    effects = {
        "left": {"joint_compliance": {"stiffness": STIFFNESS}, "encoder_eccentricity": ECCENTRIC},
        "right": {"backlash": {"play": PLAY}},
    }
    calibration, found, stored = discovered(tmp_path / "run", plan, effects, seed=seed, noise_seed=seed)
    left, right = found["left"], found["right"]
    assert names(left) == {"joint_compliance", "encoder_eccentricity"}
    assert names(right) == {"backlash"}
    truths = {
        "compliance2": 1.0 / STIFFNESS[1],
        "compliance3": 1.0 / STIFFNESS[2],
        "half_play1": 0.5 * PLAY[0],
        "half_play2": 0.5 * PLAY[1],
        "half_play3": 0.5 * PLAY[2],
    }
    for discovery in (left, right):
        assert discovery.verdict == "explained"
        assert discovery.after_mm < 1.2 * discovery.noise_floor_mm
        assert discovery.after_mm < 0.4 * discovery.before_mm
        for finding in discovery.findings:
            assert finding.p_value < 0.01
            assert finding.heldout_after_mm < finding.heldout_before_mm
            for name, value, error in zip(
                finding.term.names, finding.term.values, finding.term.standard_errors, strict=True
            ):
                if name in truths:
                    assert abs(value - truths.pop(name)) < 4.0 * error
    assert truths == {}
    amplitude = {n: v for f in left.findings for n, v in zip(f.term.names, f.term.values, strict=True)}
    assert np.hypot(amplitude["cos1q1"], amplitude["sin1q1"]) == pytest.approx(2.0e-6 / 0.025, rel=0.1)
    for name, discovery in found.items():
        shown = stored["arms"][name]["validate"]
        assert shown["effects"]["position_mm"]["rms"] == pytest.approx(discovery.after_mm)
        assert shown["effects"]["position_mm"]["mean"] < shown["geometry"]["position_mm"]["mean"]
        assert calibration.arms[name].model.effects == ()
    model = CellModel.load(tmp_path / "run" / "calibration.json")
    assert {term.slug for term in model.arms["left"].effects} == names(left)


def test_what_the_library_lacks_is_called_unknown(tmp_path, plan):
    # a joint law that no effect of the library has: three cycles a turn, written into the readings themselves
    with measured_run(tmp_path / "run", plan, {}) as run:
        readings = {name: run.readings(name) for name in run.arms()}
        profile = run.profile
    plant = build_plant(profile)
    rng = np.random.default_rng(1)

    def fill(run):
        for name, before in readings.items():
            bent = before.q + np.array([0.0, 6e-4, 0.0, 0.0, 0.0, 0.0]) * np.sin(3.0 * before.q)
            points, covariance = plant.measure_positions(plant.smr_positions(name, bent), rng)
            run.add_readings(
                name,
                Readings(
                    configuration=before.configuration,
                    time_s=before.time_s,
                    q=before.q,
                    approach=before.approach,
                    p_M=points,
                    covariance_M=covariance,
                ),
            )

    with RunFile.create(tmp_path / "other", profile, fill) as run:
        calibrate_run(run)
        for discovery in discover_run(run).values():
            assert discovery.verdict == "unknown effect"
            assert discovery.after_mm > 1.4 * discovery.noise_floor_mm


def test_backlash_cannot_be_seen_from_one_side_and_that_is_said(tmp_path):
    profile = load_profile(ROOT / "profiles" / "ur10-real.yaml")
    with import_csv(profile, ROOT / "tests" / "fixtures" / "ur10-real" / "readings.csv", tmp_path / "run") as run:
        calibrate_run(run)
        discovery = discover_run(run)["left"]
    invisible = {entry["effect"]: entry for entry in discovery.invisible}
    assert invisible["backlash"]["smallest_seen"] is None
    assert "cannot show it" in invisible["backlash"]["reason"]
    # the real arm hides more than this library knows, and the verdict must not pretend otherwise
    assert discovery.verdict == "unknown effect"
    assert discovery.after_mm > 10.0 * discovery.noise_floor_mm


def test_an_uncalibrated_run_is_refused(tmp_path, plan):
    with measured_run(tmp_path / "run", plan, {}) as run, pytest.raises(InputError, match="cellapp calibrate"):
        discover_run(run)
