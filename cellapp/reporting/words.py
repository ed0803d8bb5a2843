"""Laws, places and units of effects in words and in the units that people use."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cellapp.reporting.table import Interval, Number
from cellapp.results import Estimate, LawRecord, Method, Place

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
"""Lengths from here on are shown in mm [m]."""
_TWO_SIDED = 1.959964
"""Half width of a 95 % interval in standard errors: quantile 0.975 of the normal distribution."""

_LAWS = {
    ("joint_compliance", "linear"): "in proportion to the torque, a stiffness each",
    ("joint_compliance", "two_slope"): "softer below a knee torque",
    ("backlash", "constant"): "the same after any motion",
    ("backlash", "saturating"): "taken up only by large steps",
    ("friction_windup", "load"): "in proportion to the load",
    ("friction_windup", "both"): "dry friction, and in proportion to the load",
    ("unsettled_measurement", "step"): "in proportion to the last step",
    ("unsettled_measurement", "creep"): "in proportion to the last step, dying away while the arm dwells",
    ("transmission_error", "two"): "two cycles a turn",
    ("transmission_error", "lines"): "single lines of the spectrum",
    ("transmission_error", "gear"): "two cycles a turn and the lines of a gear",
    ("transmission_error", "curve"): "a free curve for each joint",
    ("link_bending", "bending"): "bending under what the link carries",
    ("link_bending", "bending_torsion"): "bending and torsion under what the link carries",
    ("link_bending", "bending_own_weight"): "bending, own weight included",
    ("link_bending", "bending_torsion_own_weight"): "bending and torsion, own weight included",
    ("link_bending", "bending_torsion_free_weight"): "bending and torsion, own weight left free",
    ("pedestal_compliance", "isotropic"): "equally stiff both ways",
    ("pedestal_compliance", "tilt"): "a stiffness for each way",
    ("pedestal_compliance", "pivot"): "a stiffness for each way, about a point below the base",
    ("pedestal_coupling", "isotropic"): "in proportion to the other arm's moment, equal both ways",
    ("pedestal_coupling", "tilt"): "tilt in proportion to the other arm's moment, each way",
    ("pedestal_coupling", "general"): "tilt and shift in proportion to the other arm's moment",
    ("thermal_growth", "air"): "with the air temperature, all links alike",
    ("thermal_growth", "air_links"): "with the air temperature, link by link",
    ("thermal_growth", "joints"): "with the joints' temperatures, all links alike",
    ("thermal_growth", "joints_links"): "with the joints' temperatures, link by link",
    ("thermal_growth", "conduction"): "links follow air and joints with a lag, all alike",
    ("thermal_growth", "conduction_links"): "links follow air and joints with a lag, link by link",
    ("thermal_growth", "warm_up"): "warming up, all links alike",
    ("thermal_growth", "warm_up_links"): "warming up, link by link",
    ("joint_drift", "joint_temperature"): "with the joint's temperature",
    ("target_incidence", "radial"): "along the beam",
    ("target_incidence", "lateral"): "along and across the beam",
    ("tracker_angle_error", "orders"): "one and two cycles a turn of either angle",
}
_ANY_EFFECT = {
    "linear": "steadily over the run",
    "warm_up": "warming up",
    "quadratic": "over the run, with a bow",
    "onset": "at once",
}
_PLAIN = {
    "encoder_eccentricity": "one cycle a turn",
    "joint_axis_wobble": "two cycles a turn",
    "payload_compliance": "in proportion to the payload's torque",
    "tracker_scale": "in proportion to the distance",
    "tracker_distance_offset": "the same at any distance",
}


def law_words(effect: str, law: LawRecord, joints: Sequence[int] = ()) -> str:
    """A law in words, with the constants that were searched for, such as the knee torques of ``joints`` (from 1)."""
    name, constants = law.name, law.constants
    if effect == "unknown":
        channel, *variables = name.split("|")
        words = f"{channel} as a function of {' and '.join(variables)}"
        if "period_s" in constants:
            words += f", period {constants['period_s'] / 60.0:.3g} min"
        return words
    words = _LAWS.get((effect, name)) or _ANY_EFFECT.get(name) or _PLAIN.get(effect) or name.replace("_", " ")
    words = ", ".join([words, *_constants(constants)])
    knees = [f"{constants[f'knee{j}']:.3g} Nm for joint {j}" for j in joints if f"knee{j}" in constants]
    return f"{words}; knee at {', '.join(knees)}" if knees else words


def _constants(constants: Mapping[str, float]) -> list[str]:
    words = []
    for name, text, factor, unit in (
        ("onset_s", "{} after the run began", 1.0 / 3600.0, "h"),
        ("ratio", "ratio {}", 1.0, ""),
        ("lag_s", "lag {}", 1.0 / 60.0, "min"),
        ("width", "saturated beyond some {}", math.degrees(1.0), "deg"),
    ):
        if name in constants:
            words.append(text.format(f"{constants[name] * factor:.3g} {unit}".rstrip()))
    if "tau_s" in constants:
        tau = constants["tau_s"]
        words.append(f"time constant {tau / 60.0:.3g} min" if tau >= 120.0 else f"time constant {tau:.2g} s")
    return words


def place_words(where: Place) -> str:
    """Where an effect acts: ``joints 1-3, 6``, or the names of frames."""
    joints = where.joints
    if not joints and all(place.startswith("joint ") for place in where.acts_on):
        joints = tuple(int(place.removeprefix("joint ")) for place in where.acts_on)
    if joints:
        return f"joint{'s' if len(joints) > 1 else ''} {ranges(joints)}"
    return ", ".join(where.acts_on)


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


def interval_95(estimate: Estimate) -> tuple[Number, Interval | None, str]:
    """Value, 95 % interval and display unit of a parameter, with two significant digits of its standard error.

    The interval is None where there is no standard error.
    """
    factor, unit = _UNITS.get(estimate.unit, (1.0, estimate.unit))
    if estimate.unit == "m" and abs(estimate.value) >= _MILLIMETRES:
        factor, unit = 1e3, "mm"
    value = estimate.value * factor
    if estimate.standard_error is None:
        return Number(value, 3), None, unit
    error = estimate.standard_error * factor
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 9) if 0.0 < error < math.inf else 3
    half = _TWO_SIDED * error
    return Number(value, decimals), Interval(value - half, value + half, decimals), unit


def geometry_unit(unit: str) -> tuple[float, str]:
    """Factor and display unit of a geometric parameter stored in m or rad: mm and degrees."""
    return (1e3, "mm") if unit == "m" else (math.degrees(1.0), "deg")


STAGE_WORDS: Mapping[str, str] = {
    "nominal": "nominal",
    "geometry": "identified geometry",
    "network": "geometry and network",
    "effects": "geometry and effects",
}
METHOD_WORDS: Mapping[Method, str] = {
    "nominal": "the nominal cell",
    "method_1": "geometry alone",
    "method_2": "geometry and a network in the tracker frame",
    "proposed": "geometry and a network in the base frame",
    "effects": "geometry and effects",
}


def short_reason(reason: str) -> str:
    """The reason why an effect cannot be seen, without the words of the table heading."""
    for prefix in ("not testable: ", "invisible: "):
        reason = reason.removeprefix(prefix)
    return reason.removesuffix(" under this plan")
