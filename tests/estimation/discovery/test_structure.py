"""Structure in residuals: found where it is, rarely where there is none, whatever the noise looks like."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, pearson3

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.commands.trials.blind import blind_readings, with_hidden
from cellapp.estimation.calibration.calibrate import calibrate_arm, gross_errors
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.discover import discover_arm, needs_network, with_network
from cellapp.estimation.discovery.joint_fit import (
    _FOLD_SEED,
    JointFit,
    NormalMatrix,
    ProjectedResidual,
    cross_validated_gain,
    fit_terms,
)
from cellapp.estimation.discovery.plan_forecast import expected_readings, planned_data, planned_effects
from cellapp.estimation.discovery.process import (
    CURVE_LENGTHS,
    Component,
    ProcessEvidence,
    StructuredProcess,
    fit_process,
)
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.verdict import CHANCE, has_structure, pearson3_tail, residual_structure
from cellapp.ground.profile.schema import DiscoverySettings
from cellapp.robot.effects import ActsOn, EffectColumn, LawForm
from cellapp.robot.effects.context import Wave
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model.model import network_to_json
from tests.estimation.discovery.problems import arm_of, data_of, only
from tests.evidence.shared.series import load_entrant
from tests.sure import sure
from tests.twin import PROFILES, small_twin

SIGMA_M = 10e-6
PROFILE = load_profile(PROFILES / "twin.yaml")


def fitted(n, bend=None, *, noise=None, seed=5, stated=True, times=True) -> tuple[ArmData, JointFit]:
    """Geometry fitted to random stops with joint offsets ``bend(q, approach, time)`` [rad]."""
    rng = np.random.default_rng(seed)
    q, time_s = rng.uniform(-2.0, 2.0, (n, 6)), 60.0 * np.arange(n, dtype=np.float64)
    approach = rng.choice([-1.0, 1.0], (n, 6))
    offset = np.zeros((n, 6)) if bend is None else bend(q, approach, time_s)
    scatter = rng.normal(0.0, SIGMA_M, (n, 3)) if noise is None else noise(rng, q)
    p_M = smr_positions(arm_of(PROFILE).geometry, q + offset) + scatter
    data = data_of(PROFILE, q, approach, p_M, SIGMA_M if stated else None, time_s if times else None)
    return data, fit_terms(data, ())


@pytest.mark.parametrize(
    ("bend", "against"),
    [
        (lambda q, approach, t: only(3, 15e-6 * np.sin(7.0 * q[:, 2])), "joints"),
        (lambda q, approach, t: only(2, 15e-6 * np.sin(3.0 * q[:, 4])), "joints"),
        (lambda q, approach, t: only(1, 30e-6 * np.sin(q[:, 1]) * np.sin(2.0 * q[:, 3])), "joints"),
        (lambda q, approach, t: only(2, 8e-6 * approach[:, 1]), "approach"),
        (lambda q, approach, t: only(1, 15e-6 * np.sin(2.0 * np.pi * t / 3000.0)), "time"),
    ],
    ids=["own angle", "another angle", "two angles", "approach", "time"],
)
def test_structure_is_found_where_it_is(bend, against):
    found = residual_structure(*fitted(300, bend))
    p_values = {test.against: test.p_value for test in found.tests}
    assert has_structure(found)
    assert min(p_values, key=lambda kind: p_values[kind]) == against
    assert p_values[against] <= CHANCE / len(found.tests)


def test_structure_in_the_order_of_stops_is_found_without_times():
    found = residual_structure(
        *fitted(300, lambda q, approach, t: only(1, 15e-6 * np.sin(t / 500.0)), times=False, stated=False)
    )
    p_values = {test.against: test.p_value for test in found.tests}
    assert "time" not in p_values
    assert has_structure(found)
    assert min(p_values, key=lambda kind: p_values[kind]) == "order"


def heavy(rng, q):
    return SIGMA_M * rng.standard_t(3, (len(q), 3))


def growing(rng, q):
    """Noise that is ten times as large at one end of a joint's range."""
    return SIGMA_M * (1.0 + 9.0 * (q[:, :1] + 2.0) / 4.0) * rng.normal(size=(len(q), 3))


