"""Forecast of what the sweeps of a plan will tell in addition to its stops, before anything moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.planning.planned_stops import PlannedStops, last_motions
from cellapp.cell.planning.records import LawInMotion, SweepForecast
from cellapp.cell.planning.sweep_design import ExpectedArm
from cellapp.cell.planning.sweeps import PlannedSweep
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.parameters import EXPECTED_SCATTER_M
from cellapp.estimation.motion.forecast import forecast_motion
from cellapp.ground.profile import Profile


def forecast_sweeps(profile: Profile, stops: PlannedStops, sweeps: Sequence[PlannedSweep]) -> dict[str, SweepForecast]:
    """Forecast, for each arm that sweeps, what its stops, its sweeps and both together will tell.

    Raises
    ------
    InputError
        If the profile does not describe the cell, or a parameter set is not for its arm.
    """
    step = last_motions(stops, home_positions(profile))
    found = {}
    for name, q in stops.q.items():
        motions = [sweep.motion(q[sweep.stop]) for sweep in sweeps if sweep.arm == name]
        if not motions:
            continue
        arm = ExpectedArm.of(profile, name)
        sources = {"stops": arm.at_rest(q, np.sign(step[name])), "sweeps": arm.moving(motions)}
        accuracy, laws = forecast_motion(arm.model.geometry, *arm.parameters(), sources, q, EXPECTED_SCATTER_M)
        found[name] = SweepForecast(accuracy=accuracy, laws=tuple(LawInMotion.like(law) for law in laws))
    return found
