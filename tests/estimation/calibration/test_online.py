"""The fit during collection agrees with the identification of the same readings, stop by stop, and from their store."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.estimation.calibration.identification import identify_with_excess, start_from_nominal
from cellapp.estimation.calibration.online import OnlineFit
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.ground.errors import InputError
from cellapp.ground.progress import StopReport
from cellapp.robot.kinematics.chain import JointAngles, jacobian, smr_positions
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import OFF_AXIS, UR10, at_station
from tests.evidence.shared.estimates import merged_values
from tests.series import Array, Series, readings_at, series, twin
from tests.sure import sure
from tests.twin import altered

STOPS = 150


@pytest.fixture(scope="module")
def readings() -> dict[str, Series]:
    return series(7, STOPS)


def add(fit: OnlineFit, one: Series, stop: int) -> StopReport | None:
    """Add the reading of one stop."""
    return fit.add([stop], one.q[[stop]], one.p_M[[stop]], one.covariance_M[[stop]])


def fitted(name: str, one: Series, *, stated: bool = True) -> tuple[OnlineFit, StopReport]:
    """The fit after all readings, one by one, and its last report."""
    fit = OnlineFit(twin(), name, one.q)
    for stop in range(len(one.q)):
        report = add(fit, one, stop) if stated else fit.add([stop], one.q[[stop]], one.p_M[[stop]])
    fit.refit()
    report = sure(fit.report(stop, one.q[stop], one.p_M[stop]))
    return fit, report


def error_m(fit: OnlineFit, q: Array, true_M: Array) -> float:
    """Rms distance of the fit's SMR positions from the true ones [m]."""
    return float(np.sqrt(np.mean(np.sum((smr_positions(sure(fit.geometry), q) - true_M) ** 2, axis=1))))


@pytest.mark.parametrize(("name", "stated"), [("left", True), ("right", False)])
def test_after_all_stops_it_agrees_with_the_identification_of_the_same_readings(readings, name, stated):
    one = readings[name]
    nominal = start_from_nominal(nominal_arm(twin().arms[name]), one.q, one.p_M, tool_unknown=False)
    its = measured_quantities(readings_at(one.q, one.p_M, covariance_M=one.covariance_M if stated else None))
    batch, _ = identify_with_excess(nominal, its)
    fit, report = fitted(name, one, stated=stated)
    geometry = sure(fit.geometry)
    off = (merged_values(batch.parameter_set, geometry, nominal) - batch.values) / batch.standard_errors
    assert np.abs(off).max() < 0.05
    _, J = jacobian(batch.geometry, JointAngles.of(one.q), batch.parameter_set.columns)
    rms = math.sqrt(np.einsum("ckn,kl,cln->", J, batch.covariance, J) / STOPS)
    assert report.standard_error_mm == pytest.approx(rms * 1e3, rel=0.05)


def test_it_converges_from_centimetres_within_a_few_stops(readings):
    one = readings["right"]
    fit = OnlineFit(twin(), "right", one.q)
    errors = {}
    for stop in range(40):
        report = add(fit, one, stop)
        assert (report is None) == (stop < 3)
        if stop in (4, 39):
            errors[stop] = error_m(fit, one.q, one.true_M)
    assert errors[4] < 10e-3
    assert errors[39] < 0.15e-3  # backlash of the twin leaves 0.08 mm


def test_the_stated_uncertainty_of_predictions_covers_the_next_readings(readings):
    one = readings["left"]
    fit = OnlineFit(twin(), "left", one.q)
    squares = []
    for stop in range(STOPS):
        add(fit, one, stop)
        if stop >= 40:
            assert fit.innovation is not None
            squares.append(fit.innovation.off_M @ np.linalg.solve(fit.innovation.covariance_M, fit.innovation.off_M))
            assert np.linalg.norm(fit.innovation.off_M) < 8.0 * math.sqrt(np.trace(fit.innovation.covariance_M))
    assert np.mean(squares) / 3.0 == pytest.approx(1.0, abs=0.35)


def test_residuals_of_all_readings_are_those_of_the_geometry_and_name_gross_errors(readings):
    one = readings["right"]
    fit = OnlineFit(twin(), "right", one.q)
    assert fit.residuals() is None
    p_M = one.p_M.copy()
    p_M[7] += 0.05
    fit.add(range(STOPS), one.q, p_M, one.covariance_M)
    found = sure(fit.residuals())
    assert np.flatnonzero(found.gross).tolist() == [7]
    expected = np.linalg.norm(p_M - smr_positions(sure(fit.geometry), one.q), axis=1)
    np.testing.assert_allclose(found.length_m, expected, atol=1e-7)
    good = ~found.gross
    assert np.sqrt(np.mean((found.length_m[good] / found.sigma_m[good]) ** 2)) == pytest.approx(1.0, abs=0.2)


def test_a_reading_of_another_smr_has_no_weight(readings):
    one = readings["right"]
    fit = OnlineFit(twin(), "right", one.q)
    for stop in range(60):
        wrong = stop in (30, 31)
        p_M = one.p_M[stop] + (np.array([0.0, 1.2, 0.3]) if wrong else 0.0)
        report = fit.add([stop], one.q[[stop]], p_M[None], one.covariance_M[[stop]])
        if wrong:
            assert sure(report).residual_mm > 1000.0
    assert error_m(fit, one.q, one.true_M) < 0.15e-3


def test_points_on_one_line_and_the_same_stop_again_give_no_model():
    nominal = at_station(UR10, OFF_AXIS)
    q = np.tile(np.linspace(0.1, 0.6, 6), (8, 1))
    fit = OnlineFit(twin(), "left", q)
    assert all(fit.add([stop], q[:1], smr_positions(nominal, q[:1])) is None for stop in range(8))
    assert not fit.ready
    assert fit.geometry is None


def test_a_parameter_set_of_another_arm_is_refused_before_anything_moves():
    profile = twin()
    arms = {"left": altered(profile.arms["left"], type={"joints": profile.arms["left"].type.joints[:5]})}
    with pytest.raises(InputError, match=r"arm 'left': calibration\.parameter_set: .* use 'auto'"):
        OnlineFit(altered(profile, arms=arms, calibration={"parameter_set": "paper"}), "left", np.zeros((3, 5)))


def test_steps_that_do_not_end_leave_no_model_and_nothing_is_said_about_a_reading(readings, monkeypatch):
    one = readings["left"]
    fit = OnlineFit(twin(), "left", one.q)
    monkeypatch.setattr("cellapp.estimation.calibration.online._STEPS", 1)
    reports = [add(fit, one, stop) for stop in range(5)]
    assert reports == [None] * 5
    assert not fit.ready
    assert (fit.geometry, fit.residuals(), fit.innovation) == (None, None, None)
    monkeypatch.undo()
    for stop in range(5, 20):
        add(fit, one, stop)
    assert fit.ready
    assert error_m(fit, one.q, one.true_M) < 2e-3
