"""Express a calibrated cell in the tracker frame of a new station, after the tracker was moved.

Geometry, effects and networks of the arms stay; their bases and the direction of gravity are expressed in the new
tracker frame. The uncertainty of the new station is the same for all arms: it is added to the draws of each arm's base.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.robot.kinematics.chain import BASE_NAMES, base_twists
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import ArmModel, CellModel
from cellapp.robot.model.posterior import PosteriorDraws

_BASE = tuple(range(len(BASE_NAMES)))


def relocated(model: CellModel, T_new_old: Array, twists: Array | None = None) -> CellModel:
    """Return the cell in the new tracker frame; ``T_new_old`` (4, 4) maps coordinates of the old frame into the new.

    ``twists`` (S, 6) are draws of the error of ``T_new_old``, one per draw of the arms' posteriors: shift of the point
    at the new origin [m], then rotation [rad], both in the new frame. Arms without draws get none.
    """
    station = T_new_old if model.T_M_M0 is None else T_new_old @ model.T_M_M0
    arms = {name: _relocated_arm(arm, T_new_old, twists) for name, arm in model.arms.items()}
    return replace(model, arms=arms, T_M_M0=station)


def _relocated_arm(arm: ArmModel, T: Array, twists: Array | None) -> ArmModel:
    geometry = arm.geometry.with_T_M_B(T @ arm.geometry.T_M_B())
    to_parameters: Array = np.asarray(np.linalg.inv(base_twists(geometry)), dtype=np.float64)
    base_map = to_parameters @ _adjoint(T) @ base_twists(arm.geometry)
    added = None if twists is None else twists @ to_parameters.T
    return replace(
        arm,
        geometry=geometry,
        nominal=arm.nominal.with_T_M_B(T @ arm.nominal.T_M_B()),
        up_M=T[:3, :3] @ arm.up_M,
        covariance=_relocated_covariance(arm, base_map, added),
        posterior=None if arm.posterior is None else _relocated_draws(arm.posterior, base_map, added),
    )


def _relocated_covariance(arm: ArmModel, base_map: Array, added: Array | None) -> Array | None:
    """Transform the covariance of the identified parameters; None if the base was not identified completely.

    The station's part is added as uncorrelated; only the draws keep its correlation with the arm's own parameters.
    """
    if arm.covariance is None or not set(BASE_NAMES) <= set(arm.identified):
        return None
    rows = [arm.identified.index(name) for name in BASE_NAMES]
    whole = np.eye(len(arm.covariance))
    whole[np.ix_(rows, rows)] = base_map
    covariance = whole @ arm.covariance @ whole.T
    if added is not None:
        covariance[np.ix_(rows, rows)] += added.T @ added / len(added)
    return np.asarray(covariance)


def _relocated_draws(posterior: PosteriorDraws, base_map: Array, added: Array | None) -> PosteriorDraws:
    columns = (*_BASE, *(column for column in posterior.columns if column not in _BASE))
    drawn = dict(zip(posterior.columns, posterior.geometry.T, strict=True))
    none = np.zeros(len(posterior.geometry))
    base = np.stack([drawn.get(column, none) for column in _BASE], axis=1) @ base_map.T
    if added is not None:
        base = base + added
    others = [drawn[column][:, None] for column in columns[len(_BASE) :]]
    return replace(posterior, columns=columns, geometry=np.concatenate([base, *others], axis=1))


def _adjoint(T: Array) -> Array:
    """Return the matrix (6, 6) that maps a twist (v, w) into another frame; v is the velocity at the frame's origin."""
    rotation, (x, y, z) = T[:3, :3], T[:3, 3].tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    whole = np.zeros((6, 6))
    whole[:3, :3] = whole[3:, 3:] = rotation
    whole[:3, 3:] = cross @ rotation
    return whole
