"""Laws, places, units and intervals as text for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from cellapp.effects import EFFECTS

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
"""Lengths from here on are in mm [m]."""
_TWO_SIDED = 1.959964
"""Half width of a 95 % interval, in standard errors."""
_MOST_DIGITS = 9
"""Decimals beyond which a standard error is rounding error."""


def law_words(effect: str, law: Mapping[str, Any], joints: Sequence[int] = ()) -> str:
    """The effect's own words for a law of a stored result; its name where this version does not know it.

    ``joints`` (from 1) are those whose constants are included, such as knee torques.
    """
    try:
        known = EFFECTS[effect].law(law["name"], law["constants"])
    except (KeyError, ValueError):
        return str(law["name"]).replace("_", " ")
    return known.words([joint - 1 for joint in joints])


def place_words(where: Mapping[str, Any]) -> str:
    """What an effect acts on: ``joints 1-3, 6``, or a frame."""
    places = where["acts_on"]
    joints = where["joints"]
    if not joints and all(place.startswith("joint ") for place in places):
        joints = [int(place.removeprefix("joint ")) for place in places]
    if joints:
        return f"joint{'s' if len(joints) > 1 else ''} {ranges(joints)}"
    return ", ".join(places)


def ranges(numbers: Sequence[int]) -> str:
    """``1-3, 6`` for 1, 2, 3, 6."""
    parts: list[list[int]] = []
    for number in sorted(numbers):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(
        f"{part[0]}-{part[-1]}" if len(part) > 2 else ", ".join(str(number) for number in part) for part in parts
    )


def interval_95(entry: Mapping[str, Any]) -> tuple[str, str, str]:
    """Value, 95 % interval and unit of a parameter, with the digits that its standard error supports."""
    value, error = entry["value"], entry["standard_error"]
    factor, unit = _UNITS.get(entry["unit"], (1.0, entry["unit"]))
    if entry["unit"] == "m" and abs(value) >= _MILLIMETRES:
        factor, unit = 1e3, "mm"
    value, error = value * factor, error * factor
    half = _TWO_SIDED * error
    digits = 3
    if error > 0.0 and math.isfinite(error):
        digits = min(max(1 - math.floor(math.log10(error)), 0), _MOST_DIGITS)
    return f"{value:.{digits}f}", f"{value - half:.{digits}f} to {value + half:.{digits}f}", unit


def short_reason(reason: str) -> str:
    """Why an effect cannot be seen, without the words that the heading already states."""
    for prefix in ("not testable: ", "invisible: "):
        reason = reason.removeprefix(prefix)
    return reason.removesuffix(" under this plan")
