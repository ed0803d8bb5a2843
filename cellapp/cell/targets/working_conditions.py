"""Working conditions of goals for the model: what targets state, and the state of the other arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.targets.targets import Target, WorkingConditions
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


def conditions_of(target: Target, arm: str) -> WorkingConditions:
    """Return what a target states for one of its arms."""
    partner = target.partner
    return target.conditions if partner is None or target.arm == arm else partner.conditions


def stated_conditions(profile: Profile, targets: Sequence[Target], arm: str) -> MeasurementConditions:
    """Return what n targets state for ``arm``; NaN, or zero for approach signs, if a target states nothing.

    The centre of mass of a payload is that of the profile's load of this mass. A temperature is that of the air and of
    all joints. The approach that a target states is that of its first arm.
    """
    stated, joints = [conditions_of(target, arm) for target in targets], len(profile.arms[arm].type.joints)
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
        payload_center_F=load_centers(profile.arms[arm], [one.payload for one in stated]),
        air_c=temperature,
        joints_c=None if temperature is None else np.tile(temperature[:, None], (1, joints)),
    )


def load_centers(arm: Arm, payloads_kg: Sequence[float | None]) -> Array | None:
    """Return centres of mass (n, 3) [m] of listed loads in the flange frame, NaN for others; None if none is listed."""
    if not arm.payloads:
        return None
    listed = [None if mass is None else arm.listed_load(mass) for mass in payloads_kg]
    return np.array([[np.nan] * 3 if one is None else one.center_of_mass for one in listed])


def conditions_payload(conditions: MeasurementConditions, nominal_kg: float, n: int) -> Array:
    """Return the payload (n,) [kg] of n goals: as stated, else the profile's ``nominal_kg``."""
    stated = conditions.payload_kg
    return np.full(n, nominal_kg) if stated is None else np.where(np.isnan(stated), nominal_kg, stated)


def beside(
    conditions: MeasurementConditions, other: ArmModel, q: Array, payload_kg: Array | None
) -> MeasurementConditions:
    """Return conditions of n goals with the other arm of two at ``q`` (n, K) [rad], carrying ``payload_kg`` (n,)."""
    moment = base_moment(other.geometry, other.bodies, q, other.up_M, payload_kg)
    return replace(conditions, other_q=q, other_moment_M=moment)


def _column(values: Sequence[float | None]) -> Array | None:
    """Return values (n,) with NaN for what is not stated; None if nothing is."""
    if all(value is None for value in values):
        return None
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
