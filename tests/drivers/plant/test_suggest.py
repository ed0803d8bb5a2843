"""Suggested parameters are valid, repeatable and of realistic size."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from drivers.plant import ONLY_MOVING, OUTSIDE, REALISTIC, suggest
from drivers.plant.effects import FACTORIES, build

DURATION_S = 9000.0
STOPS = 40


@pytest.mark.parametrize("slug", REALISTIC + OUTSIDE)
def test_a_suggestion_is_an_effect_of_realistic_size(make_arm, make_plant, slug):
    rng = np.random.default_rng(7)
    for kind, other in (("ur10", "ur5"), ("ur5", "ur10")):
        left, right = make_arm(kind, "left", 0.0, smr_acceptance=0.6), make_arm(other, "right", 1.2)
        parameters = suggest(slug, rng, left, DURATION_S)
        # a profile or a sealed truth can hold it
        assert json.loads(json.dumps(parameters)) == parameters
        q, away = rng.uniform(-2.5, 2.5, (2, STOPS, 6))
        time_s = np.sort(rng.uniform(0.0, DURATION_S, STOPS))
        ideal = make_plant(left, right)
        told = {
            "others": {"right": away},
            "time_s": time_s,
            "last_step": rng.choice([-1.0, 1.0], (STOPS, 6)) * rng.uniform(0.1, 1.5, (STOPS, 6)),
            "since_rest_s": rng.uniform(1.0, 5.0, STOPS),
            "payload": rng.choice([0.5, 4.0], STOPS),
            "joints_c": 20.0 + 8.0 * (1.0 - np.exp(-time_s / 2400.0))[:, None] * rng.uniform(0.7, 1.3, 6),
        }
        plant = make_plant(replace(left, effects={slug: parameters}), right)
        moved = plant.smr_positions("left", q, **told) - ideal.smr_positions("left", q, **told)
        size = np.sqrt((moved**2).sum(axis=1).mean())
        assert 5e-6 < size < 5e-3


def test_every_effect_has_a_suggestion():
    groups = (REALISTIC, OUTSIDE, ONLY_MOVING)
    assert set().union(*groups) == set(FACTORIES)
    assert sum(map(len, groups)) == len(FACTORIES)


@pytest.mark.parametrize("slug", REALISTIC + OUTSIDE)
def test_the_same_state_suggests_the_same_and_another_another(make_arm, slug):
    arm = make_arm()
    one, again, other = (suggest(slug, np.random.default_rng(seed), arm, DURATION_S) for seed in (1, 1, 2))
    assert one == again
    assert one != other


@pytest.mark.parametrize("slug", ["base_step", "target_slip"])
def test_onsets_lie_within_the_run(make_arm, slug):
    rng = np.random.default_rng(0)
    for duration_s in (600.0, 36000.0):
        onsets = [suggest(slug, rng, make_arm(), duration_s)["time"] for _ in range(50)]
        assert 0.1 * duration_s < min(onsets)
        assert max(onsets) < 0.9 * duration_s
        assert max(onsets) - min(onsets) > 0.3 * duration_s


def test_every_variant_and_sign_comes_up(make_arm):
    rng, arm = np.random.default_rng(0), make_arm()
    drives = [suggest("transmission_error", rng, arm, DURATION_S) for _ in range(60)]
    assert {drive["mode"] for drive in drives} == {"lines", "curve"}
    lines = [drive for drive in drives if drive["mode"] == "lines"]
    assert {(any(d["output_slant"]), any(d["eccentric"])) for d in lines} == {
        (True, False),
        (False, True),
        (True, True),
    }
    assert {"reach" in suggest("backlash", rng, arm, DURATION_S) for _ in range(40)} == {True, False}
    assert {"knee" in suggest("joint_compliance", rng, arm, DURATION_S) for _ in range(40)} == {True, False}
    walks = [suggest("base_drift", rng, arm, DURATION_S) for _ in range(40)]
    assert {walk["law"] for walk in walks} == {"linear", "exponential", "creep"}
    assert {np.sign(suggest("tracker_scale", rng, arm, DURATION_S)["ppm"]) for _ in range(40)} == {-1.0, 1.0}
    chosen = {tuple(suggest("encoder_eccentricity", rng, arm, DURATION_S)["joints"]) for _ in range(40)}
    assert len(chosen) > 8


def test_a_lighter_arm_has_weaker_drives(make_arm):
    heavy, light = (
        np.mean(
            [
                suggest("joint_compliance", np.random.default_rng(k), make_arm(kind), 1e4)["stiffness"][1]
                for k in range(20)
            ]
        )
        for kind in ("ur10", "ur5")
    )
    assert 0.3 * heavy < light < 0.7 * heavy
    assert 5e4 < heavy < 1.3e5


def test_parameters_are_valid_for_a_weightless_arm_of_seven_joints(seven_joints):
    rng = np.random.default_rng(0)
    for slug in REALISTIC + OUTSIDE:
        parameters = suggest(slug, rng, seven_joints, DURATION_S)
        assert len(build(seven_joints.name, seven_joints.joints, {slug: parameters})) == 1, slug


def test_a_wrong_slug_or_duration_is_one_clear_error(make_arm):
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="unknown effect 'gremlins'; effects are backlash, base_drift"):
        suggest("gremlins", rng, make_arm(), DURATION_S)
    for duration_s in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="duration_s must be a positive time, not"):
            suggest("backlash", rng, make_arm(), duration_s)
