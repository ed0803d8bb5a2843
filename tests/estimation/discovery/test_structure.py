"""Structure in residuals: found where it is, rarely where there is none, whatever the noise looks like."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import pearson3

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.discovery.verdict import CHANCE, has_structure, pearson3_tail, structure_left
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.latency import attempts
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

SIGMA_M = 10e-6
PROFILE = load_profile(PROFILES / "twin.yaml")


def fitted(n, bend=None, *, noise=None, seed=5, stated=True, times=True) -> tuple[ArmData, JointFit]:
    """Geometry fitted to random stops with joint offsets ``bend(q, approach, time)`` [rad]."""
    rng = np.random.default_rng(seed)
    geometry = nominal_arm(PROFILE.arms["left"]).with_T_M_B(STATION)
    q, time_s = rng.uniform(-2.0, 2.0, (n, 6)), 60.0 * np.arange(n, dtype=np.float64)
    approach = rng.choice([-1, 1], (n, 6)).astype(np.int8)
    offset = np.zeros((n, 6)) if bend is None else bend(q, approach, time_s)
    scatter = rng.normal(0.0, SIGMA_M, (n, 3)) if noise is None else noise(rng, q)
    readings = Readings(
        configuration=np.arange(n, dtype=np.int64),
        time_s=time_s if times else np.full(n, np.nan),
        q=q,
        approach=approach,
        p_M=smr_positions(geometry, q + offset) + scatter,
        sigma_m=np.full(n, SIGMA_M) if stated else None,
    )
    up = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(PROFILE.arms["left"]), up_M=up)
    data = ArmData.of(PROFILE, model, readings, measurement_conditions(readings))
    return data, fit_terms(data, ())


def only(joint, values):
    """Offsets of one joint (counted from 1)."""
    bent = np.zeros((len(values), 6))
    bent[:, joint - 1] = values
    return bent


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
    found = structure_left(*fitted(300, bend))
    p_values = {test.against: test.p_value for test in found.tests}
    assert has_structure(found)
    assert min(p_values, key=lambda kind: p_values[kind]) == against
    assert p_values[against] <= CHANCE / len(found.tests)


def test_structure_in_the_order_of_stops_is_found_without_times():
    found = structure_left(
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
        found = structure_left(*fitted(100, noise=noise, seed=seed))
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
    assert structure_left(few, fit).tests == ()
    assert not has_structure(structure_left(few, fit))


def test_hundreds_of_readings_take_milliseconds():
    data, fit = fitted(300)
    structure_left(data, fit)  # without the first call's imports
    for took in attempts(tested=0.15):
        begun = time.process_time()
        structure_left(data, fit)
        took["tested"] = time.process_time() - begun
