"""Whether a measured error conforms to its tolerance, with regard to its uncertainty."""

from __future__ import annotations

from cellapp.profile.acceptance import DecisionRule
from cellapp.results import Conformity


def conformity(value: float | None, expanded: float | None, tolerance: float, rule: DecisionRule) -> Conformity:
    """Decide on a measured error against an upper limit; all in one unit.

    ``guarded`` is ISO 14253-1: conformity is proven where ``value + expanded <= tolerance``, nonconformity where
    ``value - expanded > tolerance``, and neither between. Without an expanded uncertainty it decides nothing.
    ``simple`` compares the value alone (ISO/IEC Guide 98-4, simple acceptance). Nothing is said of a missing value.
    """
    if value is None:
        return "cannot say"
    if rule == "simple":
        return "conforms" if value <= tolerance else "does not conform"
    if expanded is None:
        return "cannot say"
    if value + expanded <= tolerance:
        return "conforms"
    return "does not conform" if value - expanded > tolerance else "cannot say"
