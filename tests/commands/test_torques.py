"""Torques from drives to the calibration: masses in the model, words, what is wrong by joint and row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.commands.calibrate.detail_tables import calibration_facts
from cellapp.commands.calibrate.request import VERB
from cellapp.commands.calibrate.run import calibrate_cell
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.profile import Profile, TorqueSensing
from cellapp.robot.model import CellModel
from drivers.arms.simulated import SimulatedArm
from drivers.plant import gravity_torques
from tests.estimation.calibration.test_torques import PROFILE, STATED, measured


def one_arm() -> Profile:
    without = PROFILE.network.model_copy(update={"kind": "none"})
    return PROFILE.model_copy(update={"arms": {"left": PROFILE.arms["left"]}, "network": without})


def test_torques_give_the_masses_of_the_model_and_are_said() -> None:
    _, readings, _ = measured()
    tau = readings.tau_nm
    assert tau is not None
    tau = tau.copy()
    tau[:, 3] *= -1.0
    row = int(np.argmax(np.abs(tau[:, 1])))
    tau[row, 1] *= -1.0
    result, model = calibrate_cell(one_arm(), {"left": replace(readings, tau_nm=tau)})
    found = result.arms["left"].torques
    assert found is not None
    assert found.used
    np.testing.assert_array_equal(model.arms["left"].bodies.masses, found.masses_kg)
    again = CellModel.from_json(model.to_json())
    np.testing.assert_array_equal(again.arms["left"].bodies.centers, np.array(found.centers_m))
    assert CalibrateResult.from_json(result.to_json(), "test") == result
    said = "\n".join(part for part in VERB.view(result).parts if isinstance(part, str))
    assert "they drive elasticity" in said
    assert "joint 4: its torques have the opposite sign" in said
    assert f"torques left out: configuration {row}: tau2 is" in said
    assert any("Arm left: measured torques" in str(part) for part in VERB.view(result).parts)
    assert "they drive elasticity" in str(calibration_facts(result))


def test_readings_without_torques_keep_the_stated_masses_and_their_json() -> None:
    _, readings, _ = measured()
    result, model = calibrate_cell(one_arm(), {"left": replace(readings, tau_nm=None)})
    np.testing.assert_array_equal(model.arms["left"].bodies.masses, STATED.masses)
    assert "torques" not in result.model_dump(by_alias=True)["arms"]["left"]


@pytest.mark.parametrize("constant", [None, 10.0])
def test_simulated_drives_hold_the_arm_up(constant: float | None) -> None:
    assert PROFILE.plant is not None
    sensing = TorqueSensing(noise_nm=0.0, friction_nm=0.0, constant_nm_per_a=constant)
    plant = build_plant(PROFILE.model_copy(update={"plant": PROFILE.plant.model_copy(update={"torques": sensing})}))
    arm = SimulatedArm(plant, "left")
    arm.connect()
    arm.start_move(np.array([0.3, -0.4, 0.6, -0.5, 0.4, 0.2]), np.full(6, 1.0), np.full(6, 1.0))
    plant.advance(10.0)
    state = arm.state()
    reported = state.tau_nm if constant is None else state.current_a
    assert reported is not None
    assert (state.current_a if constant is None else state.tau_nm) is None
    config = next(one for one in plant.config.arms if one.name == "left")
    expected = -gravity_torques(config, state.q[None])[0] / (constant or 1.0)
    np.testing.assert_allclose(reported, expected, atol=0.05 * np.abs(expected).max())


def test_drives_that_measure_nothing_report_nothing() -> None:
    arm = SimulatedArm(build_plant(PROFILE), "left")
    arm.connect()
    assert (arm.state().tau_nm, arm.state().current_a) == (None, None)
