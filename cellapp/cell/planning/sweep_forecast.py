"""What the sweeps of a plan will tell beside its stops, before anything moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.planning.planned_stops import PlannedStops, last_motions
from cellapp.cell.planning.records import LawInMotion, SweepForecast
from cellapp.cell.planning.sweeps import PlannedSweep
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.parameters import EXPECTED_SCATTER_M
from cellapp.estimation.discovery.plan_forecast import nominal_model, tracker_covariance
from cellapp.estimation.motion.forecast import Expected, forecast_motion
from cellapp.estimation.motion.joint_path import joint_path
from cellapp.estimation.motion.streams import JointStream
from cellapp.estimation.motion.terms import JointState, Masses, state_at_rest, state_in_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

_INDEPENDENT_S = 0.5
"""Time after which a point of a motion tells as much as one at rest does: those of sweeps of the twin were worth some
two a second."""
_SAMPLE_S = 0.04


def forecast_sweeps(profile: Profile, stops: PlannedStops, sweeps: Sequence[PlannedSweep]) -> dict[str, SweepForecast]:
    """What stops, sweeps and both together will tell of each arm that sweeps.

    Raises
    ------
    InputError
        If the profile does not describe the cell, or a parameter set is not for its arm.
    """
    step = last_motions(stops, home_positions(profile))
    found = {}
    for name in stops.q:
        its = [sweep for sweep in sweeps if sweep.arm == name]
        if not its:
            continue
        model = nominal_model(profile, name)
        masses = Masses(model.geometry, model.bodies, model.up_M)
        at_rest = state_at_rest(stops.q[name], np.sign(step[name]), masses)
        sources = {
            "stops": _expected(profile, model, at_rest),
            "sweeps": _expected(profile, model, _in_motion(stops.q[name], its, masses)),
        }
        stated, wanted = prior_sigmas(model.nominal, profile.calibration.priors), profile.calibration.parameter_set
        try:
            accuracy, laws = forecast_motion(model.geometry, wanted, stated, sources, stops.q[name], EXPECTED_SCATTER_M)
        except ValueError as error:
            raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None
        found[name] = SweepForecast(accuracy=accuracy, laws=tuple(LawInMotion.like(law) for law in laws))
    return found


def _expected(profile: Profile, model: ArmModel, state: JointState) -> Expected:
    covariance = tracker_covariance(profile.tracker, smr_positions(model.geometry, state.q))
    return Expected(state, covariance + EXPECTED_SCATTER_M**2 * np.eye(3))


def _in_motion(stops: Array, sweeps: Sequence[PlannedSweep], masses: Masses) -> JointState:
    """States of an arm along its sweeps, as far apart as points are worth one each."""
    states = []
    for sweep in sweeps:
        motion = sweep.motion(stops[sweep.stop])
        time_s = motion.times(_SAMPLE_S)
        path = joint_path(JointStream(time_s=time_s, q=motion.at(time_s), qd=motion.at(time_s, 1)))
        # the ends are left out: accelerations need neighbours
        chosen = np.arange(_INDEPENDENT_S, motion.period_s - _INDEPENDENT_S / 2.0, _INDEPENDENT_S)
        states.append(state_in_motion(path, chosen, masses, torques=True))
    q, qd, direction, torque = (
        np.concatenate([getattr(state, word) for state in states]) for word in ("q", "qd", "direction", "torque")
    )
    return JointState(q, qd, direction, torque)
