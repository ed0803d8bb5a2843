"""Physical quantities in settings: a plain number is SI, a text carries its unit ("0.3 mm", "90 deg").

A unit of another quantity is refused, and the message lists the units that fit. The bounded types at the end also
refuse values that no robot cell has: usually a plain number in millimetres or degrees.
"""

from __future__ import annotations

import math
import re
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator

_UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": math.pi / 180.0,
        "arcmin": math.pi / 10800.0,
        "arcsec": math.pi / 648000.0,
    },
    "mass": {"kg": 1.0, "g": 1e-3},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "angular speed": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "angular acceleration": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180.0},
    "relative length": {"m/m": 1.0, "mm/m": 1e-3, "um/m": 1e-6, "ppm": 1e-6},
    "temperature": {"degC": 1.0},
}
_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d.]\S*)\s*")


def parse_quantity(kind: str, value: object) -> float:
    """Convert a number, or a text with a unit, to SI. ``kind`` is a key of the table of units, such as "length".

    Raises
    ------
    ValueError
        If the text is not a number with a unit of this kind, or the number is not finite.
    """
    units = _UNITS[kind]
    si_unit = next(iter(units))
    a_kind = f"an {kind}" if kind[0] == "a" else f"a {kind}"
    if isinstance(value, bool):
        raise ValueError(f"expected {a_kind}, got {value}")
    if isinstance(value, int | float):
        number = float(value)
    elif isinstance(value, str):
        match = _NUMBER_AND_UNIT.fullmatch(value)
        if match is None:
            raise ValueError(f"expected {a_kind}: a number in {si_unit} or text such as '1.5 {si_unit}', got '{value}'")
        factor = units.get(match.group(2))
        if factor is None:
            raise ValueError(f"'{match.group(2)}' is not a unit of {kind}; use one of {', '.join(units)}")
        number = float(match.group(1)) * factor
    else:
        raise ValueError(f"expected {a_kind} in {si_unit}, got {type(value).__name__}")
    if not math.isfinite(number):
        raise ValueError(f"expected a finite {kind}, got {value}")
    return number


def _quantity(kind: str) -> BeforeValidator:
    return BeforeValidator(lambda value: parse_quantity(kind, value))


Length = Annotated[float, _quantity("length")]
Angle = Annotated[float, _quantity("angle")]
Mass = Annotated[float, _quantity("mass")]
Speed = Annotated[float, _quantity("speed")]
Acceleration = Annotated[float, _quantity("acceleration")]
Time = Annotated[float, _quantity("time")]
AngularSpeed = Annotated[float, _quantity("angular speed")]
AngularAcceleration = Annotated[float, _quantity("angular acceleration")]
RelativeLength = Annotated[float, _quantity("relative length")]
Temperature = Annotated[float, _quantity("temperature")]

_ARM_SCALE_M = 10.0
"""Largest length of an arm's part: no link or tool of an industrial arm is longer."""
_CELL_SCALE_M = 100.0
"""Largest length in a cell: beyond the range of a laser tracker (80 m)."""


def _at_most(limit_m: float) -> AfterValidator:
    def check(value: float) -> float:
        if abs(value) > limit_m:
            raise ValueError(f"{value:g} m is beyond {limit_m:g} m; is it '{value:g} mm'?")
        return value

    return AfterValidator(check)


def _within_two_turns(value: float) -> float:
    if abs(value) > 4.0 * math.pi:
        raise ValueError(f"{value:g} rad is more than two turns; is it '{value:g} deg'?")
    return value


ArmLength = Annotated[Length, _at_most(_ARM_SCALE_M)]
CellLength = Annotated[Length, _at_most(_CELL_SCALE_M)]
Turn = Annotated[Angle, AfterValidator(_within_two_turns)]
