"""Additional uncertainty due to a payload that no reading had, from all plausible elastic behaviour of the joints.

The elasticity law that a search accepted is valid for the loads of the readings. For other loads more laws are
plausible: drives are stiffer under load, masses differ from the stated ones, and the compliance of a joint that its own
weight hardly loads is known only to be that of such drives. So all of these are fitted together with all geometry to
the readings as they are:

    dq_j = c_j tau_j + sum_k s_jk clip(tau_j, -T_k, T_k) + h_j (tau_j - clip(tau_j, -T, T)) + sum_i m_ji tau_ji,

where tau_j is the torque about joint j, tau_ji that of body i alone, T the largest one among the readings and T_k
fractions of it [Nm]. c_j has a prior as wide as such drives; the priors of m_ji and s_jk are fractions of the joint's
compliance (m, and r), that of h_j a quarter of r's. r is averaged over some values, weighted by their evidence
(marginal likelihood), so that readings which show straight laws keep straight ones likely for other loads. Beyond that
the readings do not constrain h_j.

From the nearest measured payload m' to m the SMR then moves by the mean of all this, with covariance C. The accepted
law predicts a different motion; the difference d remains as an error of the commands. Therefore the second moment about
the accepted law counts: C + d d^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectContext, MeasurementConditions, displacement
from cellapp.robot.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_COMPLIANCE = 1e-4
"""Prior standard deviation [rad/Nm]: strain-wave drives of this class have 1e4 to 1e5 Nm/rad (Harmonic Drive, CSG)."""
_KNEES = (0.15, 0.35, 0.65)
"""Fractions of the largest torque below which a joint may be softer."""
_BENT = (0.01, 0.1, 0.5)
"""Values of r, relative to a joint's compliance: catalogues have K3 / K1 up to 2."""
_OF_MASSES = 0.2
"""Value of m: makers' masses are 10 to 30 % off. One load cannot separate a common mass error from compliance."""
_BEYOND = 0.25
"""Fraction of r for torques beyond all measured ones: drives stiffen most at small torques."""
_DEPENDENT = 1e-9
"""Relative singular value below which columns of the geometry count as linearly dependent."""
_ELASTIC = ("joint_compliance", "payload_compliance")


@dataclass(frozen=True, eq=False)
class OpenElasticity:
    """Elastic behaviour of an arm's joints that its readings leave plausible.

    Attributes
    ----------
    values : array, shape (p,)
        Mean of the parameters of ``_columns`` [rad/Nm].
    covariance : array, shape (p, p)
    largest_nm : array, shape (N,)
        Largest torque about each joint among the readings [Nm].
    """

    values: Array
    covariance: Array
    largest_nm: Array

    @classmethod
    def of(cls, arm: ArmModel, readings: Readings) -> OpenElasticity | None:
        """Fit to readings with the model in force; None without a posterior, which has the scatter of the readings, or
        without measured positions."""
        readings = readings.take(np.flatnonzero(np.isfinite(readings.p_M).all(axis=1)))
        if arm.posterior is None or not len(readings):
            return None
        conditions = measurement_conditions(readings)
        context = arm.context(readings.q, conditions=conditions)
        angles, largest_nm = JointAngles.of(readings.q), np.abs(context.torques).max(axis=0)
        _, J = joint_jacobian(arm.geometry, angles)
        _, G = jacobian(arm.geometry, angles, arm.posterior.columns)
        joint, kind, offsets = _columns(context, largest_nm)
        left = (readings.p_M - arm.predict(readings.q, conditions=conditions)).T
        left = left + np.einsum("cjn,nj->cn", J, _by_accepted_laws(arm, context))
        A, y, free = _rows(J[:, joint] * offsets), left.ravel(), _rows(G)
        basis, sizes, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)
        basis = basis[:, sizes > _DEPENDENT * sizes[0]]
        A, y = A - basis @ (basis.T @ A), y - basis @ (basis.T @ y)
        variance = arm.posterior.noise_m**2
        return cls(*_averaged(A.T @ A / variance, A.T @ y / variance, joint, kind), largest_nm)


