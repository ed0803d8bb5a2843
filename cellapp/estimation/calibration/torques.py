"""Estimation of masses from measured joint torques or motor currents, for the torques that drive elasticity.

A drive at rest holds its joint against gravity. At joint j of a reading it measures

    y_j = (g_j(q, payload) + f_j d_j) / k_j + o_j + noise,

with the torque g_j that holds gravity, dry friction f_j against the direction d_j of the last motion, an offset o_j,
and the motor constant k_j [Nm/A], 1 for torques. g_j is linear in mass and first moment of every body and of the known
payload (Atkeson, An, Hollerbach, Int. J. Robotics Research 5 (1986) 101). Stated masses are the prior mean. Unknown
masses start at zero: then only the payload gives currents a scale.

Single measured torques contain friction and noise, and there are none at new configurations. The masses from all rows
give the torque at every configuration and payload. They replace the stated ones if they predict held-out torques better
and if SMR positions, through elastic joints, show that their torques explain the elasticity better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.chain import JointAngles, frame_poses, jacobian, joint_jacobian
from cellapp.robot.kinematics.statics import STANDARD_GRAVITY, Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

Kind = Literal["tau", "current"]

_FEWEST = 12
"""Least number of readings with torques from which masses are estimated."""
_MASS_SHARE, _MASS_SD = 0.3, 0.5
"""Prior standard deviation of a stated mass: a share of it, and at least this [kg]."""
_UNKNOWN_KG = 10.0
"""Prior standard deviation of a mass that is not stated [kg]."""
_CENTER_SD = 0.1
"""Prior standard deviation of a centre of mass along each axis of its frame [m]."""
_ROUNDS = 2000
"""Most rounds of joints and masses, each fitted beside the other: twenty to three hundred are usual."""
_SETTLED = 1e-3
"""Change of a torque in the last round, as a share of its joint's scatter."""
_STILL_NM = 1.0
"""Range of a joint's torque below which neither its motor constant nor its sign is determined [Nm]."""
_ALIKE = 0.6
"""Correlation with the stated masses' torque from which a joint's sign and unit are judged."""
_UNIT = 30.0
"""Ratio to the stated masses' torque from which the unit must be wrong."""
_GROSS = 8.0
"""Residual in standard deviations from which the torque of one row is a gross error."""
_SURE = 3.0
"""Log likelihood by which masses from torques must explain positions better than the stated ones."""
_MUCH = 0.5
"""Share of the stated masses' held-out error below which torques suffice if positions do not clearly contradict."""
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class JointTorque:
    """Torque parameters of one joint.

    Attributes
    ----------
    constant, constant_standard_error : float or None
        Motor constant [Nm/A]; None for torques, and for a joint whose torque does not vary.
    friction, offset, scatter : float
        Dry friction, offset and standard deviation of the residual, in Nm or A.
    fault : str
        Why this joint is not used; empty if it is used.
    """

    joint: int
    constant: float | None
    constant_standard_error: float | None
    friction: float
    offset: float
    scatter: float
    fault: str = ""


@dataclass(frozen=True)
class TorqueFit:
    """Masses from torques or currents.

    Attributes
    ----------
    kind : str
    readings : int
        Number of rows that were fitted.
    bodies : Bodies
        Bodies with the estimated masses; those of the model if ``used``.
    joints : tuple of JointTorque
    held_out : tuple of two floats
        Rms error of held-out rows with the stated masses and with the estimated ones [Nm].
    evidence : float
        Log likelihood of the positions with elastic joints under the estimated masses less that under the stated ones.
    used : bool
    faults : tuple of str
        One sentence for each row that was left out.
    """

    kind: Kind
    readings: int
    bodies: Bodies
    joints: tuple[JointTorque, ...]
    held_out: tuple[float, float]
    evidence: float
    used: bool
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Measured values (n, N), directions of the last motion (n, N), the regressor (n, N, 4 N) of the drives' torques
    [Nm] by mass [kg] and first moment [kg m] of each body, and the torques (n, N) [Nm] of the payload."""

    measured: Array
    direction: Array
    regressor: Array
    payload: Array

    def torques(self, parameters: Array) -> Array:
        """Compute the torques of the drives (n, N) [Nm]."""
        return np.asarray(self.regressor @ parameters + self.payload)

    def take(self, rows: NDArray[np.bool_]) -> _Rows:
        return _Rows(self.measured[rows], self.direction[rows], self.regressor[rows], self.payload[rows])


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters (4 N,); for each joint slope 1 / k, friction and offset (3, N), the slope's standard error (N,) and
    the scatter (N,)."""

    parameters: Array
    joint: Array
    slope_error: Array
    scatter: Array

    def residuals(self, rows: _Rows) -> Array:
        slope, friction, offset = self.joint
        return np.asarray(rows.measured - slope * rows.torques(self.parameters) - friction * rows.direction - offset)


