"""What is said of findings: verdicts, formulas, opposite signs, pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.discovery.accepted import accepted_effect, dominant_cycles, formulas, pictures
from cellapp.estimation.discovery.arm_data import ArmData, ModelTerm
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.records import (
    AcceptedEffect,
    ArmDiscoveryResult,
    BeforeAfter,
    Evidence,
    Place,
    RunnerUp,
)
from cellapp.estimation.discovery.search.state import FitScatter
from cellapp.estimation.discovery.verdict import remaining_structure, verdict
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm, Wave, joint_column
from cellapp.robot.effects.data_driven import Quantity, Variable
from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import STATION
from tests.estimation.discovery.problems import arm_of, only
from tests.series import readings_at
from tests.sure import sure
from tests.twin import PROFILES, altered

NOISE = FitScatter(1.0, 0.5)
FAR_ABOVE = FitScatter(3.0, 0.0)
NONE = remaining_structure({"joints": 0.4, "time": 0.2})
STRUCTURE = remaining_structure({"joints": 0.4, "time": 1e-6})
UNTESTED = remaining_structure({})


def alternative(*, distinguishable: bool) -> RunnerUp:
    return RunnerUp(effect="friction_windup", statistic=45.0, distinguishable=distinguishable)


def accepted(*alternatives: RunnerUp) -> AcceptedEffect:
    law = EFFECTS["backlash"].law("constant")
    term = EffectTerm("backlash", ("half_play1",), np.ones(1), np.ones(1), ("rad",), law)
    evidence = Evidence(statistic=50.0, corrected_p=0.001, heldout_mm=BeforeAfter(before=0.2, after=0.1))
    return accepted_effect(term, Place(joints=(1,), acts_on=("joint 1",)), evidence, 0.9, runners_up=alternatives)


def errors(after_mm: float) -> BeforeAfter:
    """Held-out errors of geometries that are off by 0.8 mm."""
    return BeforeAfter(before=0.8, after=after_mm)


@pytest.mark.parametrize(
    ("effects", "after_mm", "scatter", "structure", "word"),
    [
        ([], 0.1, NOISE, NONE, "nothing missing"),
        ([], 0.12, FitScatter(1.2, 0.0), NONE, "nothing missing"),
        ([], 0.12, FitScatter(1.2, 0.0), STRUCTURE, "unknown effect"),
        ([], 0.3, FAR_ABOVE, NONE, "nothing missing"),
        ([], 0.3, FAR_ABOVE, UNTESTED, "nothing missing"),
        ([], 0.6, FitScatter(6.0, 0.0), NONE, "unknown effect"),
        ([], 0.3, None, NONE, "nothing missing"),
        ([], 0.3, None, STRUCTURE, "unknown effect"),
        ([accepted()], 0.1, NOISE, NONE, "explained"),
        ([accepted()], 0.12, FitScatter(1.2, 0.5), STRUCTURE, "explained"),
        ([accepted()], 0.12, FitScatter(1.02, 0.0), STRUCTURE, "explained"),
        ([accepted()], 0.16, NOISE, NONE, "unknown effect"),
        ([accepted()], 1.0, None, NONE, "unknown effect"),
        ([accepted()], 0.1, NOISE, STRUCTURE, "explained"),
        ([accepted(alternative(distinguishable=True))], 0.1, NOISE, NONE, "explained"),
        ([accepted(alternative(distinguishable=False))], 0.1, NOISE, NONE, "ambiguous"),
        ([accepted()], 0.3, FAR_ABOVE, STRUCTURE, "unknown effect"),
        ([accepted()], 0.3, FAR_ABOVE, NONE, "unknown effect"),
        ([accepted()], 0.3, None, NONE, "explained"),
        ([accepted()], 0.3, None, STRUCTURE, "unknown effect"),
    ],
)
def test_the_verdict_follows_from_effects_and_residuals(effects, after_mm, scatter, structure, word) -> None:
    found, sentence = verdict(effects, 0.1, errors(after_mm), 100, scatter, structure)
    assert found == word
    assert ("state no uncertainty" in sentence) == (scatter is None)
    assert ("still depend on time" in sentence) == (word == "unknown effect" and structure is STRUCTURE)
    scatters = scatter is not None and after_mm > 0.1 and structure is not STRUCTURE
    assert ("times as stated" in sentence) == scatters


def test_a_scatter_is_not_compared_with_a_stated_uncertainty_that_it_contradicts() -> None:
    _, sentence = verdict([], 0.1, errors(0.3), 100, FitScatter(1.9, 0.0, "estimated"), NONE)
    assert "readings scatter 1.90 times as estimated but without structure" in sentence


def test_readings_that_are_too_few_for_a_search_do_not_say_that_nothing_is_missing() -> None:
    found, sentence = verdict([], 0.1, errors(1.3), 10, FitScatter(50.0, 0.0), UNTESTED)
    assert found == "unknown effect"
    assert "scatter 50 times as stated and are too few to look for effects" in sentence


# -- Readings with the approach signs of another convention: said, counted as unknown, with what to check --------------

TWIN = Path(__file__).parents[3] / "profiles" / "twin.yaml"
STOPS, HELD_OUT = 240, 60
SIGMA_M = 10e-6
HALF_PLAY = np.array([1.5e-4, 1e-4, 0.0, 0.0, 0.0, 0.0])


def discovered(sign: int) -> ArmDiscoveryResult:
    """Discovery in readings with backlash whose approach signs are multiplied by ``sign``."""
    profile = load_profile(TWIN)
    profile = altered(profile, discovery={"null_simulations": 60, "false_alarm": 0.02})
    model, rng = arm_of(profile), np.random.default_rng(5)
    q, approach = rng.uniform(-2.5, 2.5, (STOPS, 6)), rng.choice([-1, 1], (STOPS, 6))
    p_M = smr_positions(model.geometry, q - HALF_PLAY * approach) + rng.normal(0.0, SIGMA_M, (STOPS, 3))
    split = ("identify",) * (STOPS - HELD_OUT) + ("validate",) * HELD_OUT
    readings = readings_at(q, p_M, approach=sign * approach, sigma_m=SIGMA_M, split=split)
    return discover_arm(ArmReadings.alone(profile, "left", model, readings)).result


def test_backlash_of_the_opposite_sign_is_said_and_unknown() -> None:
    arm = discovered(sign=-1)
    assert arm.verdict == "unknown effect"
    (accepted,) = arm.accepted
    assert accepted.effect == "unknown"
    assert accepted.where.joints == (1, 2)
    assert accepted.description is not None
    assert "of the opposite sign at joints 1, 2: check the approach convention" in accepted.description.sentence
    assert accepted.description.sentence in arm.sentence
    assert 100.0 < accepted.description.size_um < 200.0
    assert sure(accepted.meaning).check[0] == "Check the approach convention of the readings."


def test_backlash_of_the_right_sign_is_named() -> None:
    arm = discovered(sign=1)
    assert [found.effect for found in arm.accepted] == ["backlash"]
    assert arm.verdict != "unknown effect"


# -- Short formulas: the one that a curve was made from is among them, and those that do not vary are left out ---------

Q1, Q2, Q3 = (Variable(Quantity.JOINT_ANGLE, joint) for joint in range(3))


def explained(values: np.ndarray, y: np.ndarray) -> float:
    fitted = values @ np.linalg.lstsq(values, y, rcond=None)[0]
    return 1.0 - float(np.sum((y - fitted) ** 2) / np.sum(y**2))


@pytest.mark.parametrize(
    ("variables", "shape", "text"),
    [
        ((Q2,), lambda x, y: 3.0 * np.sin(2.0 * x + 0.4), "c sin(2 q2 + phase)"),
        ((Variable(Quantity.TORQUE, 2),), lambda x, y: 0.2 * np.abs(x), "c |torque3|"),
        ((Q1, Q3), lambda x, y: np.sin(x - y), "c sin(q1 - q3 + phase)"),
        ((Q1, Q3), lambda x, y: np.sin(x) * np.cos(y), "c sin(q1) cos(q3)"),
    ],
)
def test_the_formula_that_made_a_curve_explains_all_of_it(variables, shape, text) -> None:
    x, y = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 200))
    found = formulas(variables, [x, y][: len(variables)])
    best = max(found, key=lambda one: explained(one.values, shape(x, y)))
    assert best.text == text
    assert explained(best.values, shape(x, y)) == pytest.approx(1.0)


# -- Pictures of a fit: values of the terms, partial residuals, and the axis of each picture ---------------------------


N = 120


def wave_column(joint: int, count: int, sine: bool) -> EffectColumn:
    wave = Wave(count, sine)
    return joint_column(f"wave {count} {sine}", "rad", joint, np.zeros(2), -1.0, 1.0, wave=wave)


def test_cycles_hold_the_middle_of_the_power():
    waves = [(k, sine) for k in range(2, 12) for sine in (False, True)]
    columns = [wave_column(1, k, sine) for k, sine in waves]
    amplitudes = {3: 1.0, 5: 10.0, 6: 12.0, 9: 8.0, 11: 1.0}
    values = [-amplitudes.get(k, 0.0) * 1e-6 if sine else 0.0 for k, sine in waves]
    found = dominant_cycles(
        [*columns, wave_column(0, 2, False)], np.array([*values, 4e-6]), 1e-14 * np.eye(len(columns) + 1)
    )
    assert list(found) == ["1", "2"]
    written = json.loads(found["1"].model_dump_json(by_alias=True))
    rms = {"rms_urad": pytest.approx(4.0 / math.sqrt(2.0)), "rms_standard_error_urad": pytest.approx(0.07071, rel=1e-3)}
    assert written == {"from": 2, "to": 2, "peak": 2} | rms
    assert (found["2"].first, found["2"].last, found["2"].peak) == (5, 9, 6)
    assert found["2"].rms_urad == pytest.approx(math.sqrt((1 + 100 + 144 + 64 + 1) / 2.0))


def fitted(bend, *terms, off_axis_m=0.1):
    """Data and a fit of ``terms`` to readings with joint offsets ``bend(q, approach)``."""
    profile = load_profile(PROFILES / "twin.yaml")
    geometry = nominal_arm(profile.arms["left"]).with_T_M_B(STATION)
    named = dict(zip(parameter_names(6), geometry.vector(), strict=True)) | {"tx": off_axis_m, "ty": 0.0}
    geometry = geometry.with_vector(np.array(list(named.values())))
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.5, 2.5, (N, 6))
    approach = rng.choice([-1, 1], (N, 6)).astype(np.int8)
    p_M = smr_positions(geometry, q + bend(q, approach)) + rng.normal(0.0, SIGMA_M, (N, 3))
    readings = readings_at(q, p_M, time_s=60.0 * np.arange(N), approach=approach, sigma_m=SIGMA_M)
    model = arm_of(profile, geometry)
    data = ArmData.of(ArmReadings.alone(profile, "left", model, readings))
    return data, fit_terms(data, tuple(terms))


def made(bend, *terms, off_axis_m=0.1):
    """Pictures of ``fitted``."""
    found = pictures(*fitted(bend, *terms, off_axis_m=off_axis_m))
    for picture in found:
        assert len(picture.x) == len(picture.measured) == len(picture.computed) == len(picture.band) > 0
        assert list(picture.x) == sorted(picture.x)
        assert min(picture.band) >= 0.0
        json.dumps(picture.model_dump(), allow_nan=False)
    return found


def test_fast_lines_are_laid_over_one_another_and_slow_ones_are_not():
    names = tuple(f"{wave}{k}q2" for k in (2, 60, 120) for wave in ("cos", "sin"))
    part = ModelTerm("transmission_error", EFFECTS["transmission_error"].law("gear", {"ratio": 60.0}), names)
    slow, fast = made(lambda q, approach: only(2, 1e-4 * np.sin(2.0 * q[:, 1]) + 3e-4 * np.cos(60.0 * q[:, 1])), part)
    assert (slow.curve.x[0], slow.curve.x[-1]) == (-180.0, 180.0)
    assert np.ptp(slow.computed) == pytest.approx(200.0, rel=0.2)
    assert fast.x_label == "joint 2, within a cycle of 6 deg [deg]"
    assert "60 cycles per revolution" in fast.title
    assert 0.0 <= fast.x[0] <= fast.x[-1] <= 6.0 == fast.curve.x[-1]
    off = np.array(fast.curve.value) - 300.0 * np.cos(60.0 * np.radians(fast.curve.x))
    assert (np.abs(off) < 5.0 * np.array(fast.curve.band) + 0.1).all()
