"""Laws, places, units and intervals as text for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cellapp.commands.view.table import Interval, Number
from cellapp.estimation.discovery.records import LawRecord, Place
from cellapp.ground.results import Estimate, Method
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
TWO_SIDED = 1.959964
"""Half width of a 95 % interval in standard errors: quantile 0.975 of the normal distribution."""


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
    half = TWO_SIDED * error
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