def payload_covariance(
    arm: ArmModel,
    q: Array,
    conditions: MeasurementConditions,
    near: MeasurementConditions,
    open_: OpenElasticity | None,
) -> Array:
    """Return the covariance (n, 3, 3) [m^2] at ``q`` (n, N) [rad] for ``conditions`` whose payload was not measured.

    ``near`` has the nearest measured payload. If both have a measured orientation, it is that of the rotation [rad^2].
    """
    if open_ is None or near is conditions:
        return np.zeros((len(q), 3, 3))
    asked, known = (arm.context(q, conditions=one) for one in (conditions, near))
    joint, _, offsets = _columns(asked, open_.largest_nm)
    more = offsets - _columns(known, open_.largest_nm)[2]
    _, J = joint_jacobian(arm.geometry, JointAngles.of(q, conditions.R_M_S))
    moved = (J[:, joint] * more).transpose(2, 0, 1)
    C = moved @ open_.covariance @ moved.transpose(0, 2, 1)
    accepted = _by_accepted_laws(arm, asked) - _by_accepted_laws(arm, known)
    d = moved @ open_.values - np.einsum("cjn,nj->nc", J, accepted)
    return np.asarray(C + d[:, :, None] * d[:, None])


def _columns(context: EffectContext, largest_nm: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return each parameter's joint (p,), kind (p,) (0 compliance, 1 bend of the law, 2 mass) and offsets (p, n)."""
    torque, N = context.torques.T, context.joints
    clipped = [np.clip(torque, -share * largest_nm[:, None], share * largest_nm[:, None]) for share in (*_KNEES, 1.0)]
    bodies = [(j, context.loads.torques_of(i)[:, j]) for i in range(N) for j in range(i + 1)]
    straight = [torque, *clipped[:-1], _BEYOND * (torque - clipped[-1])]
    joint = np.concatenate([np.tile(np.arange(N), len(straight)), [j for j, _ in bodies]]).astype(np.intp)
    kind = np.repeat([0, 1, 2], [N, N * (len(straight) - 1), len(bodies)])
    return joint, kind, np.concatenate([*straight, np.array([one for _, one in bodies])])


def _averaged(gram: Array, moment: Array, joint: NDArray[np.intp], kind: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return mean and covariance of the parameters over all values of r, weighted by their evidence."""
    first = kind == 0
    of_joint = np.linalg.inv(gram[np.ix_(first, first)] + np.eye(int(first.sum())) / _COMPLIANCE**2)
    size = np.sqrt(np.diag(of_joint) + (of_joint @ moment[first]) ** 2)
    logs, means, covariances = [], [], []
    for bent in _BENT:
        sd = np.select([first, kind == 1], [_COMPLIANCE, bent * size[joint]], _OF_MASSES * size[joint])
        inner = sd[:, None] * gram * sd + np.eye(len(sd))
        covariances.append(sd[:, None] * np.linalg.inv(inner) * sd)
        means.append(covariances[-1] @ moment)
        logs.append(0.5 * float(moment @ means[-1]) - 0.5 * float(np.linalg.slogdet(inner)[1]))
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    off = np.array(means) - mean
    return mean, np.einsum("g,gab->ab", weights, np.array(covariances)) + (weights * off.T) @ off


def _by_accepted_laws(arm: ArmModel, context: EffectContext) -> Array:
    """Return joint offsets (n, N) [rad] by the elastic joints of the model."""
    elastic = [term for term in arm.effects if term.slug in _ELASTIC]
    return displacement(elastic, EFFECTS, context).joints


def _rows(columns: Array) -> Array:
    """Reshape derivatives (3, k, n) into one column per parameter: (3 n, k)."""
    return np.asarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]))
