"""Size of a hidden effect: the part that geometry cannot absorb, and the part that the library's laws cannot."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.parameters import auto_set
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.effects import EFFECTS, EffectColumn, Law, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, joint_jacobian, parameter_names
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm, up_in_tracker

_ROUNDING = 1e-9
"""Singular values below this share of the largest one are rounding errors."""
_MOST_COLUMNS = 80
"""Laws with more columns are not compared: they absorb anything (all lines of a spectrum, free curves)."""
_TUNING_ROUNDS = 6
"""Rounds that tune the constants of the best law, each with half the step."""


def beyond_geometry(arm: Arm, q: Array, p_M: Array, moved: Array) -> Array:
    """Return the part of displacements ``moved`` (n, 3) [m] that the identifiable geometry cannot absorb.

    ``q`` (n, N) [rad] are the stops, ``p_M`` (n, 3) [m] the SMR positions without the effect. The nominal arm,
    registered to the tracker, is linearized; the part is orthogonal to the columns of its Jacobian.
    """
    nominal = _registered(arm, q, p_M)
    columns = auto_set(nominal, q).columns
    _, J = jacobian(nominal, JointAngles.of(q), columns)
    basis, _ = np.linalg.qr(J.transpose(0, 2, 1).reshape(-1, len(columns)))
    y = moved.T.ravel()
    return np.asarray((y - basis @ (basis.T @ y)).reshape(3, -1).T)


def registered_model(profile: Profile, name: str, q: Array, p_M: Array) -> ArmModel:
    """Return an arm's nominal model, its base registered to SMR positions ``p_M`` (n, 3) [m] at ``q`` (n, N)."""
    arm = profile.arms[name]
    geometry = _registered(arm, q, p_M)
    return ArmModel(geometry, geometry, bodies_of(arm), up_in_tracker(profile), smr_normal=np.array(arm.smr.normal))


def beyond_law(model: ArmModel, slug: str, q: Array, conditions: MeasurementConditions, moved: Array) -> Array | None:
    """Return the part of displacements ``moved`` (n, 3) [m] that geometry with the best law of an effect cannot absorb.

    ``q`` (n, N) [rad] are the stops and ``conditions`` their measurement conditions. All parameters are free. None if
    the library has no law with few columns for these data.
    """
    effect = EFFECTS.get(slug)
    context = model.context(q, conditions=conditions)
    if effect is None or effect.missing_data(context):
        return None
    geometry = model.geometry
    _, J = jacobian(geometry, JointAngles.of(q), tuple(range(len(parameter_names(geometry.joints)))))
    _, by_joint = joint_jacobian(geometry, JointAngles.of(q))
    geometric = J.transpose(1, 0, 2).reshape(J.shape[1], -1)
    y = moved.T.ravel()

    def left_by(law: Law) -> Array | None:
        columns = effect.columns(context, law)
        if not columns or len(columns) > _MOST_COLUMNS:
            return None
        return _left(np.concatenate([geometric, _rows(columns, by_joint)]), y)

    best: tuple[float, Array, Law] | None = None
    laws = effect.laws(context)
    for round_ in range(_TUNING_ROUNDS + 1):
        for law in laws:
            left = left_by(law)
            if left is not None and (best is None or left @ left < best[0]):
                best = float(left @ left), left, law
        if best is None:
            return None
        laws = best[2].nearby(context, 0.5**round_)
    return None if best is None else np.asarray(best[1].reshape(3, -1).T)


def _registered(arm: Arm, q: Array, p_M: Array) -> Geometry:
    return start_from_nominal(nominal_arm(arm), q, p_M, tool_unknown=arm.smr.offset == "unknown")


def _rows(columns: list[EffectColumn], by_joint: Array) -> Array:
    """Stack the displacements (m, 3 n) of columns; ``by_joint`` (3, N, n) are displacements per radian of a joint."""
    rows = []
    for column in columns:
        if column.shift_M is not None:
            rows.append(column.shift_M.T.ravel())
        else:
            assert column.offset is not None
            rows.append((by_joint[:, column.joint] * column.offset).ravel())
    return np.array(rows)


def _left(rows: Array, y: Array) -> Array:
    """Return the part of ``y`` (k,) orthogonal to ``rows`` (m, k), whose scale does not matter."""
    lengths = np.linalg.norm(rows, axis=1)
    rows = rows[lengths > 0.0] / lengths[lengths > 0.0, None]
    gram = rows @ rows.T
    values, vectors = np.linalg.eigh(gram)
    kept = values > _ROUNDING * values[-1]
    basis = (vectors[:, kept] / np.sqrt(values[kept])).T @ rows
    return np.asarray(y - basis.T @ (basis @ y))
