"""Loading of Leica's library LMF, and conversion of its value objects to numbers."""

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
    """LMF cannot be loaded: not Windows, no pythonnet, or no Leica library."""


@dataclass(frozen=True)
class Lmf:
    """The parts of LMF that the driver uses: two classes, enumerations by name, the base classes of its exceptions."""

    Connection: Callable[[], Any]
    TrackerFinder: Callable[[], Any]
    enumeration: Callable[[str], Any]
    exceptions: tuple[type[BaseException], ...]


def load_lmf(library: str) -> Lmf:
    """Load Leica's library through pythonnet. Raises ``LmfMissing`` with what is missing."""
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


def set_handler(owner: Any, name: str, handler: Callable[..., None], *, wanted: bool) -> None:
    """Add a handler to an event of LMF, or remove it; removing needs the object that was added."""
    event = getattr(owner, name)
    if wanted:
        event += handler
    else:
        event -= handler
    setattr(owner, name, event)


def unwrap(value: Any) -> Any:
    """Return the content of a value object, or a plain value unchanged; Leica's documents disagree on some members."""
    return value.Value if hasattr(value, "Value") else value


def si_factor(value: Any, kind: str) -> float:
    """Return the factor from a value object's unit to SI. Raises ``TrackerError`` for an unknown unit."""
    unit = str(value.UnitString).strip().replace("µ", "u").replace("μ", "u")
    if unit not in _UNITS[kind]:
        raise TrackerError(f"tracker: a {kind} comes in '{unit}', an unknown unit")
    return _UNITS[kind][unit]


def to_si(value: Any, kind: str) -> float:
    """Return a value object's number in SI units."""
    return float(value.Value) * si_factor(value, kind)


def precision_m(coordinate: Any) -> float:
    """Return the precision of a coordinate [m]: a number in the coordinate's unit, or a value object with its own."""
    precision = coordinate.Precision
    if hasattr(precision, "UnitString"):
        return to_si(precision, "length")
    return float(unwrap(precision)) * si_factor(coordinate, "length")


def error_number(error: object) -> int | None:
    """Return LMF's number of an error; None if it has none."""
    number = getattr(error, "Number", None)
    return None if number is None else int(unwrap(number))


def describe(message: object) -> str:
    """Format an exception, error, warning or precondition of LMF as one line: its four fields, or its text."""
    number = error_number(message)
    if number is None:
        return one_line(message)
    parts = [str(getattr(message, name, "") or "").strip() for name in ("Title", "Description", "Solution")]
    return f"{': '.join(part for part in parts if part)} (LMF {number})"


def one_line(error: object) -> str:
    """Format an error's text as one line of limited length."""
    return " ".join(str(error).split())[:300] or type(error).__name__
