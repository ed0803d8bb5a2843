"""A problem of the benchmark, a method's answer, and the projection to joints for methods without a library.

A method is a function from a ``Problem`` to an ``Answer``. It gets the design of an arm, the measurements at some stops
with their conditions, and the conditions of further stops. It names the missing effects, each with a probability, and
predicts the SMR positions at the further stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from cellapp.commands.trials.visible_size import registered_model
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms
from cellapp.estimation.motion.calibrate import calibrate_arm_with_motion, samples_of
from cellapp.estimation.motion.streams import Recording
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import joined
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


@dataclass(frozen=True, eq=False)
class Motion:
    """Recordings of an arm in motion, each with the clocks of both devices, and its readings at rest to learn from."""

    recordings: tuple[Recording, ...]
    stops: Readings


@dataclass(frozen=True, eq=False)
class Problem:
    """One arm in which something is hidden, or nothing.

    Attributes
    ----------
    name : str
        Identifies the problem: ``single/run-0003/left``.
    profile : Profile
        The cell as its user describes it, without hidden effects. ``profile.arms[arm]`` has rows, masses and limits.
    arm : str
    learn : Readings
        Joint positions (n, N), points (n, 3) [m] in the tracker frame, and their conditions.
    held_out : Readings
        Joint positions and conditions (m, ...) of the stops to predict; their points are NaN.
    learn_conditions, held_out_conditions : MeasurementConditions
        The same conditions in the form that effects need, with the load of the other arm.
    motion : Motion or None
        The recordings in motion; None if there are none. ``learn`` then includes samples of them, with clocks aligned.
    """

    name: str
    profile: Profile
    arm: str
    learn: Readings
    held_out: Readings
    learn_conditions: MeasurementConditions
    held_out_conditions: MeasurementConditions
    motion: Motion | None = None

    @classmethod
    def of(
        cls, name: str, profile: Profile, arm: str, readings: Readings, conditions: MeasurementConditions
    ) -> Problem:
        """Build the problem of an arm's readings; the validate split is held out."""
        held = np.zeros(len(readings), dtype=np.bool_)
        held[readings.in_split("validate")] = True
        hidden = readings.take(held)
        return cls(
            name,
            profile,
            arm,
            readings.take(~held),
            replace(hidden, p_M=np.full_like(hidden.p_M, np.nan)),
            conditions.take(~held),
            conditions.take(held),
        )

    def with_motion(self, recordings: tuple[Recording, ...]) -> Problem:
        """Return the same arm with recordings of motion. Raises ``InputError`` if one cannot be used."""
        fit, _ = calibrate_arm_with_motion(self.profile, self.arm, self.learn, recordings)
        samples = samples_of(fit, self.learn.joints)
        samples = samples.take(samples.in_split("identify"))
        n, first = len(samples), 1 + int(self.learn.configuration.max(initial=-1))
        samples = replace(samples, configuration=first + np.arange(n), time_s=np.full(n, np.nan), step=None)
        learn = joined([self.learn, samples])
        motion = Motion(recordings, self.learn)
        return replace(self, learn=learn, learn_conditions=measurement_conditions(learn), motion=motion)

    @cached_property
    def data(self) -> ArmData:
        """The readings to learn from in the form of cellapp's discovery: weights, and the best-fitting geometry."""
        nominal = registered_model(self.profile, self.arm, self.learn.q, self.learn.p_M)
        return ArmData.of(self.profile, nominal, self.learn, self.learn_conditions)

    @cached_property
    def geometry_fit(self) -> JointFit:
        """Least squares of the geometry alone, weighted by the stated uncertainty."""
        return fit_terms(self.data, ())

    @cached_property
    def geometry_residual(self) -> Array:
        """Residuals of that fit at the points to learn from, (n, 3) [m]."""
        return self.learn.p_M - self.geometry_fit.model.predict(self.learn.q, conditions=self.learn_conditions)

    def predicted(self, model: ArmModel) -> Array:
        """Predict SMR positions (m, 3) [m] at the held-out stops with a model."""
        return model.predict(self.held_out.q, conditions=self.held_out_conditions)


@dataclass(frozen=True, eq=False)
class Answer:
    """A method's answer to a problem.

    Attributes
    ----------
    names : mapping
        Slug of each accepted effect -> its probability; ``unknown`` for an effect without a name. Empty: nothing
        missing.
    p_M : array, shape (m, 3)
        SMR positions at the held-out stops [m], tracker frame.
    """

    p_M: Array
    names: Mapping[str, float] = field(default_factory=dict)


class NotTaken(Exception):
    """Error: a method does not accept this kind of problem, and says why. It counts as not answered."""


Method = Callable[[Problem], Answer]


@dataclass(frozen=True, eq=False)
class JointProjection:
    """Residuals of the geometry as joint offsets, for methods that regress joint by joint.

    Three coordinates do not determine six joints: each reading gets its smallest offsets, damped by the noise.

    Attributes
    ----------
    offsets : array, shape (n, N)
        [rad], of the readings to learn from.
    """

    problem: Problem
    offsets: Array

    @classmethod
    def of(cls, problem: Problem) -> JointProjection:
        """Project the residuals of the best geometry."""
        J = _by_joints(problem.geometry_fit.model, problem.learn.q)
        gram = np.einsum("naj,nbj->nab", J, J)
        damped = gram + 1e-4 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        projected = np.linalg.solve(damped, problem.geometry_residual[..., None])[..., 0]
        return cls(problem, np.einsum("naj,na->nj", J, projected))

    def predicted(self, offsets: Array) -> Array:
        """Predict SMR positions (m, 3) [m] at the held-out stops with joint offsets (m, N) [rad]."""
        own = self.problem
        J = _by_joints(own.geometry_fit.model, own.held_out.q)
        return np.asarray(own.predicted(own.geometry_fit.model) + np.einsum("naj,nj->na", J, offsets))


def _by_joints(model: ArmModel, q: Array) -> Array:
    """Compute the derivatives (n, 3, N) [m/rad] of the SMR position by the joints."""
    return joint_jacobian(model.geometry, JointAngles.of(q))[1].transpose(2, 0, 1)
