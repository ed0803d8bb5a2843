"""The one decision rule: whether an error conforms to its tolerance, with regard to its uncertainty.

Certificate, verification of targets, paths, tests by ISO 9283, predictions and the terminal application all ask here.
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
"""The same decision in the words of targets and paths."""


def conformity(value: float | None, expanded: float | None, tolerance: float, rule: DecisionRule) -> Conformity:
    """Decide on an error against an upper limit; all in one unit.

    ``guarded`` is ISO 14253-1: conformity is proven where ``value + expanded <= tolerance``, nonconformity where
    ``value - expanded > tolerance``, and neither between. Without an expanded uncertainty it decides nothing.
    ``simple`` compares the value alone (ISO/IEC Guide 98-4, simple acceptance). Nothing is said of a missing value.
    """
    if value is None:
        return "cannot say"
    if rule == "simple":
        return decided(value, value, tolerance)
    return "cannot say" if expanded is None else decided(value - expanded, value + expanded, tolerance)


def decided(low: float, high: float, tolerance: float) -> Conformity:
    """Decide where an error is between two bounds: proven inside, proven outside, or neither."""
    if high <= tolerance:
        return "conforms"
    return "does not conform" if low > tolerance else "cannot say"


def target_verdict(
    value: float | None, expanded: float | None, tolerance: float | None, rule: DecisionRule
) -> ToleranceVerdict:
    """``conformity`` in the words of targets; empty without a tolerance or a measurement."""
    if value is None or tolerance is None:
        return ""
    return TARGET_WORDS[conformity(value, expanded, tolerance, rule)]
