"""What a sweep tells of an arm: of its geometry, of the effects that the profile's plan is for, beside its stops."""

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
"""Time after which a point of a motion tells as much as one at rest does: those of sweeps of the twin were worth some
two a second."""
_SAMPLE_S = 0.04
_UNKNOWN = 1.0
"""Standard deviation of what nothing is known of, as of a base [m, rad]."""
_DELAY_SD_S = 1.0
"""What is known of the delay between the clocks before: nothing."""


@dataclass(frozen=True, eq=False)
class ExpectedArm:
    """An arm before anything moves: its nominal model, masses, and the tracker's noise by the profile."""

    profile: Profile
    name: str
    model: ArmModel
    masses: Masses

    @classmethod
    def of(cls, profile: Profile, name: str) -> ExpectedArm:
        """The arm of this name. Raises ``InputError`` if the profile does not describe the cell."""
        model = nominal_model(profile, name)
        return cls(profile, name, model, Masses(model.geometry, model.bodies, model.up_M))

    def at_rest(self, q: Array, direction: Array) -> Expected:
        """Stops at ``q`` (n, N) [rad] that joints came to in ``direction`` (n, N)."""
        return self._measured(state_at_rest(q, direction, self.masses))

    def moving(self, motions: Sequence[Sweep]) -> Expected:
        """Points of sweeps, as far apart as they are worth one each."""
        states = []
        for motion in motions:
            time_s = motion.times(_SAMPLE_S)
            path = joint_path(JointStream(time_s=time_s, q=motion.at(time_s), qd=motion.at(time_s, 1)))
            # the ends are left out: accelerations need neighbours
            chosen = np.arange(_INDEPENDENT_S, motion.period_s - _INDEPENDENT_S / 2.0, _INDEPENDENT_S)
            state = state_in_motion(path, chosen, None, torques=False)
            # at these few times only: what fits keep is at hundreds of times as many
            states.append(replace(state, torque=torques_in_motion(path, chosen, self.masses)))
        q, qd, direction, torque = (
            np.concatenate([getattr(state, word) for state in states]) for word in ("q", "qd", "direction", "torque")
        )
        return self._measured(JointState(q, qd, direction, torque))

    def _measured(self, state: JointState) -> Expected:
        covariance = tracker_covariance(self.profile.tracker, smr_positions(self.model.geometry, state.q))
        return Expected(state, covariance + EXPECTED_SCATTER_M**2 * np.eye(3))

    def parameters(self) -> tuple[ParameterSet, Array]:
        """The parameters of the geometry, and what is known of each before. Raises ``InputError`` if the set of the
        profile is not for this arm."""
        calibration, nominal = self.profile.calibration, self.model.geometry
        stated = prior_sigmas(self.model.nominal, calibration.priors)
        try:
            estimated, _ = estimated_parameters(calibration.parameter_set, nominal, stated)
        except ValueError as error:
            raise InputError(f"arm '{self.name}': calibration.parameter_set: {error}") from None
        return estimated, prior_sds(estimated, {**typical_spreads(nominal.joints), **stated})


@dataclass(frozen=True, eq=False)
class SweepDesign:
    """What sweeps shall tell of an arm: parameters of its geometry and ``terms``, each in units of what is known of it
    before."""

    arm: ExpectedArm
    estimated: ParameterSet
    terms: tuple[JointTerm, ...]
    unit: Array

    @classmethod
    def of(cls, profile: Profile, name: str) -> SweepDesign:
        """For the geometry and the effects that ``plan.effects`` lists, as far as recordings show them."""
        arm = ExpectedArm.of(profile, name)
        estimated, sds = arm.parameters()
        laws, wanted = foreseen_laws(arm.model.geometry.joints), profile.plan.effects
        terms = tuple(term for its in laws for term in its if wanted is None or term.law.value in wanted)
        unit = np.array([*sds, *(term.prior_sd for term in terms), _DELAY_SD_S])
        return cls(arm, estimated, terms, np.minimum(unit, _UNKNOWN))

    def before(self, stops: Array, direction: Array) -> Array:
        """Information (P, P) of what is known before, and of the stops (n, N) of an arm."""
        return np.eye(len(self.unit)) + self._information(self.arm.at_rest(stops, direction))

    def told(self, motion: Sweep) -> Array:
        """Information (P, P) of one sweep."""
        return self._information(self.arm.moving([motion]))

    def _information(self, expected: Expected) -> Array:
        information = motion_information(self.arm.model.geometry, self.estimated, self.terms, expected)
        return np.asarray(information * self.unit * self.unit[:, None])
