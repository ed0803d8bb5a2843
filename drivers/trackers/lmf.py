"""A Leica AT960 (or its kin) through Leica's LMF, in this process, on the Windows PC that the tracker is wired to.

Written from Leica's documents and from what other programs do; neither LMF nor a tracker was at hand, so the tests run
against a stand-in with LMF's names and rules. Whatever those sources leave open is a setting, is read from the objects
themselves (units, kinds of enumerations), or is refused.

Threads. One thread of ours speaks with LMF, and every wait for it ends: a call into LMF that hangs costs that thread
and not the program. LMF delivers its events one by one on a thread of its own, and a command that causes one waits
until its handlers have returned: ours only note. pythonnet keeps Python's lock while a *property* is read or written,
unlike with a method; a handler that LMF waits for meanwhile could never run. Hence nobody listens while settings are
written.
"""

from __future__ import annotations

import contextlib
import math
import operator
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.trackers.lmf_calls import Commands
from drivers.trackers.lmf_objects import Lmf, error_number, factor, load_lmf, plain, precision_m, si, told
from drivers.trackers.lmf_settings import DEFAULT_LIBRARY, LmfSettings
from drivers.trackers.protocol import (
    Face,
    Inclination,
    NotReady,
    Point,
    Preparation,
    TargetLost,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TwoFace,
    Unstable,
    WrongTarget,
)

Vector = NDArray[np.float64]
_T = TypeVar("_T")

MEASURING_S: Mapping[str, float] = MappingProxyType({"fast": 2.0, "standard": 12.0, "precise": 12.0})
"""Leica's recommended time limits of a stationary measurement on the AT9x0, by accuracy [s]."""
OTHER_PROFILE_S = 7.0
CONNECTING_S = 60.0
INITIALISING_S = 60.0
"""Leica allows 30 s; its simulator is slow on purpose."""
LEVELLING_S = 180.0
FINDING_S = 30.0

_AS_IT_COMES = Preparation()
_IN_USE = 10011
_TICKS_1970 = 621_355_968_000_000_000  # of 100 ns, since the year 1
_MOST_MESSAGES = 200
_POINTING, _MEASURING, _TURNING = "pointing and searching", "measuring", "turning to face 2"
_PROFILES = {"accuracy": "StationaryMeasurementProfile", "time": "CustomStationaryMeasurementProfile"}
_AIR = {"Temperature": (-40.0, 85.0), "Pressure": (500.0, 1200.0), "Humidity": (0.0, 100.0)}


@dataclass(frozen=True)
class ErrorLaw:
    """Maximum permissible errors ``constant + proportional * distance`` [m, m/m], across the beam and along it.

    Half of one is taken for a standard deviation, as the maker calls half of it typical.
    """

    transverse: tuple[float, float] = (15e-6, 6e-6)
    range: tuple[float, float] = (10e-6, 0.3e-6)

    def covariance(self, p_M: Vector) -> Vector:
        """Covariance (3, 3) [m^2] of a point (3,) [m]: angles and range apart, turned into the axes of M."""
        distance = float(np.linalg.norm(p_M))
        across = 0.5 * (self.transverse[0] + self.transverse[1] * distance)
        along = 0.5 * (self.range[0] + self.range[1] * distance)
        beam = np.outer(p_M, p_M) / distance**2
        return across**2 * (np.eye(3) - beam) + along**2 * beam


@dataclass(frozen=True)
class FoundTracker:
    """A tracker that answers in the network."""

    address: str
    model: str
    serial: str


def find_trackers(library: str = DEFAULT_LIBRARY, load: Callable[[str], Lmf] = load_lmf) -> list[FoundTracker]:
    """Trackers in the networks of this computer. Raises ``LmfMissing``, ``TrackerTimeout``, ``TrackerError``."""

    def look() -> list[FoundTracker]:
        lmf = load(library)
        try:
            finder = lmf.TrackerFinder()
            finder.Refresh()
            return [FoundTracker(str(t.IPAddress), str(t.Type), str(t.SerialNumber)) for t in finder.Trackers]
        except lmf.thrown as error:
            raise TrackerError(f"tracker: LMF could not look for trackers: {told(error)}") from error

    commands = Commands()
    try:
        return commands.call("looking for trackers", look, FINDING_S)
    finally:
        commands.close()


