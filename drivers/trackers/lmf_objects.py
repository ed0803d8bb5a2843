"""Loading of Leica's library LMF, and conversion of its value objects to numbers."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.lmf_options import LmfOptions
from drivers.trackers.protocol import Preparation, TrackerError

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
        raise LmfMissing(
            f"{needs}; this is {sys.platform}. The tracker's PC can serve it: 'cellapp tracker-bridge PROFILE'"
        )
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


class Handlers:
    """Handlers of LMF's events, added or removed together: part of the tracker (empty: itself), event, handler.

    Each handler is bound once, as it must be removed as the same object. pythonnet refuses to remove one that was not
    added.
    """

    def __init__(self, *handlers: tuple[str, str, Callable[..., None]]) -> None:
        self._handlers, self.added = handlers, False

    def set(self, tracker: Any, *, wanted: bool) -> None:
        """Add all handlers or remove them; harmless if that is so already."""
        if wanted == self.added:
            return
        self.added = False
        for part, name, handler in self._handlers:
            owner = getattr(tracker, part) if part else tracker
            event = getattr(owner, name)
            if wanted:
                event += handler
            else:
                event -= handler
            setattr(owner, name, event)
        self.added = wanted


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


# -- Writing of settings into LMF's object tree. Every value is read back, because LMF ignores some writes silently ---
#
# ``tracker`` is LMF's tracker object. No event handler may be subscribed during a write (see ``lmf``).


_PROFILES = {"accuracy": "StationaryMeasurementProfile", "time": "CustomStationaryMeasurementProfile"}
_MANUAL_AIR = ("ManualTemperature", "ManualPressure", "ManualHumidity")


def apply_settings(lmf: Lmf, tracker: Any, use: LmfOptions, preparation: Preparation) -> str:
    """Write all settings that LMF forgets at a connect, and the few it keeps; return the selected reflector's name.

    Raises ``TrackerError`` for a setting that LMF does not accept, ``ValueError`` for one that the tracker does not
    have.
    """
    for path, kind, name in (
        (("Settings", "CoordinateType"), "ECoordinateType", "Cartesian"),
        (("Settings", "RotationType"), "ERotationType", "Quaternion"),
        (("Settings", "Units", "LengthUnit"), "ELengthUnit", "Meter"),
        (("Settings", "Units", "AngleUnit"), "EAngleUnit", "Radian"),
        (("Settings", "Units", "TemperatureUnit"), "ETemperatureUnit", "Celsius"),
        (("Settings", "Units", "PressureUnit"), "EPressureUnit", "HPascal"),
    ):
        set_enumeration(lmf, tracker, path, kind, name)
    if unwrap(tracker.Measurement.MeasurementInProgress):
        tracker.Measurement.StopMeasurement()  # the profile cannot be changed during a measurement
    profile = _profile(tracker, _PROFILES[use.stationary])
    profile.Select()
    if use.stationary == "accuracy":
        set_enumeration(lmf, profile, ("Accuracy",), "EAccuracy", preparation.accuracy.capitalize())
        set_value(profile, "TwoFace", False)
    reflector = _select_reflector(tracker, preparation.reflector)
    set_value(tracker.PowerLock, "UsePowerLock", use.power_lock)
    if use.search_radius is not None:
        set_quantity(tracker.TargetSearch.Radius, "length", use.search_radius)
    _set_air(lmf, tracker.MeteoStation, preparation)
    level = tracker.InclinationSensor
    if level is not None and not use.gravity:
        set_value(level, "InclinedToGravity", False)  # LMF keeps it from one connect to the next
    return reflector


def start_level_monitoring(tracker: Any) -> None:
    """Level the tracker and monitor its tilt. Raises ``ValueError`` if it has no level."""
    level = tracker.InclinationSensor
    if level is None:
        raise ValueError("tracker: it has no level; turn 'gravity' off")
    level.GetInclinationToGravity()
    set_value(level, "InclinedToGravity", True)
    set_value(level.Monitoring, "Active", True)
    level.Monitoring.Reset()


def set_enumeration(lmf: Lmf, root: Any, path: tuple[str, ...], kind: str, name: str) -> None:
    """Set an enumeration, plain or in a value object, to the member ``name``."""

    def holder() -> tuple[Any, str, Any]:
        owner = root
        for step in path[:-1]:
            owner = getattr(owner, step)
        value = getattr(owner, path[-1])
        return (value, "Value", value.Value) if hasattr(value, "Value") else (owner, path[-1], value)

    owner, attribute, current = holder()
    members = type(current) if hasattr(type(current), name) else lmf.enumeration(kind)
    if not hasattr(members, name):
        raise TrackerError(f"tracker: this LMF has no {kind}.{name}, which {'.'.join(path)} needs")
    wanted = getattr(members, name)
    if int(current) == int(wanted):
        return
    try:
        setattr(owner, attribute, wanted)
    except TypeError:  # some value objects accept only the number
        setattr(owner, attribute, int(wanted))
    if int(holder()[2]) != int(wanted):
        raise TrackerError(f"tracker: {'.'.join(path)} does not take {name}; it stays at {holder()[2]}")


def set_value(owner: Any, name: str, wanted: object) -> None:
    """Set a value object, or a plain property."""
    value = getattr(owner, name)
    if unwrap(value) != wanted:
        if hasattr(value, "Value"):
            value.Value = wanted
        else:
            setattr(owner, name, wanted)
        found = unwrap(getattr(owner, name))
        if found != wanted and not (isinstance(wanted, float) and math.isclose(found, wanted, rel_tol=1e-6)):
            raise TrackerError(f"tracker: {name} does not take {wanted}; it stays at {found}")


def set_quantity(value: Any, kind: str, wanted_si: float) -> None:
    """Set a value object to a value in SI units, converted to the unit that the object reports."""
    value.Value = wanted_si / si_factor(value, kind)


def _profile(tracker: Any, name: str) -> Any:
    profiles = list(tracker.Measurement.Profiles)
    for profile in profiles:
        if type(profile).__name__ == name:
            return profile
    known = ", ".join(type(profile).__name__ for profile in profiles)
    raise ValueError(f"tracker: it has no {name}, only {known}; change 'stationary'")


def _select_reflector(tracker: Any, name: str) -> str:
    """Select a reflector by class, name or product name; LMF cannot detect which type is mounted."""
    if name:
        targets = [target for target in tracker.Targets if unwrap(target.IsSelectable)]
        names = [[type(t).__name__, str(t.Name), str(t.ProductName)] for t in targets]
        wanted = name.casefold()
        exact = [t for t, own in zip(targets, names) if wanted in (n.casefold() for n in own)]
        partial = [t for t, own in zip(targets, names) if any(wanted in n.casefold() for n in own)]
        matches = exact or partial
        if len(matches) != 1:
            which = "several" if matches else "none"
            known = ", ".join(f"'{own[1]}' ({own[0]})" for own in names)
            raise ValueError(f"tracker: of its reflectors {which} matches '{name}'; they are {known}")
        matches[0].Select()
        chosen = tracker.Targets.PreSelected
        if chosen is None or str(chosen.Name) != str(matches[0].Name):
            raise TrackerError(f"tracker: it did not take the reflector '{name}'; is a probe locked?")
    chosen = tracker.Targets.PreSelected
    return "" if chosen is None else str(chosen.Name)


def _set_air(lmf: Lmf, station: Any, preparation: Preparation) -> None:
    """Set manual air data, or use the tracker's own weather station."""
    given = (preparation.temperature_c, preparation.pressure_hpa, preparation.humidity_percent)
    if any(value is None for value in given) and any(value is not None for value in given):
        raise ValueError("tracker: give air temperature, pressure and humidity together, or none of them")
    manual = given[0] is not None
    set_enumeration(lmf, station, ("Source",), "EMeteoSource", "ManualMeteo" if manual else "LiveMeteo")
    if manual:
        for name, value in zip(_MANUAL_AIR, given):
            set_value(station, name, value)


