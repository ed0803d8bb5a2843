"""The single decision rule: whether an error conforms to its tolerance, given its uncertainty.

Certificate, verification of targets, paths, tests by ISO 9283, predictions and the terminal application all use it.
"""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.estimation.uncertainty.records import Conformity, ToleranceVerdict
from cellapp.ground.results import DecisionRule

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
