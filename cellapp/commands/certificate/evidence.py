"""Evidence in a run's results on the errors of its arms, for uncertainty budgets."""

from __future__ import annotations

import numpy as np

from cellapp.commands.run_results import StageResults
from cellapp.estimation.uncertainty.budget import Evidence, MeasuredConditions
from cellapp.ground.results import COMPENSATE, DISCOVER, LOCATE, VERIFY


def evidence_of(results: StageResults, arm: str, measured: MeasuredConditions | None = None) -> Evidence:
    """Return the evidence on one arm; ``measured`` are the conditions of its readings."""
    outdated = results.out_of_date
    discovered = None if DISCOVER in outdated else results.discover
    compensated = None if COMPENSATE in outdated else results.compensate
    verified = None if VERIFY in outdated else results.verify
    located = None if LOCATE in outdated else results.locate
    commands = () if compensated is None else compensated.targets
    targets = () if verified is None else verified.targets
    points = [one.measured_M for one in targets if one.arm == arm and one.measured_M is not None]
    return Evidence(
        calibrated=None if results.calibrate is None else results.calibrate.arms.get(arm),
        discovered=None if discovered is None else discovered.arms.get(arm),
        commands=tuple(one.parts for one in commands if one.arm == arm and one.parts is not None),
        verified_m=float(np.linalg.norm(np.array(points), axis=1).max()) if points else None,
        station_mm=None if located is None or not located.moved else located.uncertainty_mm,
        measured=measured,
    )