def laser_and_stand(tracker: Any) -> list[str]:
    """Return what the laser and the stand lack for measuring, as sentences."""
    unmet = []
    laser = tracker.Laser
    if laser is not None and not unwrap(laser.IsOn):
        unmet.append("its laser is off: switch it on and let it warm up")
    elif laser is not None and not unwrap(laser.IsLaserWarmedUp):
        unmet.append("its laser is warming up")
    if not unwrap(tracker.QuickRelease):
        unmet.append("its quick release is open: close it")
    return unmet


# -- Conversion of LMF's stationary measurement, and its accuracy, which LMF does not report --------------------------


_AIR_RANGES = {"Temperature": (-40.0, 85.0), "Pressure": (500.0, 1200.0), "Humidity": (0.0, 100.0)}
"""Ranges of plausible air [degC, hPa, %], in the units that ``apply_settings`` selects."""
_QUATERNION = ("Value0", "Value1", "Value2", "Value3")
"""A probe's rotation, scalar first."""
_UNIT_LENGTH = 1e-3
"""Tolerance of a quaternion's length."""
_TICKS_1970 = 621_355_968_000_000_000
""".NET's timestamp of the start of 1970, in ticks of 100 ns since the year 1."""


@dataclass(frozen=True)
class ErrorLaw:
    """Maximum permissible errors ``constant + proportional * distance`` [m, m/m], across the beam and along it.

    Half of a maximum permissible error is taken as one standard deviation: the maker calls half of it typical.
    ``rotation`` is the maximum permissible error of a probe about each axis [rad]; Leica states 0.01 degrees for a
    T-Mac.
    """

    transverse: tuple[float, float] = (15e-6, 6e-6)
    range: tuple[float, float] = (10e-6, 0.3e-6)
    rotation: float = math.radians(0.01)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of a measured rotation about each axis [rad]."""
        return 0.5 * self.rotation

    def covariance(self, p_M: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) [m^2] of a point (3,) [m] in the axes of M."""
        distance = float(np.linalg.norm(p_M))
        across = 0.5 * (self.transverse[0] + self.transverse[1] * distance)
        along = 0.5 * (self.range[0] + self.range[1] * distance)
        beam = np.outer(p_M, p_M) / distance**2
        return across**2 * (np.eye(3) - beam) + along**2 * beam