@pytest.mark.parametrize("noise", [None, heavy, growing], ids=["as stated", "heavy tails", "not the same everywhere"])
def test_noise_has_no_structure(noise):
    smallest = []
    for seed in range(12):
        found = residual_structure(*fitted(100, noise=noise, seed=seed))
        smallest.append(min(test.p_value for test in found.tests) * len(found.tests))
        assert {test.against for test in found.tests} == {"joints", "time", "approach", "position", "tracker"}
    # of twelve, one below 0.01 has a chance of 0.11, and one below 0.001 of 0.012
    assert min(smallest) > 0.001
    assert sorted(smallest)[1] > 0.01


def test_the_tail_is_that_of_pearson_type_iii():
    values, skewness = np.meshgrid(np.linspace(-6.0, 6.0, 25), [0.0, 1e-6, 1e-4, 0.01, 0.2, 1.0, 3.0])
    np.testing.assert_allclose(pearson3_tail(values, skewness), pearson3.sf(values, skewness), rtol=1e-9, atol=1e-12)


def test_a_few_readings_are_not_tested():
    data, fit = fitted(60)
    few = replace(data, readings=data.readings.take(np.arange(10)))
    assert residual_structure(few, fit).tests == ()
    assert not has_structure(residual_structure(few, fit))


# -- The gain of a term on left-out readings is that of fits to the other readings -------------------------------------

READINGS, FOLDS, SEED = 60, 5, 3


class Data(SimpleNamespace):
    """What the cross-validation needs of the data of an arm."""

    undivided = np.arange(READINGS)

    def __len__(self) -> int:
        return READINGS


def left_out_square(rows, precision, target, fold):
    """Sum of squares of each fold, predicted by a fit to the others."""
    total = 0.0
    for k in range(FOLDS):
        out = fold == k
        X = rows[:, ~out]
        solution = np.linalg.solve(X @ X.T + np.diag(precision), X @ target[~out])
        total += np.sum((target[out] - solution @ rows[:, out]) ** 2)
    return total


@pytest.mark.parametrize("signal", [0.0, 0.5])
def test_the_gain_is_that_of_fits_to_the_other_folds(signal):
    rng = np.random.default_rng(1)
    rows, new = rng.normal(size=(12, 3 * READINGS)), rng.normal(size=(3, 3 * READINGS))
    precision = np.concatenate([np.zeros(6), rng.uniform(1.0, 500.0, 6)])
    target = rng.normal(size=3 * READINGS) + signal * new[0]
    data: Any = Data(profile=SimpleNamespace(seed=SEED, discovery=SimpleNamespace(folds=FOLDS)))
    normal = NormalMatrix.of(rows, target)
    fit: Any = SimpleNamespace(rows=rows, precision=precision, target=target, normal=normal, derived={})
    fold = np.tile(np.random.default_rng([SEED, _FOLD_SEED]).permutation(READINGS) % FOLDS, 3)
    before = left_out_square(rows, precision, target, fold)
    after = left_out_square(np.concatenate([rows, new]), np.concatenate([precision, np.zeros(3)]), target, fold)
    gain = cross_validated_gain(data, fit, new)
    assert gain == pytest.approx(before - after, rel=1e-9)
    assert (gain > 0.0) == (signal > 0.0)


# The expected noise is the tracker's, and the sizes that a plan promises are those that a search of readings finds.

STOPS = 60


@pytest.fixture(scope="module")
def planned() -> ArmData:
    profile = small_twin(STOPS)
    plan = plan_stops(profile)
    time_s, dwell_s, load = np.linspace(0.0, 8.0 * STOPS, STOPS), np.full(STOPS, 0.2), np.zeros(STOPS, dtype=np.intp)
    step = {name: np.diff(q, axis=0, prepend=np.zeros((1, 6))) for name, q in plan.items()}
    readings = expected_readings(profile, plan, time_s=time_s, dwell_s=dwell_s, step=step, load=load)
    return planned_data(readings["left"])


@pytest.mark.parametrize("slug", ["backlash", "encoder_eccentricity", "joint_compliance"])
def test_an_effect_of_twice_the_promised_size_scores_and_of_a_fifth_does_not(slug: str, planned: ArmData) -> None:
    promised = next(one for one in planned_effects(planned) if one.effect == slug)
    name, size = next(iter(promised.smallest_seen.items()))
    fit = fit_terms(planned, ())
    scan = LawScan.of(fit.candidates(planned, [slug]), fit.projector)
    one = scan.candidates[0]
    row = one.rows[[column.name for column in one.columns].index(name)]
    scores = []
    for factor in (0.2, 2.0):
        residual = ProjectedResidual(fit.projector, fit.residual + factor * size.value * row)
        best = scan.ranked(residual)
        scores.append(best[0].value if best else -np.inf)
    assert scores[0] < 10.0 < scores[1]


