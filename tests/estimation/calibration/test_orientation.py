"""Orientations beside positions: known truth, intervals, frames that are wrong, and gross errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.target_visit import push
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.targets import targets_in_memory
from cellapp.commands.calibrate.result import calibrate_result
from cellapp.commands.calibrate.view import cooperative_noise_mrad
from cellapp.commands.calibrate.view import view as calibrate_view
from cellapp.estimation.calibration.calibrate import calibrate_arm, calibrate_readings, train_arm
from cellapp.estimation.calibration.identification import identify_with_excess, start_from_nominal
from cellapp.estimation.calibration.quantities import measured_quantities, refuse_odd_orientations, with_probe
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import (
    PROBE_NAMES,
    JointAngles,
    jacobian,
    probe_rotations,
    smr_positions,
    smr_positions_of,
)
from cellapp.robot.model import CellModel
from cellapp.robot.model.inverse import invert
from cellapp.robot.model.nominal import nominal_arm
from tests.approved import text_of
from tests.arms import true_geometry
from tests.evidence.shared.cells import TWIN, measured_plan
from tests.evidence.shared.estimates import merged_values
from tests.evidence.shared.series import load_entrant, sample_rows
from tests.series import readings_at, twin
from tests.sure import sure
from tests.twin import altered

SIGMA_M, SIGMA_RAD = 3e-5, 8e-5
PROBE = np.array([0.4, -1.2, 2.0])


def truth(seed=0):
    nominal = nominal_arm(twin().arms["left"])
    T_M_B = np.eye(4)
    T_M_B[:3, 3] = [2.0, 1.0, 0.3]
    geometry = true_geometry(nominal.with_T_M_B(T_M_B), np.random.default_rng(seed))
    rows = geometry.rows.copy()
    rows[-1, 3] = nominal.rows[
        -1, 3
    ]  # alpha of the last joint is a part of tool and probe, and has no value of its own
    return nominal, replace(geometry, rows=rows, probe=PROBE)


def measured(geometry, n, seed, *, noise=1.0, wrist_down=False):
    """Readings of a 6-D probe; with the ``wrist_down`` the last axis keeps its direction in space."""
    rng = np.random.default_rng([seed, 3])
    q = rng.uniform(-2.5, 2.5, (n, geometry.joints))
    if wrist_down:
        q[:, 3], q[:, 4] = -q[:, 1] - q[:, 2] - np.pi / 2.0, -np.pi / 2.0
    noises = noise * SIGMA_M * rng.standard_normal((n, 3)), noise * SIGMA_RAD * rng.standard_normal((n, 3))
    R_M_S = Rotation.from_rotvec(noises[1]).as_matrix() @ probe_rotations(geometry, q)
    quaternion_M = np.roll(Rotation.from_matrix(R_M_S).as_quat(), 1, axis=1)
    return readings_at(q, smr_positions(geometry, q) + noises[0], sigma_m=SIGMA_M, quaternion_M=quaternion_M, split=5)


def start_of(readings, nominal):
    its = measured_quantities(readings)
    start = start_from_nominal(nominal, readings.q, readings.p_M, tool_unknown=True)
    return with_probe(start, its.readings.q, its.R_M_S)


def identified(readings, nominal, **changes):
    arguments = {"prior_sigma": {}, **changes}
    return identify_with_excess(start_of(readings, nominal), measured_quantities(readings), **arguments)


def test_derivatives_of_positions_and_orientations_are_those_of_the_chain():
    _, geometry = truth()
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (6, 6))
    R_M_S = probe_rotations(geometry, q)
    R_M_S[:3] = np.nan
    angles, columns = JointAngles.of(q, R_M_S), tuple(range(len(geometry.names)))
    computed, J = jacobian(geometry, angles, columns)
    np.testing.assert_allclose(computed[:, 3:], 0.0, atol=1e-14)
    np.testing.assert_allclose(computed[:, :3].T, smr_positions(geometry, q[:3]), atol=1e-15)
    for column in columns:
        step = np.zeros(len(columns))
        step[column] = 1e-6
        ahead, behind = (geometry.with_vector(geometry.vector() + sign * step) for sign in (1.0, -1.0))
        slope = (smr_positions_of(ahead, angles) - smr_positions_of(behind, angles)) / 2e-6
        np.testing.assert_allclose(J[:, column], slope, atol=1e-8)


def test_orientation_parameters_lie_within_their_stated_intervals():
    """Nothing is stated of the angles: their noise is estimated beside the stated one of positions."""
    beyond, scatter = [], []
    for seed in range(12):
        nominal, geometry = truth(seed)
        readings = measured(geometry, 60, seed)
        found, excess_m = identified(readings, nominal)
        scatter.append((found.excess_rad, excess_m))
        exact = merged_values(found.parameter_set, geometry, start_of(readings, nominal))
        beyond.append((found.values - exact) / found.standard_errors)
    inside = np.abs(beyond) < 1.96
    rotations = [found.names.index(name) for name in PROBE_NAMES]
    assert 0.92 < inside.mean() < 0.98
    assert inside[:, rotations].mean() > 0.85  # of 36
    assert np.mean([one for one, _ in scatter]) == pytest.approx(SIGMA_RAD, rel=0.05)
    assert max(excess for _, excess in scatter) < 0.7 * SIGMA_M


WRONG = {
    "give the inverse": lambda quaternion: quaternion * np.array([1.0, -1.0, -1.0, -1.0]),
    "scalar last": lambda quaternion: np.roll(quaternion, -1, axis=1),
    "mirrored frame \\(x against y and z\\)": lambda quaternion: quaternion * np.array([1.0, 1.0, -1.0, -1.0]),
    "no usual convention": lambda quaternion: quaternion[::-1].copy(),
}


@pytest.mark.parametrize("words", WRONG)
def test_orientations_in_another_convention_are_refused_by_name(words):
    _, geometry = truth()
    readings = measured(geometry, 40, 0)
    wrong = replace(readings, quaternion_M=WRONG[words](readings.quaternion_M))
    with pytest.raises(InputError, match=f"arm 'left'.*configuration 0, do not rotate with the flange; .*{words}"):
        calibrate_arm(twin(), "left", wrong)


def test_a_mirrored_frame_of_a_probe_that_hardly_turned_is_named():
    """A probe that always faces the tracker turns so little that its mirror image is 0.2 rad off, not more."""
    entrant = load_entrant("D6")
    readings = entrant.readings
    mirrored = replace(readings, quaternion_M=readings.quaternion_M * np.array([1.0, 1.0, -1.0, -1.0]))
    geometry = start_from_nominal(
        nominal_arm(entrant.profile.arms["left"]), readings.q, readings.p_M, tool_unknown=True
    )
    refuse_odd_orientations("left", geometry, readings)
    with pytest.raises(InputError, match=r"mirrored frame \(x against y and z\)"):
        refuse_odd_orientations("left", geometry, mirrored)


def test_a_single_wrong_orientation_is_left_out_by_configuration():
    _, geometry = truth()
    readings = measured(geometry, 80, 0)
    quaternion = readings.quaternion_M.copy()
    quaternion[17] = quaternion[18]
    arm, notes = calibrate_arm(twin(), "left", replace(readings, quaternion_M=quaternion))
    assert arm.left_out == (17,)
    assert any("configuration 17" in note for note in notes)


def test_a_real_arm_in_six_dimensions():
    """Bars: what a plain reference fit of positions and orientations reaches, 0.369 mm and 0.94 mrad."""
    entrant = load_entrant("D6")
    readings = sample_rows(entrant, 300, 0).split(entrant.readings)
    arm, notes = calibrate_arm(entrant.profile, entrant.arm, readings)
    errors = arm.validate["geometry"]
    assert errors.position_mm.mean < 0.37
    assert sure(errors.orientation_mrad).mean < 0.96
    assert arm.identification.excess_rad == pytest.approx(0.55e-3, rel=0.1)
    assert len([note for note in notes if "along (0.00, 0.00, 1.00) of the flange is not determined" in note]) == 1


# -- two arms with a probe each: the pair in orientation ---------------------------------------------------------------


@pytest.fixture(scope="module")
def six():
    """The twin with two probes, without networks, and its readings."""
    profile = load_profile(TWIN.with_name("twin-6d.yaml"))
    profile = altered(profile, network={"kind": "none"})
    readings = measured_plan(profile, plan_stops(profile), 0)
    return profile, {
        name: replace(own, time_s=30.0 * np.arange(float(len(own))), sequence=np.arange(float(len(own))))
        for name, own in readings.items()
    }


@pytest.fixture(scope="module")
def learnt(six):
    profile, readings = six
    calibration = calibrate_readings(profile, readings)
    return calibration, discover_cell(profile, calibration.model, readings)


def test_two_probes_calibrate_the_pair_in_orientation(six, learnt):
    """After discovery the rotation of one flange in the other's frame is predicted as well as two probes measure it."""
    (profile, readings), (calibration, found) = six, learnt
    result: Any = calibrate_result(calibration)
    nominal, geometry = (result.pair[method] for method in ("nominal", "method_1"))
    assert nominal.cooperative_mrad.mean > 2.0 * geometry.cooperative_mrad.mean
    assert ", orientation [mrad]" in text_of(calibrate_view(result).parts)
    one = {**readings, "right": replace(readings["right"], quaternion_M=None, sigma_rad=None)}
    of_one: Any = calibrate_result(calibrate_readings(profile, one))
    assert any("orientations were measured of arm 'left' alone" in note for note in of_one.notes)
    alone = of_one.pair["method_1"]
    assert alone.cooperative_mrad is None
    for name in ("theta", "beta", "alpha"):
        assert geometry.identified[name].standard_error < 0.7 * alone.identified[name].standard_error
    after: Any = found.pair.methods["effects"].cooperative_mrad
    assert cooperative_noise_mrad(result) == pytest.approx(np.sqrt(6.0) * 0.04)
    assert after.rms < 1.2 * np.sqrt(6.0) * 0.04