def read_position(lmf: Lmf, position: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the point (3,) and the precision of each coordinate (3,) [m]. Raises ``TrackerError`` if invalid."""
    kind = unwrap(position.CoordinateType)
    if str(kind) != "Cartesian" and int(kind) != int(lmf.enumeration("ECoordinateType").Cartesian):
        raise TrackerError(f"tracker: the point comes in {kind} coordinates; another program changed that")
    coordinates = (position.Coordinate1, position.Coordinate2, position.Coordinate3)
    p_M = np.array([to_si(coordinate, "length") for coordinate in coordinates])
    precision_M = np.array([precision_m(coordinate) for coordinate in coordinates])
    if not (np.isfinite(p_M).all() and np.isfinite(precision_M).all() and np.linalg.norm(p_M) > 0.0):
        raise TrackerError("tracker: it reports a point that is not valid")
    if unwrap(position.IsFace2):
        raise TrackerError("tracker: it measured in face 2")
    return p_M, precision_M


def read_rotation(lmf: Lmf, result: Any) -> NDArray[np.float64] | None:
    """Return the orientation of a probe in M, a unit quaternion (4,), scalar first; None for a reflector.

    Raises ``TrackerError`` if it is not a unit quaternion.
    """
    rotation = getattr(result, "Rotation", None)
    if rotation is None:
        return None
    kind = unwrap(rotation.RotationType)
    if str(kind) != "Quaternion" and int(kind) != int(lmf.enumeration("ERotationType").Quaternion):
        raise TrackerError(f"tracker: the probe's rotation comes as {kind}; another program changed that")
    if missing := [name for name in _QUATERNION if not hasattr(rotation, name)]:
        has = ", ".join(name for name in dir(rotation) if name[:1].isupper())
        raise TrackerError(f"tracker: the probe's rotation has no {', '.join(missing)} in this LMF, only {has}")
    quaternion = np.array([float(unwrap(getattr(rotation, name))) for name in _QUATERNION])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) < _UNIT_LENGTH:  # true also for NaN
        raise TrackerError(f"tracker: the probe's rotation is a quaternion of length {length:.4g}, not one")
    return quaternion / length


def read_air(result: Any) -> tuple[dict[str, float | None], list[str]]:
    """Return the air of the refraction correction, and warnings about implausible values and LMF's flags."""
    air: dict[str, float | None] = {}
    warnings = []
    for name, (low, high) in _AIR_RANGES.items():
        value = float(unwrap(getattr(result, name)))
        air[name] = value if low <= value <= high else None
        if air[name] is None:
            warnings.append(f"{name.lower()} applied to the point reads {value:g}, which is not plausible")
    flags = str(unwrap(result.Info.FlagsWithWarnings))
    if flags != "AllOk":
        warnings.append(flags)
    return air, warnings


def tracker_time_s(result: Any) -> float | None:
    """Return the timestamp of a result on the tracker's clock, since 1970 [s]; None if it has none."""
    ticks = int(result.TimeStamp.Ticks)
    return (ticks - _TICKS_1970) * 1e-7 if ticks else None
