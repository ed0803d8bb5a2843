"""How certain the SMR's position at a command is: covariance by sources, and the distance that it keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.compensation.command import Prediction
from cellapp.compensation.tolerance import length_bounds, predicted_verdict
from cellapp.effects import MeasurementConditions
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.results import UncertaintyParts

_AT_ONCE = 1000
"""Configurations at once: their draws take some tens of MB."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariances (n, 3, 3) [m^2] of the predicted SMR by sources; their sum is that of the true position.

    Geometry and effects are fitted together, and their errors oppose each other: each has its share of the covariance
    of the whole (Euler's allocation of a variance).
    """

    parameters: Array
    effects: Array
    network: Array
    extrapolation: Array
    conditions: Array

    @property
    def whole(self) -> Array:
        """Covariance of the true position."""
        return self.parameters + self.effects + self.network + self.extrapolation + self.conditions


def predictions(
    arm: ArmModel,
    q: Array,
    conditions: MeasurementConditions,
    tolerances_mm: Sequence[float | None],
) -> list[Prediction | None]:
    """Predictions for n commands ``q`` (n, N) [rad]; None for all where the model states no uncertainty."""
    if arm.posterior is None:
        return [None] * len(q)
    found: list[Prediction | None] = []
    for begin in range(0, len(q), _AT_ONCE):
        rows = np.arange(begin, min(begin + _AT_ONCE, len(q)))
        spread = spread_of(arm, q[rows], conditions.take(rows))
        noise = arm.posterior.noise_covariance(arm.predict(q[rows], conditions=conditions.take(rows)))
        found += _judged(spread, noise, tolerances_mm[begin : begin + _AT_ONCE])
    return found


def spread_of(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> Spread:
    """Covariances of a model with draws at ``q`` (n, N) [rad]."""
    parameters, effects, network = _of_model(arm, q, conditions)
    nothing = np.zeros_like(parameters)
    return Spread(parameters, effects, network, nothing, nothing)


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_model(arm: ArmModel, q: Array, conditions: MeasurementConditions) -> tuple[Array, Array, Array]:
    """Covariances (n, 3, 3) of geometry, effects and network at ``q``."""
    assert arm.posterior is not None
    by_geometry, by_terms = arm.posterior.displacements_by_part(
        arm.geometry, arm.effects, arm.context(q, conditions=conditions)
    )
    moved = by_geometry + by_terms
    whole = np.einsum("sna,snb->nab", moved, moved, optimize=True) / len(moved)
    own = np.einsum("sna,sna->n", by_geometry, moved) / len(moved)
    share = np.clip(own / np.maximum(np.trace(whole, axis1=1, axis2=2), 1e-300), 0.0, 1.0)[:, None, None]
    network = np.zeros_like(whole)
    if arm.network is not None:
        R = arm.geometry.T_M_B()[:3, :3]
        network = (R * arm.network.spread(q)[:, None] ** 2) @ R.T
    return share * whole, (1.0 - share) * whole, network


def _judged(spread: Spread, noise: Array, tolerances_mm: Sequence[float | None]) -> list[Prediction | None]:
    """Predictions in mm from covariances (n, 3, 3) [m^2] of the model and of measuring."""
    low, high = (bound * 1e3 for bound in length_bounds(spread.whole))
    _, within = length_bounds(spread.whole + noise)
    parts = {name: _coordinate_mm(value) for name, value in vars(spread).items()}
    whole, scatter = _coordinate_mm(spread.whole), _coordinate_mm(noise)
    return [
        Prediction(
            uncertainty_mm=float(whole[k]),
            parts=UncertaintyParts(**{name: float(value[k]) for name, value in parts.items()}, noise=float(scatter[k])),
            within_mm=float(within[k]) * 1e3,
            unknown=(),
            offered_approach=None,
            verdict=predicted_verdict(float(low[k]), float(high[k]), tolerance),
        )
        for k, tolerance in enumerate(tolerances_mm)
    ]


def _coordinate_mm(covariance: Array) -> Array:
    """Root mean square standard deviation (n,) [mm] of a coordinate."""
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0) * 1e3)
