"""Decide which changes are visible, from the SMR's motion by one step at the calibration's readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check.alternatives import Direction, centre_of
from cellapp.estimation.monitoring.check.linear import twists
from cellapp.estimation.monitoring.check.model import TRACKER, VISIBLE, ArmBelief, CheckBelief
from cellapp.estimation.prior.belief import is_smooth
from cellapp.estimation.prior.linear_model import Measured, design
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


def motions(belief: CheckBelief, name: str, measured: Measured, directions: Sequence[Direction]) -> Array:
    """Compute the motion (C, n, 3) [m, rad] of n measured vectors of an arm by one step of each direction."""
    arm = belief.arms[name]
    model, kept = _without_free_functions(arm.model, len(arm.columns))
    X = np.zeros((len(arm.covariance), len(measured), 3))
    X[kept] = design(model, measured, arm.columns).reshape(-1, 3, len(measured)).transpose(0, 2, 1)
    p_M = model.predict(measured.readings.q, conditions=measured.conditions)
    station = twists(p_M - centre_of(belief), ~measured.points).transpose(2, 0, 1)
    found = np.zeros((len(directions), len(measured), 3))
    for k, one in enumerate(directions):
        if one.arm == name:
            found[k] = one.row_of(X)
        elif one.arm == TRACKER:
            found[k] = one.row_of(station)
    return found


def _without_free_functions(model: ArmModel, geometric: int) -> tuple[ArmModel, NDArray[np.bool_]]:
    """Return the model without free functions, and the mask of the parameters that are kept.

    Free functions have hundreds of values, none of which is a direction; they turn the joints by some 0.1 mrad, which
    changes no motion by a thousandth.
    """
    kept = np.concatenate([np.full(geometric, True), *(np.full(len(t.names), not is_smooth(t)) for t in model.effects)])
    return replace(model, effects=tuple(term for term in model.effects if not is_smooth(term))), kept


def calibration_motions(belief: CheckBelief, directions: Sequence[Direction]) -> dict[str, Array]:
    """Compute ``motions`` of each arm at the readings of the calibration."""
    return {name: motions(belief, name, arm.measured, directions) for name, arm in belief.arms.items()}


def visibility(
    belief: CheckBelief, directions: Sequence[Direction], moved: Mapping[str, Array]
) -> tuple[Array, NDArray[np.bool_]]:
    """Compute the rms motion (C,) [m] of the SMR by one step of each direction, and the mask of visible ones.

    Motions are judged by the noise of a position, rotations of a probe by that of an orientation. The best-fitting
    motion of the tracker is subtracted, see ``check.model``, except from the tracker's own directions; these are not
    visible if it was set up anew. ``moved`` are the motions at the calibration's readings.
    """
    rows = np.concatenate([_as_points(arm, moved[name]) for name, arm in belief.arms.items()], axis=1)
    points = np.concatenate([np.repeat(arm.measured.points, 3) for arm in belief.arms.values()])
    own = np.array([one.arm == TRACKER for one in directions])
    basis = np.linalg.qr(rows[own].T)[0]
    left = np.where(own[:, None], rows, rows - (rows @ basis) @ basis.T)
    counts = {name: len(arm.positions) for name, arm in belief.arms.items()}
    noise = {name: arm.noise_m for name, arm in belief.arms.items()}
    counts[TRACKER], noise[TRACKER] = sum(counts.values()), max(noise.values())
    of_arm = np.array([counts[one.arm] for one in directions])
    visible = np.sqrt(np.sum(left**2, axis=1) / of_arm) >= VISIBLE * np.array([noise[one.arm] for one in directions])
    return np.sqrt(np.sum(left[:, points] ** 2, axis=1) / of_arm), visible & ~(own & belief.station_free)


def _as_points(arm: ArmBelief, moved: Array) -> Array:
    """Return motions (C, 3 n) [m] of an arm's vectors; rotations are scaled to equal standard deviations of a point."""
    scale = np.where(arm.measured.points, 1.0, arm.noise_m / max(arm.noise_rad, 1e-12))
    return np.asarray((moved * scale[:, None]).reshape(len(moved), -1))
