"""How certain the orientation of the flange at a command is, where readings of the arm had orientations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

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


def predicted_turns(
    arm: ArmModel,
    q: Array,
    q_nominal: Array,
    conditions: MeasurementConditions,
    wanted_M: Array,
    nominal_M: Array,
    tolerances_mrad: Sequence[float | None],
    home: Array,
    ranges: ConditionRanges,
) -> list[PredictedTurn | None]:
    """Predictions for n commands ``q`` (n, N) [rad]; None for all where the model knows nothing of orientations.

    ``q_nominal`` (n, N) are the commands of the published geometry, ``wanted_M`` (n, 3, 3) the flange rotations of the
    targets in the tracker frame by the calibrated base and ``nominal_M`` by the nominal one, NaN where any will do. The
    other arguments are as in ``prediction.predictions``.
    """
    if not len(q) or arm.posterior is None or arm.posterior.noise_rad is None:
        return [None] * len(q)
    if len(q) > AT_ONCE:
        parts = [slice(begin, begin + AT_ONCE) for begin in range(0, len(q), AT_ONCE)]
        return [
            one
            for part in parts
            for one in predicted_turns(
                arm,
                q[part],
                q_nominal[part],
                conditions.take(np.arange(len(q))[part]),
                wanted_M[part],
                nominal_M[part],
                tolerances_mrad[part],
                home,
                ranges,
            )
        ]
    came = from_home(conditions, q, home)
    here = replace(came, R_M_S=arm.orientation(q, came))
    model = _covariance(arm, q, here)
    if ranges.compliance is not None:
        measured_kg = ranges.payload_kg or (arm.bodies.payload_mass, arm.bodies.payload_mass)
        model = model + payload_covariance(arm, q, here, measured_kg, ranges.compliance)
    unknown = unknown_conditions(arm, q, replace(conditions, R_M_S=here.R_M_S), ranges)
    true = model + sum((one.covariance for one in unknown), np.zeros_like(model))
    measured = true + arm.posterior.noise_rad**2 * np.eye(3)
    low, high = length_bounds(true)[0] * 1e3, length_bounds(measured)[1] * 1e3
    free: NDArray[np.bool_] = np.isnan(wanted_M[:, 0, 0])
    return [
        PredictedTurn(
            nominal_mrad=None if free[k] else float(angle),
            uncertainty_mrad=_component_mrad(measured[k]),
            model_mrad=_component_mrad(model[k]),
            noise_mrad=arm.posterior.noise_rad * 1e3,
            within_mrad=float(high[k]),
            verdict=predicted_verdict(float(low[k]), float(high[k]), None if free[k] else tolerance),
        )
        for k, (angle, tolerance) in enumerate(
            zip(_off_mrad(arm, q_nominal, conditions, nominal_M, free), tolerances_mrad, strict=True)
        )
    ]


def _covariance(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Array:
    """Covariances (n, 3, 3) [rad^2] of the orientations that a model with draws predicts at ``q`` (n, N) [rad]."""
    assert arm.posterior is not None
    moved = arm.posterior.displacements(arm.geometry, arm.effects, arm.context(q, conditions=conditions))
    return np.asarray(np.einsum("sna,snb->nab", moved, moved, optimize=True) / len(moved))


def _off_mrad(
    arm: ArmModel, q: Array, conditions: MeasurementConditions, wanted_M: Array, free: NDArray[np.bool_]
) -> Array:
    """Angles (n,) [mrad] by which the model has the flange off the wanted rotation; zero where any is wanted."""
    wanted = np.where(free[:, None, None], np.eye(3), wanted_M)
    off = rotation_vectors(arm.flange(q, conditions)[0] @ wanted.swapaxes(1, 2))
    return np.where(free, 0.0, np.linalg.norm(off, axis=1) * 1e3)


def _component_mrad(covariance: Array) -> float:
    """Root mean square standard deviation [mrad] of a component, of a covariance (3, 3) [rad^2]."""
    return float(np.sqrt(np.trace(covariance) / 3.0) * 1e3)
