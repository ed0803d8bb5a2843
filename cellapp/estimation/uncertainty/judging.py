"""Judgement of measured targets and paths against their tolerances, by the single rule and with the same uncertainty.

The expanded uncertainty of a distance from a target is that of the certificate: its contributions at the measured place
and for the command sent. If one is missing, the uncertainty is unknown and the rule decides nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.uncertainty.budget import Evidence, expanded_mm, not_given, target_budget
from cellapp.estimation.uncertainty.decision import target_verdict
from cellapp.estimation.uncertainty.records import ToleranceVerdict, UncertaintyContribution, UncertaintyParts
from cellapp.ground.profile import Profile
from cellapp.ground.results import DecisionRule
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class Judge:
    """Judge of errors in one cell.

    ``known`` holds the data of the run on the errors of each arm.
    """

    profile: Profile
    known: Mapping[str, Evidence] = field(default_factory=dict)

    @property
    def rule(self) -> DecisionRule:
        """Rule chosen in the profile."""
        return self.profile.tolerances.decision

    def expanded_mm(
        self, measured_M: Mapping[str, Array], parts: Mapping[str, UncertaintyParts | None]
    ) -> float | None:
        """Return the expanded uncertainty [mm] at measured SMRs, arm -> (3,) [m]; for two arms of their distance.

        None if a contribution is missing.
        """
        return expanded_mm(self._budget(measured_M, parts))

    def verdict(self, error_mm: float | None, expanded: float | None, tolerance_mm: float | None) -> ToleranceVerdict:
        """Return the verdict; empty without a tolerance or an error."""
        return target_verdict(error_mm, expanded, tolerance_mm, self.rule)

    def not_given(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Return the missing contributions, without which the guarded rule decides nothing."""
        if self.rule != "guarded":
            return ()
        somewhere = {arm: np.array([1.0, 0.0, 0.0]) for arm in arms}
        return tuple(not_given(self._budget(somewhere, dict.fromkeys(arms))))

    def _budget(
        self, measured_M: Mapping[str, Array], parts: Mapping[str, UncertaintyParts | None]
    ) -> list[UncertaintyContribution]:
        return [
            line
            for arm, p_M in measured_M.items()
            for line in target_budget(
                self.profile, arm, self.known.get(arm, Evidence()), float(np.linalg.norm(p_M)), parts.get(arm)
            )
        ]
