"""Writing of settings into LMF's object tree. Every value is read back, because LMF ignores some writes silently.

``tracker`` is LMF's tracker object. No event handler may be subscribed during a write (see ``lmf``).
"""

from __future__ import annotations

import math
from typing import Any

from drivers.trackers.lmf_objects import Lmf, si_factor, unwrap
from drivers.trackers.lmf_options import LmfOptions
from drivers.trackers.protocol import Preparation, TrackerError

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
