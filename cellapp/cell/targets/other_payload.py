"""What a payload adds to the uncertainty that no reading had.

Readings with one payload tell the compliance of a joint only as far as the arm's own weight loads it: a wrist that
carries little may give way by any amount that such arms do. Under another payload m the SMR then moves by

    sum_j J_j c_j (tau_j(q, m) - tau_j(q, m')),

with the joint's compliance c_j [rad/Nm] beside what the model has, and m' the nearest payload that was measured. What
the readings say of c is a linear estimate from their residuals in which all geometry is free, its prior as wide as the
compliance of such drives. The model leaves c at zero, as no search was sure of more, so that the second moment about
zero counts: covariance of the estimate, and its square.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_COMPLIANCE = 1e-4
"""Prior standard deviation [rad/Nm]: strain-wave drives of this class have 1e4 to 1e5 Nm/rad (Harmonic Drive, CSG)."""
_DEPENDENT = 1e-9
"""Relative singular value below which columns of the geometry are combinations of others."""


def open_compliance(arm: ArmModel, readings: Readings) -> Array | None:
    """Second moment (N, N) [(rad/Nm)^2] of the joints' compliances that readings leave open; None where unknown.

    It is unknown without a posterior, which has the scatter of the readings, and without measured positions.
    """
    readings = readings.take(np.flatnonzero(np.isfinite(readings.p_M).all(axis=1)))
    if arm.posterior is None or not len(readings):
        return None
    conditions, angles = measurement_conditions(readings), JointAngles.of(readings.q)
    _, J = joint_jacobian(arm.geometry, angles)
    _, G = jacobian(arm.geometry, angles, arm.posterior.columns)
    A = _rows(J * arm.context(readings.q, conditions=conditions).torques.T[None])
    residual = (readings.p_M - arm.predict(readings.q, conditions=conditions)).T.ravel()
    free = _rows(G)
    left, sizes, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)
    basis = left[:, sizes > _DEPENDENT * sizes[0]]
    A, residual = A - basis @ (basis.T @ A), residual - basis @ (basis.T @ residual)
    variance = arm.posterior.noise_m**2
    covariance = np.linalg.inv(A.T @ A / variance + np.eye(A.shape[1]) / _COMPLIANCE**2)
    found = covariance @ (A.T @ residual) / variance
    return np.asarray(covariance + np.outer(found, found))


def payload_covariance(
    arm: ArmModel,
    q: Array,
    conditions: MeasurementConditions,
    measured_kg: tuple[float, float] | None,
    compliance: Array | None,
) -> Array:
    """Covariance (n, 3, 3) [m^2] that payloads beyond the ``measured_kg`` ones add at ``q`` (n, N) [rad].

    Where ``conditions`` have a measured orientation, that of the rotation [rad^2]. Readings without payloads had the
    arm's usual one; without a ``compliance`` nothing is known to add.
    """
    if compliance is None:
        return np.zeros((len(q), 3, 3))
    measured_kg = measured_kg or (arm.bodies.payload_mass, arm.bodies.payload_mass)
    asked = arm.context(q, conditions=conditions)
    near = replace(conditions, payload_kg=np.clip(asked.payload_kg, *measured_kg))
    torque = asked.torques - arm.context(q, conditions=near).torques
    _, J = joint_jacobian(arm.geometry, JointAngles.of(q, conditions.R_M_S))
    moved = np.einsum("cjn,nj->ncj", J, torque)
    return np.asarray(moved @ compliance @ moved.transpose(0, 2, 1))


def _rows(columns: Array) -> Array:
    """Derivatives (3, k, n) as one column a parameter: (3 n, k)."""
    return np.asarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]))
