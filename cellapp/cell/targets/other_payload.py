"""What a payload that no reading had adds to the uncertainty: all the ways in which joints may give way.

The law of elasticity that a search accepted holds for the loads that it saw. Beyond them other laws do as well: drives
are stiffer under load, masses are not what was stated, a joint that its own weight hardly loads may give way by any
amount that such drives do. So all of these are fitted beside all geometry, to the readings as they are:

    dq_j = c_j tau_j + sum_k s_jk clip(tau_j, -T_k, T_k) + h_j (tau_j - clip(tau_j, -T, T)) + sum_i m_ji tau_ji,

tau_j being the torque about joint j, tau_ji that of body i alone, T the largest one among the readings and T_k shares
of it [Nm]. c_j has a prior as wide as such drives; m_ji is a share of the joint's compliance, s_jk a share r, h_j a
quarter of it. r is not chosen: some values count with their evidence (marginal likelihood), so that readings which show
straight laws keep straight ones likely beyond. Nothing measured says more of h_j than that.

From the nearest measured payload m' to m the SMR then moves by the mean of all this, with its covariance C; the
accepted law says another motion, and the difference d is an error that commands keep. The second moment about the
accepted law counts: C + d d^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectContext, MeasurementConditions, displacement
from cellapp.robot.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_COMPLIANCE = 1e-4
"""Prior standard deviation [rad/Nm]: strain-wave drives of this class have 1e4 to 1e5 Nm/rad (Harmonic Drive, CSG)."""
_KNEES = (0.15, 0.35, 0.65)
"""Shares of the largest torque below which a joint may be softer."""
_BENT = (0.01, 0.1, 0.5)
"""Shares r of a joint's compliance: catalogues have K3 / K1 up to 2."""
_OF_MASSES = 0.2
"""Share m: makers' masses are 10 to 30 % off. One load cannot tell a common error of masses from compliance."""
_BEYOND = 0.25
"""Share of r beyond all measured torques: drives stiffen most at first."""
_DEPENDENT = 1e-9
"""Relative singular value below which columns of the geometry are combinations of others."""
_ELASTIC = ("joint_compliance", "payload_compliance")


@dataclass(frozen=True, eq=False)
class OpenElasticity:
    """How the joints of an arm may give way, by its readings.

    Attributes
    ----------
    values : array, shape (p,)
        Mean of the parameters of ``_columns`` [rad/Nm].
    covariance : array, shape (p, p)
    largest_nm : array, shape (N,)
        Largest torque about each joint among the readings.
    """

    values: Array
    covariance: Array
    largest_nm: Array

    @classmethod
    def of(cls, arm: ArmModel, readings: Readings) -> OpenElasticity | None:
        """From readings and the model in force; None without a posterior, which has the scatter of the readings, and
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
    """Covariance (n, 3, 3) [m^2] at ``q`` (n, N) [rad] that ``conditions`` add to ``near``, whose payload was measured.

    Where both have a measured orientation, that of the rotation [rad^2].
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
    """Joint of each parameter (p,), its kind (p,): 0 compliance, 1 bend of the law, 2 mass; and offsets (p, n)."""
    torque, N = context.torques.T, context.joints
    clipped = [np.clip(torque, -share * largest_nm[:, None], share * largest_nm[:, None]) for share in (*_KNEES, 1.0)]
    bodies = [(j, context.loads.torques_of(i)[:, j]) for i in range(N) for j in range(i + 1)]
    straight = [torque, *clipped[:-1], _BEYOND * (torque - clipped[-1])]
    joint = np.concatenate([np.tile(np.arange(N), len(straight)), [j for j, _ in bodies]]).astype(np.intp)
    kind = np.repeat([0, 1, 2], [N, N * (len(straight) - 1), len(bodies)])
    return joint, kind, np.concatenate([*straight, np.array([one for _, one in bodies])])


def _averaged(gram: Array, moment: Array, joint: NDArray[np.intp], kind: NDArray[np.intp]) -> tuple[Array, Array]:
    """Mean and covariance of the parameters over all shares r, each weighed by its evidence."""
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
    """Joint offsets (n, N) [rad] by what the model has of elastic joints."""
    elastic = [term for term in arm.effects if term.slug in _ELASTIC]
    return displacement(elastic, EFFECTS, context).joints


def _rows(columns: Array) -> Array:
    """Derivatives (3, k, n) as one column a parameter: (3 n, k)."""
    return np.asarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]))
