"""Named features of a joint for methods without a library of effects, and the effects that they stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.robot.effects import EffectContext
from cellapp.robot.kinematics.transforms import Array

_CYCLES = (1, 2, 3, 4)


@dataclass(frozen=True, eq=False)
class Feature:
    """A quantity (n,) that may move a joint, and the slug of the effect that acts so."""

    name: str
    slug: str
    values: Array


def joint_features(context: EffectContext, joint: int) -> list[Feature]:
    """Features of a joint (from 0): waves of its angle, its load, its last motion, time and temperature."""
    q, j = context.q[:, joint], joint
    found = [
        Feature(f"{name}({k} q)", "encoder_eccentricity" if k == 1 else "transmission_error", wave(k * q))
        for k in _CYCLES
        for name, wave in (("cos", np.cos), ("sin", np.sin))
    ]
    found += [
        Feature("torque", "joint_compliance", context.torques[:, j]),
        Feature("payload torque", "payload_compliance", context.loads.torques_of(-1)[:, j]),
        Feature("approach", "backlash", context.approach[:, j]),
        Feature("approach |torque|", "friction_windup", context.approach[:, j] * np.abs(context.torques[:, j])),
        Feature("last step", "unsettled_measurement", context.step[:, j]),
    ]
    conditions = context.conditions
    if conditions.time_s is not None:
        found.append(Feature("time", "joint_drift", np.asarray(conditions.time_s)))
    if conditions.joints_c is not None:
        found.append(Feature("temperature", "joint_drift", np.asarray(conditions.joints_c)[:, j]))
    return found


@dataclass(frozen=True, eq=False)
class Scaling:
    """Mean and standard deviation of features over the readings to learn from; constant ones stay zero."""

    mean: Array
    sd: Array

    @classmethod
    def of(cls, features: list[Feature]) -> Scaling:
        """Over all rows."""
        table = np.column_stack([one.values for one in features])
        return cls(table.mean(axis=0), table.std(axis=0))

    def table(self, features: list[Feature]) -> Array:
        """Standardised values (n, m)."""
        table = np.column_stack([one.values for one in features]) - self.mean
        return np.where(self.sd > 0.0, table / np.where(self.sd > 0.0, self.sd, 1.0), 0.0)
