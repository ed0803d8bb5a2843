"""Laws, places, units and intervals as text for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from cellapp.commands.view.table import Interval, Number, Table, table_of
from cellapp.estimation.calibration.least_squares import NORMAL_95
from cellapp.estimation.discovery.records import LawRecord, Place
from cellapp.estimation.uncertainty.records import Characteristic, Conformity, Judgement, overall
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.results import DecisionRule, Estimate, Method
from cellapp.robot.effects import EFFECTS

_UNITS = {
    "rad": (1e6, "µrad"),
    "rad/Nm": (1e6, "µrad/Nm"),
    "rad/K": (1e6, "µrad/K"),
    "rad/rad": (1e6, "µrad/rad"),
    "m": (1e6, "µm"),
    "m/m": (1e6, "µm/m"),
    "m/K": (1e6, "µm/K"),
    "m/Nm": (1e6, "µm/Nm"),
    "1/K": (1e6, "µm/m/K"),
    "1/(N m^2)": (1e6, "1e-6/(N m²)"),
}
_MILLIMETRES = 1e-3
"""Lengths from this one on are shown in mm [m]."""
_NEARLY_CERTAIN = 0.99
"""Probability beyond which only this limit is stated."""


def law_words(effect: str, law: LawRecord, joints: Sequence[int] = ()) -> str:
    """Describe a stored law in its effect's own words; by the law's name if this version does not know it.

    ``joints`` (from 1) are the joints whose constants are included, such as knee torques.
    """
    try:
        known = EFFECTS[effect].law(law.name, law.constants)
    except (KeyError, ValueError):
        return law.name.replace("_", " ")
    return known.words([joint - 1 for joint in joints])


def place_words(where: Place) -> str:
    """Say where an effect acts: ``joints 1-3, 6``, or names of frames."""
    joints = where.joints
    if not joints and all(place.startswith("joint ") for place in where.acts_on):
        joints = tuple(int(place.removeprefix("joint ")) for place in where.acts_on)
    if joints:
        return f"joint{'s' if len(joints) > 1 else ''} {ranges(joints)}"
    return ", ".join(where.acts_on)


def ranges(numbers: Sequence[int]) -> str:
    """Format numbers as ranges: ``1-3, 6`` for 1, 2, 3, 6."""
    parts: list[list[int]] = []
    for number in sorted(numbers):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(
        f"{part[0]}-{part[-1]}" if len(part) > 2 else ", ".join(str(number) for number in part) for part in parts
    )


def interval_95(estimate: Estimate) -> tuple[Number, Interval | None, str]:
    """Return value, 95 % interval and display unit of a parameter, with two significant digits of its standard error.

    The interval is None without a standard error.
    """
    factor, unit = _UNITS.get(estimate.unit, (1.0, estimate.unit))
    if estimate.unit == "m" and abs(estimate.value) >= _MILLIMETRES:
        factor, unit = 1e3, "mm"
    value = estimate.value * factor
    if estimate.standard_error is None:
        return Number(value, 3), None, unit
    error = estimate.standard_error * factor
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 9) if 0.0 < error < math.inf else 3
    half = NORMAL_95 * error
    return Number(value, decimals), Interval(value - half, value + half, decimals), unit


def probability_words(probability: float | None) -> str:
    """Format a probability: ``97 %``; ``> 99 %`` and ``< 1 %`` where rounding would claim certainty; empty for None."""
    if probability is None:
        return ""
    if probability > _NEARLY_CERTAIN:
        return "> 99 %"
    return "< 1 %" if probability < 1.0 - _NEARLY_CERTAIN else f"{100.0 * probability:.0f} %"


def geometry_unit(unit: str) -> tuple[float, str]:
    """Return factor and display unit of a geometric parameter in m or rad: mm and degrees."""
    return (1e3, "mm") if unit == "m" else (math.degrees(1.0), "deg")


def display_unit(unit: str) -> tuple[float, str]:
    """Return factor and display unit of a parameter of any kind: micrometres, microradians and the like."""
    return _UNITS.get(unit, (1.0, unit))


STAGE_WORDS: Mapping[str, str] = {
    "nominal": "nominal",
    "geometry": "identified geometry",
    "network": "geometry and network",
    "effects": "geometry and effects",
}
METHOD_WORDS: Mapping[Method, str] = {
    "nominal": "nominal cell",
    "method_1": "geometry alone",
    "method_2": "network in the tracker frame",
    "proposed": "network in the base frame",
    "effects": "geometry and effects",
}


def short_reason(reason: str) -> str:
    """Return why an effect cannot be seen, without the words that the table heading has already."""
    for prefix in ("not testable: ", "invisible: "):
        reason = reason.removeprefix(prefix)
    return reason.removesuffix(" under this plan")


# -- Errors against their tolerances in the terms of their norms, and the verdict on all of them ----------------------


CHARACTERISTIC_WORDS: Mapping[Characteristic, str] = {
    "position": "Position error",
    "orientation": "Orientation error",
    "distance": "Distance error",
    "cooperative": "Cooperative error",
    "cooperative_orientation": "Cooperative orientation error",
    "pose_accuracy": "Pose accuracy AP",
    "pose_repeatability": "Pose repeatability RP",
    "multidirectional": "Multi-directional variation vAP",
    "distance_accuracy": "Distance accuracy AD",
    "distance_repeatability": "Distance repeatability RD",
    "drift": "Drift of pose accuracy dAP",
    "path_accuracy": "Path accuracy AT",
    "path_repeatability": "Path repeatability RT",
}
"""Names of the characteristics; those with letters are of ISO 9283."""
RULE_WORDS: Mapping[DecisionRule, str] = {
    "guarded": (
        "An error conforms if it is inside its tolerance by its expanded uncertainty U (k = 2), it does not conform if"
        " it is outside by U, and in between it is not decided (ISO 14253-1)."
    ),
    "simple": "Errors alone are compared with their tolerances, without their uncertainty (simple acceptance).",
}


def undecided_words(not_given: Sequence[str]) -> str:
    """Say why the guarded rule decides nothing; empty if all contributions to U are given."""
    if not not_given:
        return ""
    return f"U is not known, so that nothing is proven: not given in traceability or the run: {', '.join(not_given)}."


VERDICT_TITLES: Mapping[Conformity, str] = {
    "conforms": "The cell conforms to its tolerances",
    "does not conform": "The cell does not conform to its tolerances",
    "not decided": "Not decided",
}
_STATES: tuple[Conformity, ...] = get_args(Conformity)


@dataclass(frozen=True)
class Verdict:
    """The verdict on the cell's tolerances; ``state`` is None if nothing is judged."""

    state: Conformity | None
    title: str
    sentence: str


