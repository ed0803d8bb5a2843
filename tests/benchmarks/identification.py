"""The identification whose time and memory are measured: one arm, 27 parameters, the noise of a laser tracker."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, smr_positions
from tests.arms import OFF_AXIS, UR10, at_station, true_geometry

Array = NDArray[np.float64]
NOISE_M = 15e-6


def problem(n: int) -> tuple[Geometry, Array, Array]:
    """Where an identification starts, joint positions (n, 6) [rad] and measured points (n, 3) [m]."""
    rng = np.random.default_rng(0)
    nominal = at_station(UR10, OFF_AXIS)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (n, 6))
    p_M = smr_positions(truth, q) + rng.normal(0.0, NOISE_M, (n, 3))
    return start_from_nominal(nominal, q, p_M, tool_unknown=False), q, p_M


def least_squares_of(start: Geometry, q: Array, p_M: Array) -> tuple[Array, Array]:
    """Matrix (3 n, 27) and right side of one linear least-squares problem of the same size."""
    columns = identify(start, q, p_M).parameter_set.columns
    _, J = jacobian(start, JointAngles.of(q), columns)
    return np.ascontiguousarray(J.transpose(0, 2, 1).reshape(-1, len(columns))), np.ones(3 * len(q))
