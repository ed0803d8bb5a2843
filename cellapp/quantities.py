"""Physical quantities as people write them: a plain number is SI, a text carries its unit ("0.3 mm", "90 deg").

A number with the wrong kind of unit is refused with the units that would do; a plain number far outside what a robot
cell can mean is refused by the range of the field that holds it.
"""

from __future__ import annotations

import math
import re
from typing import Annotated

from pydantic import BeforeValidator

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
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "angular speed": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "angular acceleration": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180.0},
    "relative length": {"m/m": 1.0, "mm/m": 1e-3, "um/m": 1e-6, "ppm": 1e-6},
    "temperature": {"degC": 1.0},
}
_WRITTEN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S+)\s*")


def parse_quantity(kind: str, value: object) -> float:
    """A quantity of one kind in SI from a number or from a text with a unit.

    Raises
    ------
    ValueError
        If the text is no number with a unit of this kind, or the number is not finite.
    """
    units = _UNITS[kind]
    si_unit = next(iter(units))
    if isinstance(value, bool):
        raise ValueError(f"expected a {kind}, got {value}")
    if isinstance(value, int | float):
        number = float(value)
    elif isinstance(value, str):
        written = _WRITTEN.fullmatch(value)
        if written is None:
            raise ValueError(f"expected a {kind}: a number in {si_unit} or text such as '1.5 {si_unit}', got '{value}'")
        factor = units.get(written.group(2))
        if factor is None:
            raise ValueError(f"'{written.group(2)}' is not a unit of {kind}; use one of {', '.join(units)}")
        number = float(written.group(1)) * factor
    else:
        raise ValueError(f"expected a {kind} in {si_unit}, got {type(value).__name__}")
    if not math.isfinite(number):
        raise ValueError(f"expected a finite {kind}, got {value}")
    return number


def _quantity(kind: str) -> BeforeValidator:
    return BeforeValidator(lambda value: parse_quantity(kind, value))


Length = Annotated[float, _quantity("length")]
Angle = Annotated[float, _quantity("angle")]
Mass = Annotated[float, _quantity("mass")]
Time = Annotated[float, _quantity("time")]
AngularSpeed = Annotated[float, _quantity("angular speed")]
AngularAcceleration = Annotated[float, _quantity("angular acceleration")]
RelativeLength = Annotated[float, _quantity("relative length")]
Temperature = Annotated[float, _quantity("temperature")]
