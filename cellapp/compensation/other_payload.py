"""What a payload adds to the uncertainty that no reading had.

Readings with one payload tell the compliance of a joint only as far as the arm's own weight loads it: a wrist that
carries little may give way by any amount that such arms do. Under another payload m the SMR then moves by

    sum_j J_j c_j (tau_j(q, m) - tau_j(q, m')),

with the joint's compliance c_j [rad/Nm] beside what the model has, and m' the nearest payload that was measured. The
readings leave c with the covariance of a linear estimate in which all geometry is free, its prior as wide as the
compliance of such drives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.calibration.measurement_conditions import measurement_conditions
from cellapp.effects import MeasurementConditions
from cellapp.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.run import Readings

_COMPLIANCE = 1e-4
"""Prior standard deviation [rad/Nm]: strain-wave drives of this class have 1e4 to 1e5 Nm/rad (Harmonic Drive, CSG)."""


def open_compliance(arm: ArmModel, readings: Readings) -> Array | None:
    """Covariance (N, N) [(rad/Nm)^2] of the joints' compliances that readings leave open; None where unknown.

    Unknown is it without a posterior, which has the scatter of the readings.
    """
    if arm.posterior is None or not len(readings):
        return None
    angles = JointAngles.of(readings.q)
    _, G = jacobian(arm.geometry, angles, arm.posterior.columns)
    context = arm.context(readings.q, conditions=measurement_conditions(readings))
    _, J = joint_jacobian(arm.geometry, angles)
    A = (J * context.torques.T[None]).transpose(0, 2, 1).reshape(-1, J.shape[1])
    free = G.transpose(0, 2, 1).reshape(len(A), -1)
    left, sizes, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)
    basis = left[:, sizes > 1e-9 * sizes[0]]
    A = A - basis @ (basis.T @ A)
    information = A.T @ A / arm.posterior.noise_m**2 + np.eye(A.shape[1]) / _COMPLIANCE**2
    return np.asarray(np.linalg.inv(information))


def payload_covariance(
    arm: ArmModel, q: Array, conditions: MeasurementConditions, measured_kg: tuple[float, float], compliance: Array
) -> Array:
    """Covariance (n, 3, 3) [m^2] that payloads beyond the ``measured_kg`` ones add at ``q`` (n, N) [rad]."""
    asked = arm.context(q, conditions=conditions)
    near = replace(conditions, payload_kg=np.clip(asked.payload_kg, *measured_kg))
    torque = asked.torques - arm.context(q, conditions=near).torques
    _, J = joint_jacobian(arm.geometry, JointAngles.of(q))
    moved = np.einsum("cjn,nj->ncj", J, torque)
    return np.asarray(moved @ compliance @ moved.transpose(0, 2, 1))
