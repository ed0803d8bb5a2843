"""Discovery in positions and orientations: the last joint shows, bounds hold, commands put the flange right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.invert import invert
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import measured_quantities, measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.search.state import scatter
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import rotation_vectors
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import true_geometry
from tests.series import twin

SIGMA_M, SIGMA_RAD = 3e-5, 6e-5
LAST_RAD = 3e-4
SOFT = 1e-6
"""Compliance of a pedestal [rad/Nm]: 0.1 mrad under the arm's own weight."""


def turned_arm(n, seed):
    """An arm whose last joint errs twice a turn, with the probe's origin on its axis: points see nothing of it."""
    rng = np.random.default_rng(seed)
    nominal = nominal_arm(twin().arms["left"])
    T_M_B = np.eye(4)
    T_M_B[:3, 3] = [2.5, 0.5, 0.2]
    geometry = true_geometry(nominal.with_T_M_B(T_M_B), rng)
    geometry = replace(geometry, tool=np.array([0.0, 0.0, 0.1]), probe=np.array([0.1, 0.5, -2.0]))
    q = rng.uniform(-2.5, 2.5, (n, 6))
    true = q.copy()
    true[:, 5] += LAST_RAD * np.sin(2.0 * q[:, 5])
    return geometry, q, true, rng


def readings_of(geometry, q, true, rng):
    n = len(q)
    none = smr_positions(geometry, true, np.tile(np.eye(3), (n, 1, 1)))  # rotation vectors of the orientations
    R_M_S = Rotation.from_rotvec(SIGMA_RAD * rng.standard_normal((n, 3))) * Rotation.from_rotvec(none)
    return Readings(
        configuration=np.arange(n),
        time_s=np.full(n, np.nan),
        q=q,
        approach=np.zeros(q.shape, dtype=np.int8),
        p_M=smr_positions(geometry, true) + SIGMA_M * rng.standard_normal((n, 3)),
        sigma_m=np.full(n, SIGMA_M),
        quaternion_M=np.roll(R_M_S.as_quat(), 1, axis=1),
        sigma_rad=np.full(n, SIGMA_RAD),
        split=tuple("validate" if row % 3 == 2 else "identify" for row in range(n)),
    )


@pytest.fixture(scope="module")
def both():
    """The arm, its readings, and discovery in them with and without their orientations."""
    geometry, q, true, rng = turned_arm(180, 1)
    readings = readings_of(geometry, q, true, rng)
    profile = twin()
    profile = profile.model_copy(
        update={"discovery": profile.discovery.model_copy(update={"null_simulations": 100, "network": "never"})}
    )
    found = {}
    for name, its in (("both", readings), ("points", replace(readings, quaternion_M=None, sigma_rad=None))):
        arm, _ = calibrate_arm(profile, "left", its)
        found[name] = discover_arm(profile, "left", arm.model, its)
    return readings, found


def last_joint(discovery):
    return [one.effect for one in discovery.result.accepted if "joint 6" in str(one.where)]


def test_the_last_joint_shows_by_orientation_only(both):
    _, found = both
    assert last_joint(found["both"]) == ["transmission_error"]
    assert not last_joint(found["points"])
    (term,) = found["both"].terms
    largest = np.abs(term.values).max()
    assert largest == pytest.approx(LAST_RAD, rel=0.1)
    errors = found["both"].result.heldout_orientation_mrad
    assert errors.before.mean > 1.3 * errors.after.mean
    assert found["points"].result.heldout_orientation_mrad is None


def test_stated_intervals_of_orientations_hold(both):
    readings, found = both
    its = measured_quantities(readings, measurement_conditions(readings))
    assert its.turned is not None
    model, rows = found["both"].model, its.turned & np.isin(its.reading, readings.in_split("validate"))
    left = its.readings.p_M - model.predict(its.readings.q, conditions=its.conditions)
    sd = model.measured_uncertainty(its.readings.q, its.conditions)
    assert 0.90 < np.mean(np.abs(left[rows]) < 1.96 * sd[rows, None]) < 0.99
    assert model.posterior is not None
    assert model.posterior.noise_rad == pytest.approx(SIGMA_RAD, rel=0.15)


def test_the_same_uncertainty_as_covariances_leaves_the_same_scatter(both):
    """Variances of positions, some 1e-9 m^2, are not taken for standard uncertainties that state nothing."""
    readings, found = both
    blocks = np.tile(np.eye(3), (len(readings), 1, 1))
    as_blocks = replace(
        readings, sigma_m=None, covariance_M=SIGMA_M**2 * blocks, turning_covariance_M=SIGMA_RAD**2 * blocks
    )
    left = []
    for its in (readings, as_blocks):
        data = ArmData.of(twin(), found["both"].model, its, measurement_conditions(its))
        left.append(scatter(data, fit_terms(data, ())))
    assert left[0] is not None
    assert left[1] is not None
    assert left[1].ratio == pytest.approx(left[0].ratio, rel=1e-6)


def test_commands_put_the_flange_where_base_and_links_turn_it(both):
    """A model with a soft pedestal is inverted: position and orientation are then both as wanted."""
    law, nothing = EFFECTS["pedestal_compliance"].law("isotropic"), np.zeros(1)
    tilting = EffectTerm("pedestal_compliance", ("pedestal_tilt",), np.array([SOFT]), nothing, ("rad/Nm",), law)
    found = both[1]["both"].model
    model = replace(found, effects=(*found.effects, tilting))
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (5, 6))
    stiff = flange_poses(model.geometry, model.true_joints(q))[0]
    wanted_M, (wanted_R, _) = model.predict(q), model.flange(q)
    assert np.linalg.norm(rotation_vectors(stiff.swapaxes(1, 2) @ wanted_R), axis=1).max() > 2e-5
    back = invert(model, wanted_M, wanted_R, q + 0.02)
    assert back.reached.all()
    np.testing.assert_allclose(model.predict(back.q), wanted_M, atol=1e-6)
    off = rotation_vectors(model.flange(back.q)[0] @ wanted_R.swapaxes(1, 2))
    assert np.abs(off).max() < 1e-6


def test_the_model_is_stored_with_its_probe(both):
    readings, found = both
    model = found["both"].model
    stored = CellModel.from_json(CellModel({"left": model}).to_json()).arms["left"]
    its = measured_quantities(readings, measurement_conditions(readings))
    computed, again = (one.predict(its.readings.q, conditions=its.conditions) for one in (model, stored))
    np.testing.assert_array_equal(computed, again)
    assert stored.posterior is not None
    assert model.posterior is not None
    assert stored.posterior.noise_rad == model.posterior.noise_rad
    alone = stored.of_positions()
    assert set(stored.identified) - set(alone.identified) == {"rx", "ry", "rz"}
    np.testing.assert_array_equal(alone.predict(readings.q), model.predict(readings.q))
