"""The single decision rule: whether an error conforms to its tolerance, given its uncertainty.

Certificate, verification of targets, paths, tests by ISO 9283, predictions and the terminal application all use it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.uncertainty.budget import Evidence, expanded_mm, not_given, target_budget
from cellapp.estimation.uncertainty.records import (
    Conformity,
    ToleranceVerdict,
    UncertaintyContribution,
    UncertaintyParts,
)
from cellapp.ground.profile import Profile
from cellapp.ground.results import DecisionRule
from cellapp.robot.kinematics.transforms import Array

TARGET_WORDS: Mapping[Conformity, ToleranceVerdict] = {
    "conforms": "in",
    "does not conform": "out",
    "cannot say": "cannot say",
}
"""The decision in the words of targets and paths."""


def conformity(value: float | None, expanded: float | None, tolerance: float, rule: DecisionRule) -> Conformity:
    """Decide on an error against an upper limit; all in one unit.

    ``guarded`` is ISO 14253-1: conformity is proven if ``value + expanded <= tolerance``, nonconformity if ``value -
    expanded > tolerance``, and neither between; without an expanded uncertainty there is no decision. ``simple``
    compares the value alone (ISO/IEC Guide 98-4, simple acceptance). A missing value gives no decision.
    """
    if value is None:
        return "cannot say"
    if rule == "simple":
        return decided(value, value, tolerance)
    return "cannot say" if expanded is None else decided(value - expanded, value + expanded, tolerance)


def decided(low: float, high: float, tolerance: float) -> Conformity:
    """Decide for an error between two bounds: proven inside, proven outside, or neither."""
    if high <= tolerance:
        return "conforms"
    return "does not conform" if low > tolerance else "cannot say"


def target_verdict(
    value: float | None, expanded: float | None, tolerance: float | None, rule: DecisionRule
) -> ToleranceVerdict:
    """Return ``conformity`` in the words of targets; empty without a tolerance or a measurement."""
    if value is None or tolerance is None:
        return ""
    return TARGET_WORDS[conformity(value, expanded, tolerance, rule)]


# ---------------------------------------------------------------------------------------------------------------------
# Judgement of measured targets and paths against their tolerances, by the single rule and with the same uncertainty.
#
# The expanded uncertainty of a distance from a target is that of the certificate: its contributions at the measured
# place and for the command sent. If one is missing, the uncertainty is unknown and the rule decides nothing.


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
