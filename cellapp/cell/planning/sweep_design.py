"""The information in a sweep of an arm about its geometry and effects, in addition to that of the stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.parameters import (
    EXPECTED_SCATTER_M,
    ParameterSet,
    estimated_parameters,
    prior_sds,
    typical_spreads,
)
from cellapp.estimation.discovery.plan_forecast import nominal_model, tracker_covariance
from cellapp.estimation.motion.forecast import Expected, foreseen_laws, motion_information
from cellapp.estimation.motion.joint_path import joint_path
from cellapp.estimation.motion.streams import JointStream
from cellapp.estimation.motion.terms import (
    JointState,
    JointTerm,
    Masses,
    state_at_rest,
    state_in_motion,
    torques_in_motion,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas
from cellapp.robot.paths.sweep import Sweep

_INDEPENDENT_S = 0.5
"""Interval [s] of points in a motion that tell as much as one stop each: sweeps of the twin gave about two a second."""
_SAMPLE_S = 0.04
_UNKNOWN = 1.0
"""Upper limit of prior standard deviations, as of a base: practically unknown [m, rad]."""
_DELAY_SD_S = 1.0
"""Prior standard deviation of the delay between the clocks: practically unknown."""


@dataclass(frozen=True, eq=False)
class ExpectedArm:
    """An arm before anything moves: its nominal model, its masses, and the tracker's noise from the profile."""

    profile: Profile
    name: str
    model: ArmModel
    masses: Masses

    @classmethod
    def of(cls, profile: Profile, name: str) -> ExpectedArm:
        """Set up the arm of this name. Raise ``InputError`` if the profile does not describe the cell."""
        model = nominal_model(profile, name)
        return cls(profile, name, model, Masses(model.geometry, model.bodies, model.up_M))

    def at_rest(self, q: Array, direction: Array) -> Expected:
        """Predict stops at ``q`` (n, N) [rad] that the joints reached in ``direction`` (n, N)."""
        return self._measured(state_at_rest(q, direction, self.masses))

    def moving(self, motions: Sequence[Sweep]) -> Expected:
        """Predict points of sweeps, at the interval at which each tells as much as one stop."""
        states = []
        for motion in motions:
            time_s = motion.times(_SAMPLE_S)
            path = joint_path(JointStream(time_s=time_s, q=motion.at(time_s), qd=motion.at(time_s, 1)))
            # without the ends: accelerations need neighbours
            chosen = np.arange(_INDEPENDENT_S, motion.period_s - _INDEPENDENT_S / 2.0, _INDEPENDENT_S)
            state = state_in_motion(path, chosen, None, torques=False)
            # torques at these few times only: a fit would need them at hundreds of times as many
            states.append(replace(state, torque=torques_in_motion(path, chosen, self.masses)))
        q, qd, direction, torque = (
            np.concatenate([getattr(state, word) for state in states]) for word in ("q", "qd", "direction", "torque")
        )
        return self._measured(JointState(q, qd, direction, torque))

    def _measured(self, state: JointState) -> Expected:
        covariance = tracker_covariance(self.profile.tracker, smr_positions(self.model.geometry, state.q))
        return Expected(state, covariance + EXPECTED_SCATTER_M**2 * np.eye(3))

    def parameters(self) -> tuple[ParameterSet, Array]:
        """Return the parameters of the geometry, and the prior standard deviation of each. Raise ``InputError`` if the
        set of the profile is not for this arm."""
        calibration, nominal = self.profile.calibration, self.model.geometry
        stated = prior_sigmas(self.model.nominal, calibration.priors)
        try:
            estimated, _ = estimated_parameters(calibration.parameter_set, nominal, stated)
        except ValueError as error:
            raise InputError(f"arm '{self.name}': calibration.parameter_set: {error}") from None
        return estimated, prior_sds(estimated, {**typical_spreads(nominal.joints), **stated})


@dataclass(frozen=True, eq=False)
class SweepDesign:
    """The quantities that sweeps are to determine: parameters of the geometry and ``terms``, each in units of its prior
    standard deviation ``unit``."""

    arm: ExpectedArm
    estimated: ParameterSet
    terms: tuple[JointTerm, ...]
    unit: Array

    @classmethod
    def of(cls, profile: Profile, name: str) -> SweepDesign:
        """Set up for the geometry and those effects of ``plan.effects`` that recordings can show."""
        arm = ExpectedArm.of(profile, name)
        estimated, sds = arm.parameters()
        laws, wanted = foreseen_laws(arm.model.geometry.joints), profile.plan.effects
        terms = tuple(term for its in laws for term in its if wanted is None or term.law.value in wanted)
        unit = np.array([*sds, *(term.prior_sd for term in terms), _DELAY_SD_S])
        return cls(arm, estimated, terms, np.minimum(unit, _UNKNOWN))

    def before(self, stops: Array, direction: Array) -> Array:
        """Compute the information matrix (P, P) of the priors and the stops (n, N) of an arm."""
        return np.eye(len(self.unit)) + self._information(self.arm.at_rest(stops, direction))

    def told(self, motion: Sweep) -> Array:
        """Compute the information matrix (P, P) of one sweep."""
        return self._information(self.arm.moving([motion]))

    def _information(self, expected: Expected) -> Array:
        information = motion_information(self.arm.model.geometry, self.estimated, self.terms, expected)
        return np.asarray(information * self.unit * self.unit[:, None])
