"""Uncertainty of the flange's orientation at a command, if readings of the arm had orientations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.targets.other_payload import payload_covariance
from cellapp.cell.targets.prediction import AT_ONCE
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import PredictedTurn
from cellapp.cell.targets.sides import from_home
from cellapp.cell.targets.tolerance import length_bounds, predicted_verdict
from cellapp.cell.targets.unknown_conditions import unknown_conditions
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, rotation_vectors
from cellapp.robot.model import ArmModel
from cellapp.robot.model.posterior import PosteriorDraws


def predicted_turns(
    arm: ArmModel,
    q: Array,
    q_nominal: Array,
    conditions: MeasurementConditions,
    nominal_M: Array,
    tolerances_mrad: Sequence[float | None],
    home: Array,
    ranges: ConditionRanges,
) -> list[PredictedTurn | None]:
    """Return predictions for n commands ``q`` (n, N) [rad]; None for all if the model has no orientation noise.

    ``q_nominal`` (n, N) are the commands of the published geometry, ``nominal_M`` (n, 3, 3) the flange rotations of the
    targets in the tracker frame with the nominal base, NaN if any will do. The other arguments are as in
    ``prediction.predictions``.
    """
    if arm.posterior is None or arm.posterior.noise_rad is None:
        return [None] * len(q)
    found: list[PredictedTurn | None] = []
    for begin in range(0, len(q), AT_ONCE):
        rows = np.arange(begin, min(begin + AT_ONCE, len(q)))
        here, stated = q[rows], conditions.take(rows)
        came = from_home(stated, here, home)
        turned = arm.orientation(here, came)
        model = _covariance(arm, here, replace(came, R_M_S=turned), ranges)
        unknown = unknown_conditions(arm, here, replace(stated, R_M_S=turned), ranges)
        true = model + sum((one.covariance for one in unknown), np.zeros_like(model))
        off = _off_mrad(arm, q_nominal[rows], stated, nominal_M[rows])
        measured = _with_noise(true, arm.posterior)
        found += _judged(model, true, measured, arm.posterior.noise_rad, off, tolerances_mrad[begin : begin + AT_ONCE])
    return found


def _covariance(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> Array:
    """Return covariances (n, 3, 3) [rad^2] of orientations at ``q`` (n, N) [rad] from a model's posterior draws."""
    assert arm.posterior is not None
    near = ranges.nearest_loaded(arm, q, conditions)
    moved = arm.posterior.displacements(arm.geometry, arm.effects, arm.context(q, conditions=near))
    covariance = np.einsum("sna,snb->nab", moved, moved, optimize=True) / len(moved)
    return np.asarray(covariance + payload_covariance(arm, q, conditions, near, ranges.elasticity))


def _off_mrad(arm: ArmModel, q: Array, conditions: MeasurementConditions, wanted_M: Array) -> list[float | None]:
    """Return the angles [mrad] between the model's flange rotations and the n wanted ones; None if any will do."""
    free = np.isnan(wanted_M[:, 0, 0])
    wanted = np.where(free[:, None, None], np.eye(3), wanted_M)
    off = np.linalg.norm(rotation_vectors(arm.flange(q, conditions)[0] @ wanted.swapaxes(1, 2)), axis=1) * 1e3
    return [None if any_will_do else angle for any_will_do, angle in zip(free.tolist(), off.tolist(), strict=True)]


def _with_noise(true: Array, posterior: PosteriorDraws) -> Array:
    """Return covariances (n, 3, 3) [rad^2] of measured orientations: those of the ``true`` ones plus noise.

    With several SMRs the axes of the noise depend on the viewing direction. They are assumed along the principal axes
    of ``true``, largest with largest, which gives the widest bound.
    """
    assert posterior.noise_rad is not None
    if posterior.noise_axes_rad is None:
        return np.asarray(true + posterior.noise_rad**2 * np.eye(3))
    values, vectors = np.linalg.eigh(true)
    return np.asarray(np.einsum("nab,nb,ncb->nac", vectors, values + posterior.noise_axes_rad**2, vectors))


def _judged(
    model: Array,
    true: Array,
    measured: Array,
    noise_rad: float,
    off_mrad: Sequence[float | None],
    tolerances: Sequence[float | None],
) -> list[PredictedTurn | None]:
    """Return predictions from covariances (n, 3, 3) [rad^2]: of the model, with unknown conditions, and measured."""
    low, high = length_bounds(true)[0] * 1e3, length_bounds(measured)[1] * 1e3
    return [
        PredictedTurn(
            nominal_mrad=off,
            uncertainty_mrad=_component_mrad(measured[k]),
            model_mrad=_component_mrad(model[k]),
            noise_mrad=noise_rad * 1e3,
            within_mrad=float(high[k]),
            verdict=predicted_verdict(float(low[k]), float(high[k]), None if off is None else tolerance),
        )
        for k, (off, tolerance) in enumerate(zip(off_mrad, tolerances, strict=True))
    ]


def _component_mrad(covariance: Array) -> float:
    """Return the root mean square standard deviation [mrad] of a component from a covariance (3, 3) [rad^2]."""
    return float(np.sqrt(np.trace(covariance) / 3.0) * 1e3)