def verdict_of(judgements: Sequence[Judgement]) -> Verdict:
    """Summarize all judgements in a title and a sentence."""
    state = overall(judgements) or "not decided"
    if not judgements:
        return Verdict(state, VERDICT_TITLES[state], "Nothing that has a tolerance was measured.")
    return Verdict(state, VERDICT_TITLES[state], judged_sentence(judgements))


def judged_sentence(judgements: Sequence[Judgement]) -> str:
    """State how many errors conform, which do not, and how many are undecided or not measured."""
    total = len(judgements)
    counts = {state: [one for one in judgements if one.conformity == state] for state in _STATES}
    out, unsure = counts["does not conform"], counts["not decided"]
    missing = [one for one in unsure if one.value is None]
    if len(counts["conforms"]) == total:
        return f"All {counted(total, 'error')} with a tolerance are inside it."
    parts = [f"{len(counts['conforms'])} of {counted(total, 'error')} with a tolerance conform"]
    if out:
        parts.append(f"{f'{len(out)} do' if len(out) > 1 else 'one does'} not: {named_errors(out)}")
    if len(unsure) > len(missing):
        parts.append(f"{len(unsure) - len(missing)} not decided within the uncertainty")
    if missing:
        parts.append(f"{len(missing)} not measured")
    return "; ".join(parts) + "."


def named_errors(judgements: Sequence[Judgement]) -> str:
    """List what is judged and where."""
    places = grouped((one.characteristic, one.where) for one in judgements)
    words = ((CHARACTERISTIC_WORDS[characteristic], where) for characteristic, where in places.items())
    return ", ".join(f"{name[0].lower()}{name[1:]} of {' and '.join(where)}" for name, where in words)


def judgement_table(judgements: Sequence[Judgement]) -> Table:
    """Show every judgement with its uncertainty; up to the verdict it fits into 80 columns, its source follows."""
    rotated = any(one.unit == "mrad" for one in judgements)
    return table_of(
        f"Errors against their tolerances [mm{', of orientation mrad' if rotated else ''}]",
        judgements,
        ("error", lambda one: CHARACTERISTIC_WORDS[one.characteristic]),
        ("of", "where"),
        ("measured", "value", ".3f"),
        ("U (k = 2)", "expanded", ".3f"),
        ("tolerance", lambda one: round(one.tolerance, 6), "g"),
        ("verdict", "conformity"),
        ("n", lambda one: one.n or None, "d"),
        ("measured by", "source"),
    )