def has_torques(readings: Readings) -> bool:
    """Return whether enough readings have torques or currents."""
    _, measured = _measured(readings)
    return measured is not None and int(np.isfinite(measured).all(axis=1).sum()) >= _FEWEST


def _measured(readings: Readings) -> tuple[Kind, Array | None]:
    """Return the torques (n, N) [Nm] of readings, else their currents [A], with the kind; None if there are neither."""
    return ("current", readings.current_a) if readings.tau_nm is None else ("tau", readings.tau_nm)


def fit_torques(arm: ArmModel, readings: Readings) -> TorqueFit:
    """Estimate masses from the torques of readings, else from their currents; ``has_torques`` must hold.

    ``arm`` has the identified geometry and the stated masses. Rows of the split ``validate`` are held out.
    """
    kind, measured = _measured(readings)
    assert measured is not None
    known = np.isfinite(measured).all(axis=1)
    readings, measured = readings.take(np.flatnonzero(known)), measured[known]
    rows = _rows(arm, readings, measured)
    held_out = np.zeros(len(readings), dtype=bool)
    held_out[readings.in_split("validate")] = True
    if held_out.sum() < 3 or (~held_out).sum() < _FEWEST:
        held_out = np.arange(len(readings)) % 5 == 0
    stated = np.column_stack([arm.bodies.masses, arm.bodies.masses[:, None] * arm.bodies.centers]).ravel()
    faults = _joint_faults(rows, stated, kind)
    usable = np.array([not fault for fault in faults])
    wrong = np.zeros(len(readings), dtype=bool)
    for _ in range(2):
        fit = _fitted(rows.take(~held_out & ~wrong), stated, usable, kind)
        far = np.abs(fit.residuals(rows)) > _GROSS * fit.scatter
        wrong = np.asarray(np.any(far[:, usable], axis=1))
    bodies = _bodies(arm.bodies, fit.parameters)
    before = _fitted(rows.take(~held_out & ~wrong), stated, usable, kind, free=False)
    stated_nm, found_nm = (_rms_nm(one, rows.take(held_out & ~wrong), usable) for one in (before, fit))
    evidence = _evidence(arm, bodies, readings)
    joints = tuple(_joint(fit, j, kind, fault) for j, fault in enumerate(faults))
    return TorqueFit(
        kind=kind,
        readings=int((~held_out & ~wrong).sum()),
        bodies=bodies,
        joints=joints,
        held_out=(stated_nm, found_nm),
        evidence=evidence,
        used=bool(usable.any()) and _better(stated_nm, found_nm, evidence),
        faults=_row_faults(fit, rows, readings, wrong, usable, kind),
    )


def _better(stated_nm: float, found_nm: float, evidence: float) -> bool:
    """Return whether the estimated masses are better: by positions, or by torques that positions do not contradict."""
    return (found_nm < stated_nm and evidence > _SURE) or (found_nm < _MUCH * stated_nm and evidence > -_SURE)


def _rows(arm: ArmModel, readings: Readings, measured: Array) -> _Rows:
    """Build the linear model at the readings. Drives hold against gravity: their torques are the negative of its."""
    frames = frame_poses(arm.geometry, readings.q)
    rotations, origins = frames
    joints, n = arm.geometry.joints, len(readings)
    gravity = -STANDARD_GRAVITY * arm.up_M
    axes = rotations[:-1, :, :, 2]
    turn = np.cross(gravity, axes)  # (N, n, 3): torque about axis j per kg and metre of lever
    regressor = np.zeros((n, joints, joints, 4))
    for body in range(joints):
        for joint in range(body + 1):
            lever = origins[body + 1] - origins[joint]
            regressor[:, joint, body, 0] = -np.einsum("na,na->n", turn[joint], lever)
            regressor[:, joint, body, 1:] = -np.einsum("na,nab->nb", turn[joint], rotations[body + 1])
    no_bodies = replace(arm.bodies, masses=np.zeros(joints))
    loads = gravity_loads(frames, no_bodies, arm.up_M, readings.payload_kg, readings.payload_center_F)
    payload = -loads.joint_torques()
    direction = readings.approach.astype(np.float64)
    return _Rows(measured, direction, regressor.reshape(n, joints, 4 * joints), payload)


def _bodies(stated: Bodies, parameters: Array) -> Bodies:
    """Return bodies with the masses and first moments of ``parameters``; a mass near zero keeps its first moment."""
    table = parameters.reshape(-1, 4)
    masses = np.where(np.abs(table[:, 0]) < 1e-3, 1e-3, table[:, 0])
    return replace(stated, masses=masses, centers=table[:, 1:] / masses[:, None])