# -- Gross errors of a few readings are left out and said; noise with heavy tails is not -------------------------------


def test_heavy_tails_are_no_gross_errors_and_a_moved_target_is_one() -> None:
    residual_M = 2e-5 * np.random.default_rng(1).standard_t(4, (400, 3))
    assert gross_errors(residual_M).mean() <= 0.005
    residual_M[7] += 2e-3
    assert gross_errors(residual_M)[7]
    assert not gross_errors(np.zeros((5, 3))).any()


@pytest.mark.slow
def test_discovery_of_a_real_arm_bears_gross_errors() -> None:
    ur5 = load_entrant("UR5")
    split = tuple("identify" if row % 8 == 0 else "validate" for row in range(len(ur5.readings)))
    readings = replace(ur5.readings, split=split)
    arm, _ = calibrate_arm(ur5.profile, ur5.arm, readings)
    calibrated = ArmReadings.alone(ur5.profile, ur5.arm, arm.model, readings)
    plain = discover_arm(calibrated)
    p_M = readings.p_M.copy()
    p_M[[80, 320, 640]] += np.array([[0.002, 0.0, 0.0], [0.0, -0.01, 0.0], [0.0, 0.0, 0.03]])
    disturbed = discover_arm(replace(calibrated, readings=replace(readings, p_M=p_M)))
    disturbed_mm, plain_mm = (one.result.heldout_position_mm for one in (disturbed, plain))
    assert sure(disturbed_mm).after.mean < 1.05 * sure(plain_mm).after.mean
    assert "3 readings with gross errors were left out (configurations 80, 320, 640)" in disturbed.result.sentence


# -- A network beside the effects: trained where the profile asks, chosen by left-out folds, not by held-out readings --

PROFILE_OF_REMAINING_NETWORK = load_profile(Path(__file__).parents[3] / "profiles" / "twin.yaml")
COMPLIANT = {"left": {"joint_compliance": {"stiffness": [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]}}}


def asking(network, kind="mlp"):
    return PROFILE_OF_REMAINING_NETWORK.model_copy(
        update={
            "discovery": PROFILE_OF_REMAINING_NETWORK.discovery.model_copy(update={"network": network}),
            "network": PROFILE_OF_REMAINING_NETWORK.network.model_copy(update={"kind": kind}),
        }
    )


@pytest.fixture(scope="module")
def searched(plan):
    """The left arm with compliance: its readings, its calibrated model, and what discovery found."""
    profile = with_hidden(PROFILE_OF_REMAINING_NETWORK.model_copy(update={"seed": 2}), COMPLIANT, 2)
    readings = blind_readings(profile, plan, 2)["left"]
    model = calibrate_arm(profile, "left", readings)[0].model
    discovery = discover_arm(ArmReadings.alone(profile, "left", model, readings))
    assert discovery.terms
    return profile, readings, model, discovery


def judged(discovery, verdict):
    return replace(discovery, result=discovery.result.model_copy(update={"verdict": verdict}))


def trained(searched, readings):
    """The outcome with a network, as if compliance had no name: the geometry alone stands for the accepted terms."""
    profile, _, model, discovery = searched
    discovery = replace(judged(discovery, "unknown effect"), model=model)
    return with_network(ArmReadings.alone(profile, "left", model, readings), discovery)


@pytest.mark.parametrize(
    ("network", "kind", "unknown"), [("unknown", "mlp", True), ("never", "mlp", False), ("unknown", "none", False)]
)
def test_a_network_is_trained_where_an_effect_stays_unknown_and_the_profile_asks(searched, network, kind, unknown):
    discovery, profile = searched[3], asking(network, kind)
    assert not needs_network(profile, judged(discovery, "explained"))
    assert needs_network(profile, judged(discovery, "unknown effect")) == unknown


def test_a_stored_profile_that_asks_for_a_network_always_still_opens():
    assert DiscoverySettings.model_validate({"network": "always"}).network == "unknown"


def test_a_network_models_what_has_no_name(searched):
    _, readings, _, discovery = searched
    found = trained(searched, readings)
    assert found.model.network is not None
    assert found.result.heldout_mm.after < 0.8 * discovery.result.heldout_mm.before
    assert found.result.steps[-1].heldout_mm == found.result.heldout_mm.after


