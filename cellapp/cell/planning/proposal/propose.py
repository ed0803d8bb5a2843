"""Proposal of further stops, and of how to approach them, that best decide what discovery left open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.cell.planning.proposal.arm_candidates import ArmCandidates, ArmHypotheses
from cellapp.cell.planning.proposal.candidate_poses import Effort, candidate_poses
from cellapp.cell.planning.proposal.predictions import PredictedDiscrimination, predict_arm
from cellapp.cell.planning.proposal.stop_selection import StopSelection
from cellapp.cell.planning.stop_conditions import StopConditions
from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.effects import DriverVariable
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel

DEFAULT_EFFORT = Effort()
"""Effort of a proposal from the command line: 10 stops for the two arms of the twin take some 5 s."""
_PROPOSAL_SEED = 0x9409
"""Seed, besides the profile's seed and the number of readings: a later proposal draws other candidates."""


@dataclass(frozen=True)
class ProposedStop:
    """Joint positions of the arms, arm -> (N,) [rad], and how they are approached."""

    q: Mapping[str, Array]
    conditions: Mapping[str, StopConditions]


@dataclass(frozen=True)
class Proposal:
    """Proposed stops in the order of measuring, and the discrimination that they are predicted to give.

    Attributes
    ----------
    stops : tuple of ProposedStop
    predictions : tuple of PredictedDiscrimination
    notes, advice : tuple of str
    """

    stops: tuple[ProposedStop, ...]
    predictions: tuple[PredictedDiscrimination, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


def propose_stops(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    found: Mapping[str, Discovery],
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    effort: Effort | None = None,
) -> Proposal:
    """Propose ``count`` further stops of all arms of a calibrated cell after ``found`` was discovered.

    Raises
    ------
    InputError
        If nothing is open, or no candidate stops can be made.
    Cancelled
        On request.
    """
    cancel, effort = cancel or CancelToken(), effort or DEFAULT_EFFORT
    rng = np.random.default_rng([profile.seed, _PROPOSAL_SEED, max(len(arm) for arm in readings.values())])
    listener(Progress("propose", 0, count, "candidates"))
    poses, notes = candidate_poses(profile, readings, effort, rng, cancel)
    conditions = conditions_of_arms(model.arms, readings)
    hypotheses = [
        ArmHypotheses.of(profile, name, model, readings[name], conditions[name], found[name], poses, count, effort, rng)
        for name in model.arms
    ]
    if not any(arm.hypotheses for arm in hypotheses):
        raise InputError("propose: no effect is ambiguous or hidden, so further stops have nothing to decide")
    poses = poses.first(min(arm.affordable_poses for arm in hypotheses))
    arms = [ArmCandidates.of(arm, poses) for arm in hypotheses]
    coupled = any(DriverVariable.OTHER_ARM in arm.variables for arm in hypotheses)
    selection = StopSelection(arms, poses, coupled or poses.gate is None, rng)
    chosen = selection.select(count, listener, cancel)
    if not chosen:
        raise InputError("propose: the gate refused every candidate; make plan.clearance smaller, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {counted(count, 'stop')}: the gate refused the other candidates")
    predictions: list[PredictedDiscrimination] = []
    advice: list[str] = []
    for number, arm in enumerate(arms):
        pose = np.array([one.poses[number] for one in chosen], dtype=np.intp)
        approach = np.array([one.approaches[number] for one in chosen], dtype=np.intp)
        of_arm, advice_of_arm = predict_arm(arm, poses, pose, approach, rng)
        predictions += of_arm
        advice += advice_of_arm
    stops = tuple(ProposedStop(selection.target(one), selection.conditions(one)) for one in chosen)
    listener(Progress("propose", count, count, "done"))
    return Proposal(stops, tuple(predictions), tuple(notes), tuple(dict.fromkeys(advice)))
