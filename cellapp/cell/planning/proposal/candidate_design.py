"""Further stops as a fitted model predicts them: columns of its parameters there, and the expected uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from cellapp.estimation.discovery.arm_data import ArmData, whitening
from cellapp.estimation.discovery.candidates import whitened_displacements
from cellapp.estimation.discovery.joint_fit import JointFit, LinearModel
from cellapp.robot.effects import EFFECTS, EffectContext, Law, MeasurementConditions
from cellapp.robot.kinematics.transforms import Array

_MOST_JOINED = 200
"""Number of further stops, evenly spread, that are joined to the run: enough to show which factors vary among them."""


@dataclass(frozen=True, eq=False)
class CandidateDesign:
    """Candidate stops (m of them) for one fitted model.

    Attributes
    ----------
    context : EffectContext
        What effects may depend on there.
    white : array, shape (3, 3, m)
        Whitening of the expected uncertainty.
    by_joint : array, shape (3, N, m)
        Whitened derivatives of the SMR position by the joints.
    geometric : array, shape (p, 3 m)
        Whitened derivatives by the fitted geometric parameters.
    """

    context: EffectContext
    white: Array
    by_joint: Array
    geometric: Array

    @classmethod
    def of(cls, data: ArmData, fit: JointFit, q: Array, conditions: MeasurementConditions) -> CandidateDesign:
        """Set up at configurations ``q`` (m, N) [rad] under ``conditions``."""
        model, found = fit.model, fit.identification
        true_q = model.true_joints(q, conditions=conditions) if model.effects else None
        context = replace(model.context(q, conditions=conditions), q_actual=true_q)
        white = whitening(_expected_sigma(data, context))
        linear = LinearModel.of(found.geometry, q, white, found.parameter_set.columns)
        return cls(context, white, linear.by_joint, linear.rows)

    def rows(self, slug: str, law: Law, names: Sequence[str]) -> Array:
        """Compute the whitened columns (k, 3 m) of a law."""
        found = {column.name: column for column in EFFECTS[slug].columns(self.context, law, frozenset(names))}
        return whitened_displacements([found[name] for name in names], self.by_joint, self.white)

    @staticmethod
    def by_stop(rows: Array) -> Array:
        """Reshape rows (p, 3 m), ordered by coordinate and then by stop, to (p, m, 3)."""
        return rows.reshape(len(rows), 3, -1).transpose(0, 2, 1)


def _expected_sigma(data: ArmData, context: EffectContext) -> Array:
    """Predict the uncertainty of further readings: the run's mean variances along their beams and across them.

    Further stops count as positions alone, also where the run has orientations.
    """
    points = slice(None) if data.turned is None else ~data.turned
    sigma = data.sigma[points]
    if sigma.ndim == 1:
        return np.full(len(context), float(np.sqrt(np.mean(sigma**2))))
    frame = _beam_frame(data.context)[points]
    variances = np.mean(np.einsum("nac,nab,nbc->nc", frame, sigma, frame), axis=0)
    frame = _beam_frame(context)
    return np.asarray(np.einsum("nac,c,nbc->nab", frame, variances, frame))


def _beam_frame(context: EffectContext) -> Array:
    """Return unit vectors along the beam, horizontally across it and upward across it as columns, (n, 3, 3)."""
    _, beam = context.beam
    _, _, horizontal, upward = context.across
    return np.stack([beam, horizontal, upward], axis=2)


def joined_context(data: ArmData, q: Array, conditions: MeasurementConditions) -> EffectContext:
    """Join the run and some of the further stops (configurations, conditions) in one context."""
    rows = np.arange(len(q))[:: max(1, len(q) // _MOST_JOINED)]
    joined = _joined_conditions(data.conditions, len(data), conditions.take(rows), len(rows))
    return data.model.context(np.concatenate([data.readings.q, q[rows]]), conditions=joined)


def _joined_conditions(
    first: MeasurementConditions, n: int, second: MeasurementConditions, m: int
) -> MeasurementConditions:
    """Join the conditions of n stops and of m further ones; NaN in the rows of those that lack a quantity."""
    joined: dict[str, Any] = {"record": first.record}
    for entry in fields(MeasurementConditions):
        values = [getattr(first, entry.name), getattr(second, entry.name)]
        stated = [value for value in values if value is not None]
        if entry.name == "record" or not stated:
            continue
        rest = stated[0].shape[1:]
        joined[entry.name] = np.concatenate(
            [
                np.full((size, *rest), np.nan) if value is None else np.asarray(value, dtype=np.float64)
                for value, size in zip(values, (n, m), strict=True)
            ]
        )
    return MeasurementConditions(**joined)
