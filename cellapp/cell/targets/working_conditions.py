"""Working conditions of goals as the model takes them: what targets state, and the state of the other arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.targets.targets import Target, WorkingConditions
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


def conditions_of(target: Target, arm: str) -> WorkingConditions:
    """What a target states for one of its arms."""
    partner = target.partner
    return target.conditions if partner is None or target.arm == arm else partner.conditions


def stated_conditions(targets: Sequence[Target], arm: str, joints: int) -> MeasurementConditions:
    """What n targets state for ``arm``; NaN, and zero for approach signs, where one states nothing.

    A temperature is that of the air and of all joints. The approach that a target states is that of its first arm.
    """
    stated = [conditions_of(target, arm) for target in targets]
    temperature = _column([one.temperature for one in stated])
    approach = np.zeros((len(targets), joints))
    for row, target in enumerate(targets):
        if target.approach is not None and target.arm == arm:
            approach[row] = target.approach
    return MeasurementConditions(
        approach=approach if approach.any() else None,
        dwell_s=_column([one.dwell for one in stated]),
        time_s=_column([one.time for one in stated]),
        payload_kg=_column([one.payload for one in stated]),
        air_c=temperature,
        joints_c=None if temperature is None else np.tile(temperature[:, None], (1, joints)),
    )


def conditions_payload(conditions: MeasurementConditions, nominal_kg: float, n: int) -> Array:
    """Payload (n,) [kg] under conditions of n goals: as stated, else the profile's ``nominal_kg``."""
    stated = conditions.payload_kg
    return np.full(n, nominal_kg) if stated is None else np.where(np.isnan(stated), nominal_kg, stated)


def beside(
    conditions: MeasurementConditions, other: ArmModel, q: Array, payload_kg: Array | None
) -> MeasurementConditions:
    """Conditions of n goals with the other arm of a cell of two at ``q`` (n, K) [rad], carrying ``payload_kg`` (n,)."""
    moment = base_moment(other.geometry, other.bodies, q, other.up_M, payload_kg)
    return replace(conditions, other_q=q, other_moment_M=moment)


def _column(values: Sequence[float | None]) -> Array | None:
    """Values (n,) with NaN for what is not stated; None if nothing is."""
    if all(value is None for value in values):
        return None
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