def test_held_out_readings_do_not_choose_the_network(searched):
    readings = searched[1]
    p_M = readings.p_M.copy()
    rows = readings.in_split("validate")
    p_M[rows] += np.random.default_rng(1).normal(0.0, 5e-3, (len(rows), 3))
    found = [trained(searched, data) for data in (readings, replace(readings, p_M=p_M))]
    texts = [json.dumps(network_to_json(one.model.network)) for one in found]
    assert texts[0] == texts[1]


# -- Evidence of a structured process: the marginal likelihood of the readings, with right derivatives -----------------


N = 300
CYCLES = 20
FORM = LawForm("smooth", "smooth")


def columns(cycles):
    return tuple(EffectColumn(f"c{k}", "rad", "", -1.0, 1.0, ActsOn.BASE, wave=Wave(int(k), False)) for k in cycles)


def curve(rng):
    """A free function of one angle: cosines and sines of 1 ... ``CYCLES`` cycles, one amplitude, one length scale."""
    z = rng.uniform(-np.pi, np.pi, N)
    k = np.arange(1, CYCLES + 1)
    rows = np.concatenate([np.cos(np.outer(k, z)), np.sin(np.outer(k, z))])
    return Component(
        slug="transmission_error",
        columns=columns(np.tile(k, 2)),
        rows=rows,
        form=FORM,
        constants={},
        groups=np.zeros(2 * CYCLES, dtype=np.intp),
        amplitude_keys=("amplitude",),
        start=1.0,
        weights=np.ones(2 * CYCLES),
        amplitudes=np.array([0.8]),
        length=0.4,
        lengths=CURVE_LENGTHS,
        length_keys=("length",),
    )


def plain(rng):
    """Four random columns with two amplitudes."""
    return Component(
        slug="backlash",
        columns=columns(range(1, 5)),
        rows=rng.normal(size=(4, N)),
        form=FORM,
        constants={},
        groups=np.array([0, 0, 1, 1]),
        amplitude_keys=("amplitude1", "amplitude2"),
        start=1.0,
        weights=np.array([1.0, 0.5, 1.0, 2.0]),
        amplitudes=np.array([0.5, 0.3]),
    )


def gathered(components, y):
    rows = np.concatenate([one.rows for one in components])
    return replace(NormalMatrix.of(rows, y), coordinates=float(N))


NOISE = 0.1


def simulated(rng, components):
    """Readings (N,) of the components' prior."""
    rows = np.concatenate([one.rows for one in components])
    weights = rng.normal(size=len(rows)) * np.sqrt(np.concatenate([one.variances for one in components]))
    return weights @ rows + rng.normal(0.0, math.sqrt(NOISE), N)


def test_it_is_the_marginal_likelihood_of_the_readings():
    rng = np.random.default_rng(1)
    parts = (curve(rng), plain(rng))
    y = simulated(rng, parts)
    X = np.concatenate([one.rows for one in parts]).T
    variance = np.concatenate([one.variances for one in parts])
    dense = multivariate_normal(np.zeros(N), (X * variance) @ X.T + NOISE * np.eye(N))
    wanted = dense.logpdf(y) + 0.5 * N * math.log(2.0 * math.pi)
    # columns whose prior is below a thousandth of the noise are left out
    found = sure(ProcessEvidence.of(gathered(parts, y), variance, NOISE))
    assert found.value == pytest.approx(wanted, abs=0.02)


def test_hyperparameters_of_a_simulated_curve_are_recovered():
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(12):
        one = curve(rng)
        data = gathered([one], simulated(rng, [one]))
        begun = replace(one, amplitudes=np.array([one.start]), length=CURVE_LENGTHS.start)
        found = StructuredProcess((begun,), data.square / data.coordinates, data).most_evident()
        (curve_found,) = found.components
        errors.append(np.log([curve_found.amplitudes[0] / 0.8, curve_found.length / 0.4, found.noise / NOISE]))
    # a turn holds some 2 pi / 0.8 independent values of the curve: 25 % for its amplitude, 8 % for the noise
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.2)
    assert (np.std(errors, axis=0) < (0.4, 0.4, 0.16)).all()


# -- The structured process on a simulated arm: what is there stays, what is not is removed, with any weights ----------


@pytest.mark.parametrize("stated", [True, False])
def test_noise_needs_no_process(stated):
    assert fit_process(*fitted(150, stated=stated), 30.0) is None
