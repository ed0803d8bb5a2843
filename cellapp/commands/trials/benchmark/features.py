"""Named features of a joint for methods without a library, the effects they stand for, and regression by joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.commands.trials.benchmark.problem import Answer, JointProjection, Problem
from cellapp.robot.effects import EffectContext
from cellapp.robot.kinematics.transforms import Array

_CYCLES = (1, 2, 3, 4)


@dataclass(frozen=True, eq=False)
class Feature:
    """A quantity (n,) that may move a joint, and the slug of the effect it stands for."""

    name: str
    slug: str
    values: Array


def joint_features(context: EffectContext, joint: int) -> list[Feature]:
    """Return the features of a joint (from 0): waves of its angle, its load, its last motion, time and temperature."""
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
    """Mean and standard deviation of features over the readings to learn from; constant features are scaled to zero."""

    mean: Array
    sd: Array

    @classmethod
    def of(cls, features: list[Feature]) -> Scaling:
        """Compute the scaling over all rows."""
        table = np.column_stack([one.values for one in features])
        return cls(table.mean(axis=0), table.std(axis=0))

    def table(self, features: list[Feature]) -> Array:
        """Standardise features; return values (n, m)."""
        table = np.column_stack([one.values for one in features]) - self.mean
        return np.where(self.sd > 0.0, table / np.where(self.sd > 0.0, self.sd, 1.0), 0.0)


JointRule = Callable[[Array], Array]
"""Standardised features (n, m) of a joint -> its offsets (n,) [rad]."""
Regression = Callable[[Array, Array], tuple[JointRule, Mapping[int, float]]]
"""(standardised features (n, m), offsets (n,) [rad]) -> the rule, and the probability of each feature that it needs."""


def regressed_by_joint(problem: Problem, regression: Regression) -> Answer:
    """Predict each joint's offsets from its features, and name the effects of the features that are needed."""
    model, projection = problem.geometry_fit.model, JointProjection.of(problem)
    learn = model.context(problem.learn.q, conditions=problem.learn_conditions)
    held = model.context(problem.held_out.q, conditions=problem.held_out_conditions)
    predicted = np.zeros((len(held), held.joints))
    names: dict[str, float] = {}
    for joint in range(learn.joints):
        features = joint_features(learn, joint)
        scaling = Scaling.of(features)
        rule, needed = regression(scaling.table(features), projection.offsets[:, joint])
        predicted[:, joint] = rule(scaling.table(joint_features(held, joint)))
        for place, probability in needed.items():
            slug = features[place].slug
            names[slug] = max(probability, names.get(slug, 0.0))
    return Answer(projection.predicted(predicted), names)