def _prior_sd(stated: Array) -> Array:
    """Return prior standard deviations (4 N,) of the parameters."""
    masses = stated.reshape(-1, 4)[:, 0]
    if not masses.any():
        mass_sd = np.full(len(masses), _UNKNOWN_KG)
        moment_sd = mass_sd * 3.0 * _CENTER_SD
    else:
        mass_sd = np.maximum(_MASS_SHARE * masses, _MASS_SD)
        moment_sd = np.maximum(masses, _MASS_SD) * _CENTER_SD
    return np.column_stack([mass_sd, *(moment_sd,) * 3]).ravel()


def _fitted(rows: _Rows, stated: Array, usable: NDArray[np.bool_], kind: Kind, *, free: bool = True) -> _Fit:
    """Fit joints and masses alternately, each by least squares; if ``free`` is False the masses stay as stated.

    Raise ``NotConverged`` if they do not settle.
    """
    parameters, sd = stated.copy(), _prior_sd(stated)
    n, joints = rows.measured.shape
    if kind == "current" and free:
        parameters = _start_of_currents(rows, stated)
    for _ in range(_ROUNDS):
        torques = rows.torques(parameters)
        joint, slope_error, scatter = _joints_fitted(rows, torques, kind)
        if not free or not usable.any():
            break
        slope, friction, offset = joint
        weight = np.where(usable, 1.0 / np.maximum(scatter, 1e-9), 0.0)
        left = (rows.measured - friction * rows.direction - offset - slope * rows.payload) * weight
        A = (rows.regressor * (slope * weight)[:, None]).reshape(n * joints, -1)
        normal = A.T @ A + np.diag(sd**-2.0)
        parameters = np.linalg.solve(normal, A.T @ left.ravel() + stated / sd**2)
        if np.max(np.abs(rows.torques(parameters) - torques) * slope / scatter) < _SETTLED:
            break
    else:
        raise NotConverged.of("fit of masses to torques", f"{_ROUNDS} rounds were not enough")
    return _Fit(parameters, joint, slope_error, scatter)


def _start_of_currents(rows: _Rows, stated: Array) -> Array:
    """Estimate initial parameters from currents and payload: ``k_j y_j - payload_j = Y_j p + f_j d + o_j`` is linear.

    It neglects that the noise is in the currents, not in the torques, which is a small error; the iteration does not.
    """
    n, joints = rows.measured.shape
    by_joint = np.zeros((n, joints, 3, joints))
    for j in range(joints):
        by_joint[:, j, :, j] = np.column_stack([-rows.measured[:, j], rows.direction[:, j], np.ones(n)])
    A = np.concatenate([rows.regressor, by_joint.reshape(n, joints, 3 * joints)], axis=2).reshape(n * joints, -1)
    noise = max(0.02 * float(np.ptp(rows.torques(stated))), 0.5)
    precision = np.concatenate([_prior_sd(stated) ** -2.0, np.full(3 * joints, 1e-9)])
    mean = np.concatenate([stated, np.zeros(3 * joints)])
    normal = A.T @ A / noise**2 + np.diag(precision)
    right = -A.T @ rows.payload.ravel() / noise**2 + precision * mean
    return np.asarray(np.linalg.solve(normal, right)[: len(stated)])


def _joints_fitted(rows: _Rows, torques: Array, kind: Kind) -> tuple[Array, Array, Array]:
    """Fit slope, friction, offset (3, N), the slopes' standard errors (N,) and the scatter (N,), joint by joint."""
    n, joints = torques.shape
    found, errors, scatter = np.zeros((3, joints)), np.zeros(joints), np.zeros(joints)
    for j in range(joints):
        columns = [rows.direction[:, j], np.ones(n)]
        known = torques[:, j]
        with_slope = kind == "current" and np.ptp(known) > _STILL_NM
        if with_slope:
            columns.insert(0, known)
        left = rows.measured[:, j] - (0.0 if with_slope or kind == "current" else known)
        A = np.column_stack(columns)
        values, *_ = np.linalg.lstsq(A, left, rcond=None)
        scatter[j] = max(float(np.median(np.abs(left - A @ values))) * 1.4826, 1e-6)
        if with_slope:
            errors[j] = scatter[j] * math.sqrt(float(np.linalg.pinv(A.T @ A)[0, 0]))
            found[:, j] = values
        else:
            found[:, j] = (0.0 if kind == "current" else 1.0, *values)
    return found, errors, scatter