def test_the_network_corrects_position_and_rotation(six):
    readings = six[1]["left"]
    words = tuple(("identify", "train", "validate", "train")[row % 4] for row in range(len(readings)))
    profile, readings = load_profile(TWIN.with_name("twin-6d.yaml")), replace(readings, split=words)
    arm = train_arm(profile, calibrate_arm(profile, "left", readings)[0], readings)
    errors: Any = arm.validate
    geometry, network = errors["geometry"], errors["network"]
    assert network.position_mm.mean < 0.9 * geometry.position_mm.mean
    assert network.orientation_mrad.mean < 0.4 * geometry.orientation_mrad.mean
    q, stored = readings.q[:5], CellModel.from_json(CellModel({"left": arm.model}).to_json()).arms["left"]
    found = invert(stored, arm.model.predict(q), arm.model.flange(q)[0], q + 0.01)
    assert found.reached.all()
    np.testing.assert_allclose(found.q, q, atol=1e-6)


def slipped(readings, angle):
    """The left probe turned in its mount by ``angle`` [rad] from configuration 43 on."""
    own = readings["left"]
    rotations = Rotation.from_quat(own.quaternion_M, scalar_first=True)
    angular = rotations * Rotation.from_rotvec((own.configuration >= 43)[:, None] * np.full(3, angle / np.sqrt(3.0)))
    return {**readings, "left": replace(own, quaternion_M=angular.as_quat(scalar_first=True))}


