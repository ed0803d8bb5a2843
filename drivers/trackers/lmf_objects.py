"""LMF as Python sees it: loading Leica's library, and reading the value objects that it has in place of numbers."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from drivers.trackers.protocol import TrackerError

_UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "ft": 0.3048, "yd": 0.9144, "in": 0.0254},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
}


class LmfMissing(TrackerError):
    """LMF cannot be loaded here: no Windows, no pythonnet, or no Leica library."""


@dataclass(frozen=True)
class Lmf:
    """What is used of LMF: two classes, its enumerations by name, and the base of what it throws."""

    Connection: Callable[[], Any]
    TrackerFinder: Callable[[], Any]
    enumeration: Callable[[str], Any]
    thrown: tuple[type[BaseException], ...]


def load_lmf(library: str) -> Lmf:
    """Load Leica's library through pythonnet. Raises ``LmfMissing``, in words."""
    needs = "LMF needs Windows and the extra cellapp[lmf]"
    if sys.platform != "win32":
        raise LmfMissing(f"{needs}; this is {sys.platform}. The tracker's PC can serve it: 'cellapp tracker-bridge'")
    try:
        clr = importlib.import_module("clr")
        system = importlib.import_module("System")
    except (ImportError, RuntimeError) as error:
        raise LmfMissing(f"{needs}: pip install cellapp[lmf] ({error})") from error
    try:
        clr.AddReference(library)
        modules = [importlib.import_module(name) for name in ("LMF.Tracker", "LMF.Tracker.Enums", "LMF.Units")]
    except (system.Exception, ImportError) as error:
        raise LmfMissing(
            f"LMF cannot be loaded from '{library}': {one_line(error)}; give the path of LMF.Tracker.Connection.dll"
        ) from error

    def enumeration(name: str) -> Any:
        return next((getattr(module, name) for module in modules if hasattr(module, name)), None)

    return Lmf(modules[0].Connection, modules[0].TrackerFinder, enumeration, (system.Exception,))


def plain(value: Any) -> Any:
    """The value in a value object; a plain one as it is. Leica's documents do not agree which some members are."""
    return value.Value if hasattr(value, "Value") else value


def factor(value: Any, kind: str) -> float:
    """What a value object's number must be multiplied with to be SI. Raises ``TrackerError`` for a unit unknown."""
    unit = str(value.UnitString).strip().replace("µ", "u").replace("μ", "u")
    if unit not in _UNITS[kind]:
        raise TrackerError(f"tracker: a {kind} comes in '{unit}', which is not understood")
    return _UNITS[kind][unit]


def si(value: Any, kind: str) -> float:
    return float(value.Value) * factor(value, kind)


def precision_m(coordinate: Any) -> float:
    """Precision of a coordinate [m]: a number in the coordinate's unit, or a value object with its own."""
    precision = coordinate.Precision
    if hasattr(precision, "UnitString"):
        return si(precision, "length")
    return float(plain(precision)) * factor(coordinate, "length")


def error_number(error: object) -> int | None:
    number = getattr(error, "Number", None)
    return None if number is None else int(plain(number))


def told(message: object) -> str:
    """An exception, error, warning or precondition of LMF in one line: its four fields, or whatever text it has."""
    number = error_number(message)
    if number is None:
        return one_line(message)
    parts = [str(getattr(message, name, "") or "").strip() for name in ("Title", "Description", "Solution")]
    return f"{': '.join(part for part in parts if part)} (LMF {number})"


def one_line(error: object) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