def _joint_faults(rows: _Rows, stated: Array, kind: Kind) -> list[str]:
    """Say for each joint what is wrong with all its torques, compared with the stated masses; empty if nothing is."""
    expected = rows.torques(stated)
    faults = []
    for j in range(expected.shape[1]):
        mine, theirs = rows.measured[:, j], expected[:, j]
        fault = ""
        if kind == "tau" and np.ptp(theirs) > _STILL_NM and np.ptp(mine) > 0.0:
            likeness = float(np.corrcoef(mine, theirs)[0, 1])
            ratio = float(np.std(mine) / np.std(theirs))
            if abs(likeness) > _ALIKE and not 1.0 / _UNIT < ratio < _UNIT:
                fault = f"its torques are {ratio:.3g} times those of the stated masses: are they in Nm, at the joint?"
            elif likeness < -_ALIKE:
                fault = "its torques have the opposite sign: a drive that holds a link up has a torque against gravity"
        faults.append(fault)
    return faults


def _row_faults(
    fit: _Fit, rows: _Rows, readings: Readings, wrong: NDArray[np.bool_], usable: NDArray[np.bool_], kind: Kind
) -> tuple[str, ...]:
    """Return a sentence for each row that was left out."""
    left, said = fit.residuals(rows), []
    unit = "Nm" if kind == "tau" else "A"
    turned = replace(rows, measured=-rows.measured)
    with_other_sign = np.abs(fit.residuals(turned)) < 0.2 * np.abs(left)
    for row in np.flatnonzero(wrong).tolist():
        joint = int(np.argmax(np.where(usable, np.abs(left[row]) / fit.scatter, 0.0)))
        got = rows.measured[row, joint]
        expected = got - left[row, joint]
        why = "; with the opposite sign it fits" if with_other_sign[row, joint] else ""
        said.append(
            f"configuration {int(readings.configuration[row])}: {kind}{joint + 1} is {got:.3g} {unit}, expected"
            f" {expected:.3g} {unit}{why}"
        )
    return tuple(said)


def _joint(fit: _Fit, j: int, kind: Kind, fault: str) -> JointTorque:
    slope, friction, offset = fit.joint[:, j].tolist()
    constant = error = None
    if kind == "current" and slope != 0.0:
        constant = 1.0 / slope
        error = float(fit.slope_error[j]) / slope**2
    return JointTorque(j + 1, constant, error, friction, offset, float(fit.scatter[j]), fault)


def _rms_nm(fit: _Fit, rows: _Rows, usable: NDArray[np.bool_]) -> float:
    """Compute the rms error [Nm] of joints that are used and have a motor constant."""
    slope = fit.joint[0]
    chosen = usable & (slope != 0.0)
    if not chosen.any() or not len(rows.measured):
        return math.nan
    return float(np.sqrt(np.mean((fit.residuals(rows)[:, chosen] / slope[chosen]) ** 2)))


def _evidence(arm: ArmModel, found: Bodies, readings: Readings) -> float:
    """Compute the log likelihood of positions with one compliance per joint: estimated masses less stated ones.

    Both models have the same number of parameters. The geometry is free too, and so are the most frequent other errors
    of joints: one cycle a turn, and lost motion.
    """
    readings = readings.take(np.flatnonzero(np.isfinite(readings.p_M).all(axis=1)))
    learnt = np.concatenate([readings.in_split("identify"), readings.in_split("train")])
    readings = readings.take(learnt) if len(learnt) > 3 * arm.geometry.joints else readings
    conditions, angles = measurement_conditions(readings), JointAngles.of(readings.q)
    _, J = joint_jacobian(arm.geometry, angles)
    _, G = jacobian(arm.geometry, angles, tuple(range(len(arm.geometry.vector()))))
    residual = (readings.p_M - replace(arm, effects=(), network=None).predict(readings.q)).T.ravel()
    own = np.stack([np.cos(readings.q), np.sin(readings.q), readings.approach.astype(np.float64)])
    free = np.column_stack([_columns(G), *(_columns(J * one.T[None]) for one in own)])
    left, sizes, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)
    basis = left[:, sizes > _DEPENDENT * sizes[0]]
    squares = []
    for bodies in (arm.bodies, found):
        torques = replace(arm, bodies=bodies).context(readings.q, conditions=conditions).torques
        A = np.column_stack([basis, _columns(J * torques.T[None])])
        values, *_ = np.linalg.lstsq(A, residual, rcond=1e-10)
        squares.append(float(np.sum((residual - A @ values) ** 2)))
    return 0.5 * len(residual) * math.log(max(squares[0], 1e-300) / max(squares[1], 1e-300))


def _columns(columns: Array) -> Array:
    """Reshape derivatives (3, k, n) to one column for each parameter: (3 n, k)."""
    return np.asarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]))
