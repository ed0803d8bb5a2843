"""Proposal of further stops, and how to approach them, that best decide what discovery left open.

``propose_stops`` is the pure computation; ``propose_run`` reads its input from a run and writes the stops to its plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellapp.calibration.calibrate import CALIBRATION_FILE
from cellapp.calibration.circumstances import circumstances_of_arms
from cellapp.discovery.outcome import Discovery
from cellapp.discovery.proposal.arm_candidates import ArmCandidates, ArmHypotheses
from cellapp.discovery.proposal.candidate_poses import Effort, candidate_poses
from cellapp.discovery.proposal.predictions import PredictedDiscrimination, predict_arm
from cellapp.discovery.proposal.stop_selection import StopSelection
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import CellModel
from cellapp.planning.factors import Factors, as_dict, read_factors, write_factors
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings, RunFile

DEFAULT_EFFORT = Effort()
"""Effort of a proposal from the command line: 10 stops for the two arms of the twin take some 5 s."""
_PROPOSAL_SEED = 0x9409
"""Beside the profile's seed and the number of readings: a later proposal draws other candidates."""


@dataclass(frozen=True)
class ProposedStop:
    """Joint positions of the arms, arm -> (N,) [rad], and how they are approached."""

    q: Mapping[str, Array]
    factors: Mapping[str, Factors]


@dataclass(frozen=True)
class Proposal:
    """Proposed stops in the order of measuring, and what they are worth.

    Attributes
    ----------
    stops : tuple of ProposedStop
    predictions : tuple of PredictedDiscrimination
    first : int, optional
        Number of the first of them in the run's plan; None where they were not written into it.
    notes, advice : tuple of str
    """

    stops: tuple[ProposedStop, ...]
    predictions: tuple[PredictedDiscrimination, ...]
    first: int | None
    notes: tuple[str, ...]
    advice: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; ``stops`` has one flat row for each arm and stop, as a table would."""
        rows = []
        for number, stop in enumerate(self.stops):
            for name, q in stop.q.items():
                asked = as_dict(stop.factors.get(name, Factors()))
                rows.append(
                    {
                        "configuration": (self.first or 0) + number,
                        "arm": name,
                        "q": q.tolist(),
                        "via": asked.get("via"),
                        "dwell_s": asked.get("dwell_s"),
                    }
                )
        arms: dict[str, list[dict[str, Any]]] = {}
        for prediction in self.predictions:
            arms.setdefault(prediction.arm, []).append(
                {
                    "effect": prediction.effect,
                    "against": prediction.against or None,
                    "needed": prediction.needed,
                    "discrimination": {
                        "now": prediction.now,
                        "proposed": prediction.proposed,
                        "random": prediction.random,
                    },
                    "gain_over_random": prediction.gain_over_random,
                }
            )
        return {
            "count": len(self.stops),
            "written": self.first is not None,
            "first_configuration": self.first,
            "arms": arms,
            "stops": rows,
            "notes": list(self.notes),
            "advice": list(self.advice),
        }


def propose_run(
    run: RunFile,
    found: Mapping[str, Discovery],
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    effort: Effort | None = None,
) -> Proposal:
    """Propose ``count`` further stops of all arms after ``found`` was discovered, and write them into the run.

    They replace earlier proposals that were not measured. A run that this program does not drive (no plan, or a driver
    ``none``) gets the list only.

    Raises
    ------
    InputError
        If the run is not calibrated, nothing is open, or no candidate stops can be made.
    Cancelled
        Nothing is written then.
    """
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    readings = {name: run.readings(name) for name in model.arms}
    proposal = propose_stops(run.profile, model, readings, found, count, listener, cancel, effort)
    if why := _not_driven(run):
        note = f"{why}: the stops are listed only; measure them, then import them with the earlier readings"
        return replace(proposal, notes=(*proposal.notes, note))
    return replace(proposal, first=append_to_plan(run, proposal.stops))


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
    known = circumstances_of_arms(model.arms, readings)
    hypotheses = [
        ArmHypotheses.of(profile, name, model, readings[name], known[name], found[name], poses, count, effort, rng)
        for name in model.arms
    ]
    if not any(arm.hypotheses for arm in hypotheses):
        raise InputError("propose: no effect is ambiguous or hidden, so further stops have nothing to decide")
    poses = poses.first(min(arm.affordable_poses for arm in hypotheses))
    arms = [ArmCandidates.of(arm, poses) for arm in hypotheses]
    coupled = any("other_arm" in arm.variables for arm in hypotheses)
    selection = StopSelection(arms, poses, coupled or poses.gate is None, rng)
    chosen = selection.select(count, listener, cancel)
    if not chosen:
        raise InputError("propose: the gate refused every candidate; make plan.clearance smaller, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {count} stops: the gate refused the other candidates")
    predictions: list[PredictedDiscrimination] = []
    advice: list[str] = []
    for number, arm in enumerate(arms):
        pose = np.array([one.poses[number] for one in chosen], dtype=np.intp)
        approach = np.array([one.approaches[number] for one in chosen], dtype=np.intp)
        of_arm, advice_of_arm = predict_arm(arm, poses, pose, approach, rng)
        predictions += of_arm
        advice += advice_of_arm
    stops = tuple(ProposedStop(selection.target(one), selection.factors(one)) for one in chosen)
    listener(Progress("propose", count, count, "done"))
    return Proposal(stops, tuple(predictions), None, tuple(notes), tuple(dict.fromkeys(advice)))


def _not_driven(run: RunFile) -> str:
    """Why this program cannot drive further stops of a run; empty if it can."""
    drivers: dict[str, str] = {f"arms.{name}": arm.driver.kind for name, arm in run.profile.arms.items()}
    drivers["tracker"] = run.profile.tracker.driver.kind
    none = [what for what, kind in drivers.items() if kind == "none"]
    if none:
        return f"the driver of {none[0]} is 'none'"
    return "" if run.read_plan() else "the run has no plan (it was imported)"


def append_to_plan(run: RunFile, stops: Sequence[ProposedStop]) -> int:
    """Append stops to the plan in place of earlier proposals that were not measured. Returns the first number."""
    plan, done, factors = run.read_plan(), run.stops_done(), read_factors(run)
    first = len(next(iter(plan.values())))
    while first - 1 in factors and first - 1 not in done:
        first -= 1
    run.write_plan(
        {name: np.concatenate([rows[:first], [stop.q[name] for stop in stops]]) for name, rows in plan.items()}
    )
    kept = {stop: arms for stop, arms in factors.items() if stop < first}
    write_factors(run, {**kept, **{first + k: stop.factors for k, stop in enumerate(stops)}})
    return first
