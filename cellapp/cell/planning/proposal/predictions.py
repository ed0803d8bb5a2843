"""Value of proposed stops: discrimination of each hypothesis now, with them, and with equally many random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.proposal.arm_candidates import ArmCandidates, last_known
from cellapp.cell.planning.proposal.candidate_design import CandidateDesign
from cellapp.cell.planning.proposal.candidate_poses import CandidatePoses
from cellapp.cell.planning.proposal.hypotheses import Hypothesis
from cellapp.estimation.design.discrimination import Discrimination
from cellapp.robot.effects import EFFECTS, DriverVariable, varies
from cellapp.robot.kinematics.transforms import Array

_RANDOM_DESIGNS = 8
"""Number of random designs that are averaged for comparison, so that no single draw decides."""
_LOAD_SHARE = 0.25
"""Suggested further payload as a share of the arm's own mass: what arms of this class may carry."""
_LEAST_LOAD_STEP_KG = 0.5
"""Suggested payloads are multiples of this: common weights."""
_WORTH_A_LOAD = 1.5
"""Factor by which another payload must raise the discrimination to be suggested."""


@dataclass(frozen=True)
class PredictedDiscrimination:
    """Non-centrality lambda of one hypothesis: now, with the proposed stops, with the same number of random ones.

    ``against`` is empty where the question is whether the effect can be seen at all.
    """

    arm: str
    effect: str
    against: str
    needed: float
    now: float
    proposed: float
    random: float

    @property
    def gain_over_random(self) -> float:
        """Ratio of the discrimination with the proposed stops to that with random ones."""
        return self.proposed / max(self.random, 1e-12)


def predict_arm(
    arm: ArmCandidates,
    poses: CandidatePoses,
    pose: NDArray[np.intp],
    approach: NDArray[np.intp],
    rng: np.random.Generator,
) -> tuple[list[PredictedDiscrimination], list[str]]:
    """Predict the hypotheses of one arm with the chosen candidates; return also advice to change its payload."""
    chosen = pose * len(arm.approaches) + approach
    draws = [rng.integers(0, len(poses) * len(arm.approaches), len(chosen)) for _ in range(_RANDOM_DESIGNS)]
    nothing = np.array([], dtype=np.intp)
    predictions, advice = [], []
    for one, comparison in arm.comparisons:
        prediction = PredictedDiscrimination(
            arm=arm.name,
            effect=one.effect,
            against=one.against,
            needed=one.needed,
            now=_least(comparison, nothing),
            proposed=_least(comparison, chosen),
            random=float(np.mean([_least(comparison, draw) for draw in draws])),
        )
        predictions.append(prediction)
        advice += _load_advice(arm, one, poses, pose, approach, prediction)
    return predictions, advice


def _least(comparison: Sequence[Discrimination], chosen: NDArray[np.intp]) -> float:
    """Return the least discrimination over the laws of the rival."""
    return min(one.noncentrality(chosen) for one in comparison)


def _load_advice(
    arm: ArmCandidates,
    hypothesis: Hypothesis,
    poses: CandidatePoses,
    pose: NDArray[np.intp],
    approach: NDArray[np.intp],
    prediction: PredictedDiscrimination,
) -> list[str]:
    """Advise another payload at every second stop, if the stops do not decide and the run had one payload."""
    conditions = arm.run.conditions
    depends = any(DriverVariable.PAYLOAD in EFFECTS[slug].variables for slug in hypothesis.effects)
    decided = bool(hypothesis.against) and prediction.proposed >= prediction.needed
    if not depends or decided or varies(conditions.payload_kg):
        return []
    bodies = hypothesis.data.model.bodies
    present = last_known(conditions.payload_kg, 1)
    now_kg = bodies.payload_mass if present is None else float(present[0])
    steps = round(_LOAD_SHARE * float(bodies.masses.sum()) / _LEAST_LOAD_STEP_KG)
    more_kg = max(steps * _LEAST_LOAD_STEP_KG, _LEAST_LOAD_STEP_KG)
    load_kg: Array = now_kg + more_kg * (np.arange(len(pose)) % 2).astype(np.float64)
    q, expected = arm.run.candidates(poses, arm.approaches, pose, approach, load_kg)
    design = CandidateDesign.of(hypothesis.data, hypothesis.fit, q, expected)
    loaded = _least(hypothesis.discriminations(design), np.arange(len(pose)))
    if loaded < _WORTH_A_LOAD * prediction.proposed:
        return []
    titles = " and ".join(EFFECTS[slug].title for slug in hypothesis.effects)
    aim = f"distinguish {titles}" if hypothesis.against else f"show {titles}"
    return [
        f"arm {arm.name}: another load would {aim} better: {now_kg + more_kg:g} kg instead of {now_kg:g} kg at every"
        f" second stop would bring the discrimination to {loaded:.0f} instead of {prediction.proposed:.0f}; a person"
        " must attach it, if the arm may carry it, and enter it in the controller"
    ]