# -- the tracker ------------------------------------------------------------------------------------------------------


class LmfTracker:
    """One tracker of Leica's through LMF."""

    def __init__(
        self,
        settings: LmfSettings,
        preparation: Preparation = _AS_IT_COMES,
        load: Callable[[str], Lmf] = load_lmf,
        law: ErrorLaw = ErrorLaw(),
    ) -> None:
        """Nothing is opened yet. ``preparation`` is applied at every connect, as LMF forgets its settings.

        ``law`` is the accuracy of the tracker: LMF reports no covariance.
        """
        self._use = settings
        self._law = law
        self._preparation = preparation
        self._load = load
        self._lmf: Lmf | None = None
        self._tracker: Any = None
        self._commands: Commands | None = None
        self._messages: deque[str] = deque(maxlen=_MOST_MESSAGES)
        self._news: deque[str] = deque(maxlen=_MOST_MESSAGES)
        self._gone = ""
        self._listening = False
        self._reflector = ""
        self._averages_s: float | None = None
        # Kept, so that what is taken off an event later is the very object that was put on it.
        self._listeners = (("Disconnected", self._on_gone), ("ErrorArrived", self._on_message),
                           ("WarningArrived", self._on_message))  # fmt: skip

    # -- link ----------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect, check who it is, and apply the settings. The head does not move.

        Raises
        ------
        LmfMissing
            If LMF is not here.
        TrackerRefused
            If another program holds the tracker.
        TrackerLinkLost
            If it cannot be reached.
        TrackerError, NotReady, ValueError
            If it is another tracker, or does not take a setting.
        """
        self.disconnect()
        self._gone = ""
        commands = self._commands = Commands()
        try:
            commands.call("connecting", partial(self._open, commands), max(CONNECTING_S, self._use.timeout))
        except BaseException:
            self.disconnect()
            raise

    def _open(self, commands: Commands) -> None:
        lmf = self._lmf = self._load(self._use.library)
        try:
            tracker = lmf.Connection().Connect(self._use.address)
        except lmf.thrown as error:
            if error_number(error) == _IN_USE:
                raise TrackerRefused(
                    f"tracker {self._use.address}: another program or connection holds it: {told(error)}"
                ) from error
            raise TrackerLinkLost(f"tracker {self._use.address}: no connection: {told(error)}") from error
        if tracker is None:
            raise TrackerLinkLost(f"tracker {self._use.address}: no connection, and LMF does not tell why")
        if self._commands is not commands:  # nobody waits any more; a tracker left connected could not be had again
            tracker.Disconnect()
            return
        self._tracker, self._listening = tracker, False
        serial = str(tracker.SerialNumber)
        if self._use.serial and serial != self._use.serial:
            raise TrackerError(
                f"tracker {self._use.address}: its serial number is {serial}, the settings name {self._use.serial};"
                " check address and serial"
            )
        with self._translated("settings"):
            self._apply(tracker, self._preparation)
        self._listen(tracker)

    def disconnect(self) -> None:
        """Let the tracker go; harmless when not connected. A call that hangs is left behind."""
        commands, tracker = self._commands, self._tracker
        self._commands = self._tracker = None
        self._averages_s = None
        if commands is None:
            return
        if tracker is not None:
            with contextlib.suppress(TrackerError):  # it is being let go of, whatever it says
                commands.call("disconnecting", partial(self._close, tracker), self._use.timeout)
        commands.close()

    def _close(self, tracker: Any) -> None:
        with self._translated("disconnecting"):
            self._deafen(tracker)
            tracker.Disconnect()

    def identify(self) -> TrackerIdentity:
        """Who the tracker is, its firmware, and whether LMF only simulates it."""
        return self._ask("identifying", self._identify)

    def _identify(self, tracker: Any) -> TrackerIdentity:
        model = str(tracker.ProductName or tracker.Name or "tracker")
        if self._use.simulated:
            model += " (simulated by LMF)"
        return TrackerIdentity(model, str(tracker.SerialNumber), f"firmware {tracker.InstalledFirmware}")

    def notices(self) -> list[str]:
        """What the tracker has told by itself, and what is not right with it but does not keep it from measuring."""
        return [*self._ask("looking at the tracker", self._look_for_notices), *self._messages]

    def _look_for_notices(self, tracker: Any) -> list[str]:
        notices = []
        if not plain(tracker.IsCompatibleWithInstalledFirmware):
            notices.append(
                f"its firmware is {tracker.InstalledFirmware}, this LMF was made for {tracker.ExpectedFirmware}"
            )
        if tracker.Compensations.Selected is None:
            notices.append("no compensation is selected")
        return notices + self._air_notices(tracker)

    def _air_notices(self, tracker: Any) -> list[str]:
        if self._preparation.temperature_c is None and not plain(tracker.MeteoStation.IsAirSensorConnected):
            return ["its air sensor is not connected"]
        return []

    def others(self) -> str:
        """Which trackers LMF finds in the networks of this computer, in words: for whoever looks for this one."""
        try:
            found = find_trackers(self._use.library, self._load)
        except TrackerError as error:
            return str(error)
        seen = ", ".join(f"{t.model} {t.serial} at {t.address}" for t in found)
        return f"LMF sees {seen}" if seen else "LMF sees no tracker in the networks of this computer"

    # -- settings ------------------------------------------------------------------------------------------------------

    def prepare(self, settings: Preparation) -> None:
        """Initialise and level where needed (the head moves), and apply ``settings``, now and at every connect.

        Raises ``NotReady`` with all that is unmet, ``ValueError`` for what this tracker does not have.
        """
        self._begin()
        if self._ask("looking at the tracker", self._needs_initialising):
            self._ask("initialising", lambda tracker: tracker.Initialize(), INITIALISING_S, heeds_halt=True)
        self._ask("settings", partial(self._prepare, settings=settings))
        self._preparation = settings
        if self._use.gravity:
            self._ask("levelling", self._level, LEVELLING_S, heeds_halt=True)
        unmet = self.unmet()
        if unmet:
            raise NotReady(f"tracker: not ready to measure: {'; '.join(unmet)}")

    def _needs_initialising(self, tracker: Any) -> bool:
        """LMF's numbers for "not initialised" are not public: anything it misses while the laser is ready counts."""
        if self._laser_and_stand(tracker):
            return False
        return bool(self._preconditions(tracker))

    def _prepare(self, tracker: Any, settings: Preparation) -> None:
        self._deafen(tracker)
        try:
            self._apply(tracker, settings)
        finally:
            self._listen(tracker)

    def _apply(self, tracker: Any, settings: Preparation) -> None:
        """All that LMF forgets at a connect, and the few things it keeps, read back one by one."""
        for path, kind, name in (
            (("Settings", "CoordinateType"), "ECoordinateType", "Cartesian"),
            (("Settings", "Units", "LengthUnit"), "ELengthUnit", "Meter"),
            (("Settings", "Units", "AngleUnit"), "EAngleUnit", "Radian"),
            (("Settings", "Units", "TemperatureUnit"), "ETemperatureUnit", "Celsius"),
            (("Settings", "Units", "PressureUnit"), "EPressureUnit", "HPascal"),
        ):
            self._choose(tracker, path, kind, name)
        if plain(tracker.Measurement.MeasurementInProgress):
            tracker.Measurement.StopMeasurement()  # changing the profile of a running one fails
        profile = self._profile(tracker)
        profile.Select()
        if self._use.stationary == "accuracy":
            self._choose(profile, ("Accuracy",), "EAccuracy", settings.accuracy.capitalize())
            self._set(profile, "TwoFace", False)
        self._averages_s = None
        self._reflector = self._select_reflector(tracker, settings.reflector)
        self._set(tracker.PowerLock, "UsePowerLock", self._use.power_lock)
        if self._use.search_radius is not None:
            self._set_quantity(tracker.TargetSearch.Radius, "length", self._use.search_radius)
        self._apply_air(tracker, settings)
        level = tracker.InclinationSensor
        if level is not None and not self._use.gravity:
            self._set(level, "InclinedToGravity", False)  # LMF keeps it from one connect to the next

    def _profile(self, tracker: Any) -> Any:
        wanted = _PROFILES[self._use.stationary]
        profiles = list(tracker.Measurement.Profiles)
        for profile in profiles:
            if type(profile).__name__ == wanted:
                return profile
        known = ", ".join(type(profile).__name__ for profile in profiles)
        raise ValueError(f"tracker: it has no {wanted}, only {known}; change 'stationary'")

    def _select_reflector(self, tracker: Any, name: str) -> str:
        """Select by class, name or product name; which reflector hangs there only people know."""
        if name:
            targets = [target for target in tracker.Targets if plain(target.IsSelectable)]
            called = [[type(t).__name__, str(t.Name), str(t.ProductName)] for t in targets]
            wanted = name.casefold()
            exact = [t for t, names in zip(targets, called) if wanted in (n.casefold() for n in names)]
            partly = [t for t, names in zip(targets, called) if any(wanted in n.casefold() for n in names)]
            fitting = exact or partly
            if len(fitting) != 1:
                which = "several" if fitting else "none"
                known = ", ".join(f"'{names[1]}' ({names[0]})" for names in called)
                raise ValueError(f"tracker: of its reflectors {which} fits '{name}'; they are {known}")
            fitting[0].Select()
            chosen = tracker.Targets.PreSelected
            if chosen is None or str(chosen.Name) != str(fitting[0].Name):
                raise TrackerError(f"tracker: it did not take the reflector '{name}'; is a probe locked?")
        chosen = tracker.Targets.PreSelected
        return "" if chosen is None else str(chosen.Name)

    def _apply_air(self, tracker: Any, settings: Preparation) -> None:
        given = (settings.temperature_c, settings.pressure_hpa, settings.humidity_percent)
        if any(value is None for value in given) and any(value is not None for value in given):
            raise ValueError("tracker: give air temperature, pressure and humidity together, or none of them")
        station = tracker.MeteoStation
        if given[0] is None:
            self._choose(station, ("Source",), "EMeteoSource", "LiveMeteo")
            return
        self._choose(station, ("Source",), "EMeteoSource", "ManualMeteo")
        for name, value in zip(_AIR, given):
            self._set(station, f"Manual{name}", value)

    def _level(self, tracker: Any) -> None:
        level = tracker.InclinationSensor
        if level is None:
            raise ValueError("tracker: it has no level; turn 'gravity' off")
        self._deafen(tracker)
        try:
            level.GetInclinationToGravity()
            self._set(level, "InclinedToGravity", True)
            self._set(level.Monitoring, "Active", True)
            level.Monitoring.Reset()
        finally:
            self._listen(tracker)

    def _choose(self, root: Any, path: tuple[str, ...], kind: str, name: str) -> None:
        """Set an enumeration, plain or in a value object, by its member's name, and read it back from ``root``."""

        def holder() -> tuple[Any, str, Any]:
            owner = root
            for step in path[:-1]:
                owner = getattr(owner, step)
            value = getattr(owner, path[-1])
            return (value, "Value", value.Value) if hasattr(value, "Value") else (owner, path[-1], value)

        owner, attribute, current = holder()
        members = type(current) if hasattr(type(current), name) else self._enumeration(kind)
        if not hasattr(members, name):
            raise TrackerError(f"tracker: this LMF has no {kind}.{name}, which {'.'.join(path)} needs")
        wanted = getattr(members, name)
        if int(current) == int(wanted):
            return
        try:
            setattr(owner, attribute, wanted)
        except TypeError:  # some value objects take the number
            setattr(owner, attribute, int(wanted))
        if int(holder()[2]) != int(wanted):
            raise TrackerError(f"tracker: {'.'.join(path)} does not take {name}; it stays at {holder()[2]}")

    def _enumeration(self, name: str) -> Any:
        return None if self._lmf is None else self._lmf.enumeration(name)

    @staticmethod
    def _set(owner: Any, name: str, wanted: object) -> None:
        """Set a value object, or a plain property, and read it back."""
        value = getattr(owner, name)
        if plain(value) != wanted:
            if hasattr(value, "Value"):
                value.Value = wanted
            else:
                setattr(owner, name, wanted)
            found = plain(getattr(owner, name))
            if found != wanted and not (isinstance(wanted, float) and math.isclose(found, wanted, rel_tol=1e-6)):
                raise TrackerError(f"tracker: {name} does not take {wanted}; it stays at {found}")

    @staticmethod
    def _set_quantity(value: Any, kind: str, wanted_si: float) -> None:
        """Set a value object in the unit that it says it has."""
        value.Value = wanted_si / factor(value, kind)

    # -- events --------------------------------------------------------------------------------------------------------

    def _listen(self, tracker: Any) -> None:
        for name, handler in self._listeners:
            setattr(tracker, name, operator.iadd(getattr(tracker, name), handler))
        self._listening = True

    def _deafen(self, tracker: Any) -> None:
        if not self._listening:
            return  # pythonnet refuses to take off what was not put on
        self._listening = False
        for name, handler in self._listeners:
            setattr(tracker, name, operator.isub(getattr(tracker, name), handler))

    def _on_gone(self, *arguments: Any) -> None:
        cause = arguments[-1] if arguments else None
        self._gone = "LMF reports the connection closed" + (f": {told(cause)}" if cause is not None else "")

    def _on_message(self, *arguments: Any) -> None:
        if arguments:
            self._news.append(told(arguments[-1]))

    # -- readiness -----------------------------------------------------------------------------------------------------

    def unmet(self) -> list[str]:
        """What keeps it from measuring. That nothing is locked yet does not count: measuring begins with pointing."""
        return self._ask("looking at the tracker", self._unmet)

    def _unmet(self, tracker: Any) -> list[str]:
        return self._laser_and_stand(tracker) + self._preconditions(tracker)

    @staticmethod
    def _laser_and_stand(tracker: Any) -> list[str]:
        unmet = []
        laser = tracker.Laser
        if laser is not None and not plain(laser.IsOn):
            unmet.append("its laser is off: switch it on and let it warm up")
        elif laser is not None and not plain(laser.IsLaserWarmedUp):
            unmet.append("its laser is warming up")
        if not plain(tracker.QuickRelease):
            unmet.append("its quick release is open: close it")
        return unmet

    def _preconditions(self, tracker: Any) -> list[str]:
        locked = tracker.Targets.Selected is not None
        unmet = []
        for precondition in tracker.Measurement.Status.Preconditions:
            text = told(precondition)
            if locked or not any(word.casefold() in text.casefold() for word in self._use.target_words):
                unmet.append(text)
        return unmet

    def inclination(self) -> Inclination | None:
        """The monitored level; None where there is none or ``gravity`` is off."""
        return self._ask("reading the level", self._inclination)

    def _inclination(self, tracker: Any) -> Inclination | None:
        level = tracker.InclinationSensor
        if level is None or not plain(level.Monitoring.Active):
            return None
        tilt = level.CurrentInclinationToGravity
        initial, current = level.Monitoring.Initial, level.Monitoring.Current
        return Inclination(
            tilt_rad=(si(tilt.InclinationRotX, "angle"), si(tilt.InclinationRotY, "angle")),
            drift_rad=math.hypot(
                si(current.X, "angle") - si(initial.X, "angle"), si(current.Y, "angle") - si(initial.Y, "angle")
            ),
            threshold_rad=si(level.Monitoring.Threshold, "angle"),
        )

    # -- measuring -----------------------------------------------------------------------------------------------------

    def measure(self, expected_M: Vector, averaging_s: float) -> Point:
        """Point at ``expected_M`` (3,) [m], lock the SMR there and measure it, in face 1. Raises as the protocol says.

        How long is averaged the tracker decides, unless ``stationary`` is "time".
        """
        expected = self._asked(expected_M, averaging_s)
        return self._measure(expected, averaging_s)

    def measure_two_face(self, expected_M: Vector, averaging_s: float) -> TwoFace:
        """Measure in face 1, turn over, measure in face 2, turn back whatever happens."""
        expected = self._asked(expected_M, averaging_s)
        first = self._measure(expected, averaging_s)
        try:
            self._ask(_TURNING, partial(self._turn, face=2), heeds_halt=True)
            second = self._average(expected, averaging_s, 2)
        finally:
            self._ask("turning to face 1", partial(self._turn, face=1))
        return TwoFace(first, second)

    def halt(self) -> None:
        """The measurement under way raises ``Halted``. LMF finishes its call by itself; the next one waits for that."""
        commands = self._commands
        if commands is not None:
            commands.halt()

    def _asked(self, expected_M: Vector, averaging_s: float) -> Vector:
        if not 0.0 < averaging_s < math.inf:
            raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
        expected = np.asarray(expected_M, dtype=np.float64)
        if expected.shape != (3,) or not np.isfinite(expected).all():
            raise ValueError("tracker: the expected point must be three finite coordinates in metres")
        self._begin()
        return expected

    def _measure(self, expected: Vector, averaging_s: float) -> Point:
        self._ask(_POINTING, partial(self._lock, expected=expected, averaging_s=averaging_s), heeds_halt=True)
        return self._average(expected, averaging_s, 1)

    def _lock(self, tracker: Any, expected: Vector, averaging_s: float) -> None:
        unmet = self._unmet(tracker)
        if unmet:
            raise NotReady(f"tracker: not ready to measure: {'; '.join(unmet)}")
        if self._use.stationary == "time" and averaging_s != self._averages_s:
            self._set_time(tracker, averaging_s)
        if not plain(tracker.Face.IsFace1):
            tracker.Face.Change()
        found = tracker.PositionTo(True, False, *(float(value) for value in expected))
        if found is None or tracker.Targets.Selected is None:
            raise TargetLost(f"tracker: no SMR found near ({', '.join(f'{v:.3f}' for v in expected)}) m")
        if self._reflector and str(found.Name) != self._reflector:
            raise WrongTarget(f"tracker: it locked a '{found.Name}' where a '{self._reflector}' was expected")

    def _set_time(self, tracker: Any, averaging_s: float) -> None:
        self._deafen(tracker)
        try:
            self._set_quantity(tracker.Measurement.Profiles.Selected.Time, "time", averaging_s)
        finally:
            self._listen(tracker)
        self._averages_s = averaging_s

    def _turn(self, tracker: Any, face: Face) -> None:
        if bool(plain(tracker.Face.IsFace1)) != (face == 1):
            tracker.Face.Change()
            if bool(plain(tracker.Face.IsFace1)) != (face == 1):
                raise TrackerError(f"tracker: it does not turn to face {face}")
        if face == 2 and tracker.Targets.Selected is None:
            raise TargetLost("tracker: it did not find the SMR again in face 2")

    def _average(self, expected: Vector, averaging_s: float, face: Face) -> Point:
        if self._use.stationary == "time":
            limit_s = averaging_s + OTHER_PROFILE_S
        else:
            limit_s = MEASURING_S[self._preparation.accuracy]
        read = partial(self._read, averaging_s=averaging_s, face=face)
        point = self._ask(_MEASURING, read, limit_s, heeds_halt=True)
        off_m = float(np.linalg.norm(point.p_M - expected))
        if off_m > self._use.wrong_target:
            raise WrongTarget(f"tracker: it locked an SMR {off_m * 1e3:.0f} mm from where one was expected")
        return point

    def _read(self, tracker: Any, averaging_s: float, face: Face) -> Point:
        if tracker.Targets.Selected is None:
            raise TargetLost("tracker: the beam to the SMR broke before it was measured")
        began_s = time.monotonic()
        result = tracker.Measurement.MeasureStationary()
        ended_s = time.monotonic()
        if result is None:
            raise TargetLost("tracker: it measured nothing")
        position = result.Position
        kind = plain(position.CoordinateType)
        if str(kind) != "Cartesian" and int(kind) != int(self._enumeration("ECoordinateType").Cartesian):
            raise TrackerError(f"tracker: the point comes in {kind} coordinates; another program changed that")
        coordinates = (position.Coordinate1, position.Coordinate2, position.Coordinate3)
        p_M = np.array([si(coordinate, "length") for coordinate in coordinates])
        precision = np.array([precision_m(coordinate) for coordinate in coordinates])
        if not (np.isfinite(p_M).all() and np.isfinite(precision).all() and np.linalg.norm(p_M) > 0.0):
            raise TrackerError("tracker: it reports a point that is none")
        if bool(plain(position.IsFace2)) != (face == 2):
            raise TrackerError(f"tracker: it measured in another face than {face}")
        seen_m = float(np.linalg.norm(precision))
        if seen_m > self._use.shaking:
            raise Unstable(f"tracker: the SMR moved while it was measured: precision {seen_m * 1e6:.0f} um")
        covariance = self._law.covariance(p_M)
        covariance *= max(1.0, seen_m**2 / float(np.trace(covariance)))  # it shook more than the law knows
        air, quality = self._air(result)
        flags = str(plain(result.Info.FlagsWithWarnings))
        if flags != "AllOk":
            quality.append(flags)
        quality += self._air_notices(tracker)
        while self._news:  # also what came since the last point
            text = self._news.popleft()
            self._messages.append(text)
            quality.append(text)
        ticks = int(result.TimeStamp.Ticks)
        return Point(
            p_M=p_M,
            covariance_M=covariance,
            time_s=0.5 * (began_s + ended_s),
            averaging_s=averaging_s if self._use.stationary == "time" else ended_s - began_s,
            temperature_c=air["Temperature"],
            pressure_hpa=air["Pressure"],
            humidity_percent=air["Humidity"],
            precision_M=precision,
            face=face,
            tracker_time_s=(ticks - _TICKS_1970) * 1e-7 if ticks else None,
            host_time_s=time.time(),
            reflector=self._reflector,
            quality=tuple(quality),
        )

    @staticmethod
    def _air(result: Any) -> tuple[dict[str, float | None], list[str]]:
        """What the refraction was corrected with, in the units set at connect, and what is not to be believed of it."""
        air: dict[str, float | None] = {}
        doubts = []
        for name, (low, high) in _AIR.items():
            value = float(plain(getattr(result, name)))
            air[name] = value if low <= value <= high else None
            if air[name] is None:
                doubts.append(f"{name.lower()} applied to the point reads {value:g}, which cannot be")
        return air, doubts

    # -- calls ---------------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        if self._commands is not None:
            self._commands.begin()

    def _ask(
        self, what: str, function: Callable[[Any], _T], limit_s: float | None = None, *, heeds_halt: bool = False
    ) -> _T:
        """Run ``function(tracker)`` on LMF's thread and say what LMF throws in the protocol's words."""
        commands, tracker = self._commands, self._tracker
        if commands is None or tracker is None:
            raise TrackerLinkLost(f"tracker {self._use.address}: not connected")
        if self._gone:
            raise TrackerLinkLost(f"tracker {self._use.address}: {self._gone}; connect again")

        def run() -> _T:
            with self._translated(what):
                return function(tracker)

        return commands.call(what, run, self._use.timeout if limit_s is None else limit_s, heeds_halt=heeds_halt)

    @contextlib.contextmanager
    def _translated(self, what: str) -> Iterator[None]:
        thrown = () if self._lmf is None else self._lmf.thrown
        try:
            yield
        except thrown as error:
            raise self._meant(what, error) from error
        except AttributeError as error:
            raise TrackerError(f"tracker: this LMF lacks what the driver needs: {error}; is it v1.10?") from error

    def _meant(self, what: str, error: BaseException) -> TrackerError:
        """LMF publishes no numbers for a lost target: what it is shows in the state it leaves behind."""
        text = f"tracker: {what} failed: {told(error)}"
        if self._gone:
            return TrackerLinkLost(f"{text}; {self._gone}")
        if error_number(error) in self._use.lost_numbers:
            return TargetLost(text)
        thrown = () if self._lmf is None else self._lmf.thrown
        try:
            unmet = self._unmet(self._tracker)
            lost = self._tracker.Targets.Selected is None
        except thrown:
            return TrackerLinkLost(f"{text}; it does not tell its state either")
        if unmet:
            return NotReady(f"{text}; not ready: {'; '.join(unmet)}")
        return TargetLost(text) if lost and what in (_POINTING, _MEASURING, _TURNING) else TrackerError(text)