def exchanged(readings, *names):
    left, right = readings.values()
    pairs = {"left": (left, right), "right": (right, left)}
    return {arm: replace(own, **{name: getattr(of, name) for name in names}) for arm, (own, of) in pairs.items()}


EXCHANGED = "the probes of arms 'left' and 'right' are exchanged: the {} of each follow the other arm"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda its: exchanged(its, "quaternion_M"), EXCHANGED.format("orientations")),
        (lambda its: exchanged(its, "quaternion_M", "p_M"), EXCHANGED.format("positions and orientations")),
        (lambda its: slipped(its, 0.1), "arm 'left': the probe slipped in its mount before configuration 43"),
    ],
)
def test_probes_that_are_not_as_they_were_are_named(six, changed, words):
    profile, readings = six
    with pytest.raises(InputError, match=words):
        calibrate_readings(profile, changed(readings))


@pytest.mark.slow
def test_a_small_slip_of_a_probe_is_found_with_its_stop(six):
    profile, readings = six
    readings = slipped(readings, 3e-4)
    found = discover_cell(profile, calibrate_readings(profile, readings).model, readings).arms["left"].result
    slip = next(one for one in found.accepted if one.effect == "target_slip")
    assert slip.law.constants["onset_s"] == pytest.approx(42.5 * 30.0, abs=30.0)  # between two learned stops
    size = np.linalg.norm([slip.parameters[f"turn_{axis}"].value for axis in "xyz"])
    assert size == pytest.approx(3e-4, rel=0.15)


@pytest.mark.parametrize("moves", ["both", "partner"])
def test_the_pose_of_one_flange_in_the_others_frame_is_met_within_its_bound(six, learnt, moves):
    """A first arm that keeps its command is millimetres off; its partner makes up for both."""
    (profile, _), (_, found) = six, learnt
    partner: dict[str, Any] = {"arm": "right", "position": [0.0, 0.5, 0.0], "rpy": [0.0, 0.0, 0.0], "moves": moves}
    wanted: dict[str, Any] = {"frame": "tracker", "position": [3.45, -0.25, 0.0], "rpy": [0.0, -1.4, 0.0]}
    wanted |= {"name": "pair", "arm": "left", "tolerance": 2e-4, "orientation_tolerance": 3e-4, "partner": partner}
    commands: Any = compensate(profile, found.model, targets_in_memory([wanted], profile))
    first, second = (one.record for one in commands)
    assert (np.abs(np.subtract(first.q_compensated, first.q_nominal)).max() < 1e-8) == (moves == "partner")
    assert (second.relative.verdict, second.relative.turn_verdict) == ("in", "in")
    pushed: Any = push(profile, found.model, commands, verify=True)
    (pair,) = pushed.pairs
    assert pair.relative.final_mm < pair.relative.within_mm == second.relative.within_mm < 0.1
    assert pair.relative.final_mrad < pair.relative.within_mrad < 0.2
    assert (pair.relative.verdict, pushed.complaints()) == ("in", [])
    assert pair.relative.nominal_mm > 5.0
    assert pushed.cooperative.compensated_mrad.mean == pytest.approx(pair.relative.final_mrad)
