"""A stand-in for LMF with its names, and with its rules as far as its documents state them.

Value objects instead of numbers, units that are applied, enumerations that are not integers, settings that a connect
resets, events delivered one by one on a thread of LMF's own while the command that caused them waits, ``Selected`` that
is null as soon as the beam breaks, exceptions with four fields, the names of its simulators. ``Scene.violations`` lists
every broken rule.
"""

from __future__ import annotations

import math
import queue
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.trackers.lmf_objects import Lmf

HANDLER_S = 5.0
_SIMULATOR = re.compile(r"(at930|at960|at40[123]|at500|ats600)(lr|mr)?simulator(#\d+)?")


class NetException(Exception):
    """System.Exception."""


class ArgumentOutOfRangeException(NetException):
    """Raised by value objects with a range."""


class LmfException(NetException):
    """Number, title, description, solution."""

    def __init__(self, number: int, title: str, description: str = "", solution: str = "") -> None:
        super().__init__(f"{number} {title}")
        self.Number, self.Title, self.Description, self.Solution = number, title, description, solution


# -- enumerations -----------------------------------------------------------------------------------------------------


class NetEnum:
    """A .NET enumeration as pythonnet 3 shows it: its members are attributes of the class, and not integers."""

    names: ClassVar[tuple[str, ...]]

    def __init__(self, number: int) -> None:
        self._number = number

    def __int__(self) -> int:
        return self._number

    def __str__(self) -> str:
        return self.names[self._number]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and int(other) == self._number

    def __hash__(self) -> int:
        return self._number


def enumeration(name: str, *members: str) -> Any:
    kind = type(name, (NetEnum,), {"names": members})
    for number, member in enumerate(members):
        setattr(kind, member, kind(number))
    return kind


ENUMERATIONS: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        enumeration("ECoordinateType", "Spherical", "Cartesian", "Cylindrical"),
        enumeration("ERotationType", "RotationAngles", "RollPitchYaw", "Quaternion"),
        enumeration("ELengthUnit", "Meter", "Millimeter", "Micrometer", "Foot", "Yard", "Inch"),
        enumeration("EAngleUnit", "Radian", "Millirad", "Degree", "Gon", "CC"),
        enumeration("ETemperatureUnit", "Celsius", "Fahrenheit"),
        enumeration("EPressureUnit", "mBar", "HPascal", "KPascal", "MmHg", "Psi", "InH2O", "InHg"),
        enumeration("EAccuracy", "Precise", "Standard", "Fast"),
        enumeration("EMeteoSource", "ManualMeteo", "LiveMeteo"),
        enumeration("EMeasurementStatus", "ReadyToMeasure", "MeasurementInProgress", "NotReady", "Invalid"),
        enumeration("EFlags", "AllOk", "AccuracyError", "OutOfSync"),
    )
}
E = ENUMERATIONS
_METRES = (1.0, 1e-3, 1e-6, 0.3048, 0.9144, 0.0254)
_METRE_NAMES = ("m", "mm", "µm", "ft", "yd", "in")
_RADIANS = (1.0, 1e-3, math.pi / 180.0, math.pi / 200.0, math.pi / 2e6)
_RADIAN_NAMES = ("rad", "mrad", "°", "gon", "cc")


# -- the scene, and LMF's thread for events ----------------------------------------------------------------------------


@dataclass
class Scene:
    """The tracker's surroundings and its next actions. The test writes; LMF's object tree reads.

    ``targets``: SMRs by name -> (3,) [m] in M. ``probes``: those that are 6-D probes, by name -> quaternion (4,),
    scalar first, in members of the result that begin with ``rotation_member``. ``hanging``: methods (and
    QuickRelease) that wait for ``release``. ``throws``: method -> exception of its next call. ``ignored_settings``:
    settings that keep their value when written. ``persistent``: what LMF keeps from one connect to the next.
    """

    targets: dict[str, np.ndarray] = field(default_factory=dict)
    serial: str = "750123"
    initialised: bool = False
    laser_on: bool = True
    warmed_up: bool = True
    quick_release: bool = True
    air_sensor: bool = True
    compatible: bool = True
    level: bool = True
    probes: dict[str, np.ndarray] = field(default_factory=dict)
    rotation_member: str = "Value"
    hidden: set[str] = field(default_factory=set)
    hanging: set[str] = field(default_factory=set)
    throws: dict[str, NetException] = field(default_factory=dict)
    beam_breaks: bool = False
    precision_m: float = 4e-6
    temperature_c: float = 21.5
    number_accuracy: bool = False
    bool_selectable: bool = True
    ignored_settings: set[str] = field(default_factory=set)
    search_m: float = 0.1
    flags: str = "AllOk"
    continuous: bool = True
    network: tuple[tuple[str, str, str], ...] = ()
    release: threading.Event = field(default_factory=threading.Event)
    entered: threading.Event = field(default_factory=threading.Event)
    calls: list[str] = field(default_factory=list)
    threads: list[threading.Thread] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    connected: list[str] = field(default_factory=list)
    persistent: dict[str, Any] = field(default_factory=dict)
    measured: int = 0

    def lmf(self) -> Lmf:
        """Return LMF as the driver loads it."""
        return Lmf(
            Connection=lambda: Connection(self),
            TrackerFinder=lambda: TrackerFinder(self),
            enumeration=ENUMERATIONS.get,
            exceptions=(NetException,),
        )

    def command(self, name: str) -> None:
        """Record a method call of LMF and apply the faults set for it."""
        self.calls.append(name)
        if name in ("Connect", "Refresh"):
            self.threads.append(threading.current_thread())
        elif threading.current_thread() not in self.threads:
            self.violations.append(f"{name} came from another thread than the connection")
        if threading.current_thread().name == "LMF events":
            self.violations.append(f"{name} was called from an event handler")
        self.read(name, None)
        if name in self.throws:
            raise self.throws.pop(name)

    def read(self, name: str, value: Any) -> Any:
        """Return a value, if reading it does not hang."""
        if name in self.hanging:
            self.entered.set()
            self.release.wait(30.0)
        return value


class Event:
    """A .NET event: handlers are added and removed with += and -=, and called one by one on LMF's own thread."""

    def __init__(self, name: str, scene: Scene, events: queue.SimpleQueue[Any]) -> None:
        self.name, self._scene, self._events = name, scene, events
        self.handlers: list[Callable[..., None]] = []

    def __iadd__(self, handler: Callable[..., None]) -> Event:
        self.handlers.append(handler)
        return self

    def __isub__(self, handler: Callable[..., None]) -> Event:
        self.handlers.remove(handler)
        return self

    def fire(self, *arguments: Any, by_property: bool = False) -> None:
        """Call the handlers and wait for them, as LMF's commands do."""
        if by_property and self.handlers:
            self._scene.violations.append(f"{self.name}: a property was set while a handler is subscribed: deadlock")
            return
        done = threading.Event()
        self._events.put((list(self.handlers), arguments, done))
        if not done.wait(HANDLER_S):
            self._scene.violations.append(f"{self.name}: a handler did not return at once")


def deliver(events: queue.SimpleQueue[Any]) -> None:
    while (item := events.get()) is not None:
        handlers, arguments, done = item
        for handler in handlers:
            handler(*arguments)
        done.set()


# -- value objects ----------------------------------------------------------------------------------------------------


class Net:
    """An object of a .NET class: attributes that it does not have cannot be set."""

    def __setattr__(self, name: str, value: object) -> None:
        if not name.startswith("_") and "_sealed" in self.__dict__ and not hasattr(self, name):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        super().__setattr__(name, value)

    def seal(self) -> None:
        self._sealed = True


class ReadOnlyValue(Net):
    """A value object that only LMF changes; ``read`` returns the value in the current unit."""

    def __init__(self, read: Callable[[], Any], unit: Callable[[], str] = lambda: "") -> None:
        self._read, self._unit = read, unit
        self.seal()

    @property
    def Value(self) -> Any:
        return self._read()

    @property
    def UnitString(self) -> str:
        return self._unit()

    @property
    def Precision(self) -> Any:
        raise AttributeError("Precision")


class StatisticValue(ReadOnlyValue):
    """A coordinate of a stationary point."""

    def __init__(self, read: Callable[[], float], unit: Callable[[], str], precision: Callable[[], float]) -> None:
        super().__init__(read, unit)
        self._precision = precision

    @property
    def Precision(self) -> float:
        return self._precision()


class Value(Net):
    """A writable value object of one type, optionally with a range."""

    def __init__(
        self,
        value: Any,
        *,
        scene: Scene | None = None,
        name: str = "",
        span: tuple[float, float] | None = None,
        unit: Callable[[], str] = lambda: "",
        changed: Callable[[], None] = lambda: None,
        number: bool = False,
    ) -> None:
        self._value, self._scene, self._name, self._span, self._unit = value, scene, name, span, unit
        self._changed, self._number = changed, number
        self.seal()

    @property
    def Value(self) -> Any:
        return int(self._value) if self._number else self._value

    @Value.setter
    def Value(self, value: Any) -> None:
        fits = isinstance(value, int if self._number else type(self._value))
        if not fits and not (isinstance(self._value, float) and isinstance(value, int)):
            raise TypeError(f"'{type(value).__name__}' value cannot be converted to {type(self._value).__name__}")
        if self._span is not None and not self._span[0] <= value <= self._span[1]:
            raise ArgumentOutOfRangeException(f"{self._name}: {value} is not in {self._span}")
        if self._scene is not None and self._name in self._scene.ignored_settings:
            return
        self._value = type(self._value)(value) if self._number else value
        self._changed()

    @property
    def UnitString(self) -> str:
        return self._unit()


# -- the object tree --------------------------------------------------------------------------------------------------


def _plain_enumeration(name: str) -> property:
    def read(self: Any) -> Any:
        return getattr(self, f"_{name}")

    def write(self: Any, value: Any) -> None:
        if type(value) is not type(read(self)):
            raise TypeError(f"{name}: '{type(value).__name__}' cannot be converted")
        setattr(self, f"_{name}", value)

    return property(read, write)


class Units(Net):
    LengthUnit = _plain_enumeration("LengthUnit")
    AngleUnit = _plain_enumeration("AngleUnit")
    TemperatureUnit = _plain_enumeration("TemperatureUnit")
    PressureUnit = _plain_enumeration("PressureUnit")

    def __init__(self) -> None:
        self._LengthUnit, self._AngleUnit = E["ELengthUnit"].Millimeter, E["EAngleUnit"].Degree
        self._TemperatureUnit, self._PressureUnit = E["ETemperatureUnit"].Fahrenheit, E["EPressureUnit"].InHg
        self.seal()


class Settings(Net):
    CoordinateType = _plain_enumeration("CoordinateType")
    RotationType = _plain_enumeration("RotationType")

    def __init__(self) -> None:
        self._CoordinateType = E["ECoordinateType"].Spherical
        self._RotationType = E["ERotationType"].RotationAngles
        self._units = Units()
        self.seal()

    @property
    def Units(self) -> Units:
        return self._units


class Profile(Net):
    def __init__(self, tracker: Tracker, name: str) -> None:
        self._tracker, self.Name = tracker, name

    def Select(self) -> None:
        self._tracker.scene.command("Select profile")
        if self._tracker.Measurement.MeasurementInProgress.Value:
            raise LmfException(200001, "Measurement in progress")
        self._tracker.Measurement.Profiles.Selected = self


class StationaryMeasurementProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker, "Stationary")
        self.Accuracy = Value(E["EAccuracy"].Fast, number=tracker.scene.number_accuracy)
        self.TwoFace = Value(True, scene=tracker.scene, name="TwoFace")
        self.seal()


class CustomStationaryMeasurementProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker, "Custom")
        self.Time = Value(500.0, span=(100.0, 100_000.0), unit=lambda: "ms", changed=tracker.warn_of_property)
        self.seal()


class ContinuousTimeProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker, "Continuous Time")
        self.TimeSeparation = Value(500.0, span=(1.0, 9e5), unit=lambda: "ms", changed=tracker.warn_of_property)
        self.PacketRate = Value(5, span=(1, 50), scene=tracker.scene, name="PacketRate")
        self.seal()


class Collection(Net):
    def __init__(self, items: list[Any]) -> None:
        self._items = items
        self.Selected: Any = None
        self.PreSelected: Any = None
        self.SelectedChanged: Any = None
        self.seal()

    @property
    def Count(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> Any:
        return self._items[index]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)


class Target(Net):
    def __init__(self, tracker: Tracker, name: str, product: str, selectable: bool = True) -> None:
        self._tracker, self.Name, self.ProductName = tracker, name, product
        self.IsSelectable = selectable if tracker.scene.bool_selectable else ReadOnlyValue(lambda: selectable)
        self.seal()

    def Select(self) -> None:
        self._tracker.scene.command("Select target")
        if "reflector" not in self._tracker.scene.ignored_settings:
            self._tracker.Targets.PreSelected = self


class RedRingReflector15(Target):
    pass


class BreakResistantReflector15(Target):
    pass


class TMac(Target):
    pass


class Precondition(Net):
    def __init__(self, number: int, title: str, solution: str) -> None:
        self.Number, self.Title, self.Description, self.Solution = number, title, "", solution


class Measurement(Net):
    """``Tracker.Measurement``."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self.MeasurementInProgress = Value(tracker.scene.persistent.get("busy", False))
        self.Profiles = Collection([])
        self.MeasurementArrived = Event("MeasurementArrived", tracker.scene, tracker.events)
        self.seal()

    @property
    def Status(self) -> Any:
        missing = []
        if not self._tracker.scene.initialised:
            missing.append(Precondition(300, "Tracker not initialized", "Initialize it."))
        if self._tracker.Targets.Selected is None:
            missing.append(Precondition(301, "No target locked", "Point at a reflector."))
        status = Net()
        status.Preconditions = missing
        status.Value = E["EMeasurementStatus"].NotReady if missing else E["EMeasurementStatus"].ReadyToMeasure
        return status

    def StopMeasurement(self) -> None:
        self._tracker.scene.command("StopMeasurement")
        self.MeasurementInProgress.Value = False

    def StartMeasurement(self) -> None:
        self._tracker.scene.command("StartMeasurement")
        if self.Status.Preconditions:
            raise LmfException(301, "Not ready", "Preconditions are not met.")
        self.MeasurementInProgress.Value = True

    def send(self, first: int, count: int, error: Any = None) -> None:
        """Let LMF deliver a packet of a continuous measurement, with the points from number ``first`` on."""
        scene, profile = self._tracker.scene, self.Profiles.Selected
        assert isinstance(profile, ContinuousTimeProfile)
        points = [SingleShotMeasurement3D(self._tracker) for _ in range(count)]
        for number, point in enumerate(points, start=first):
            ticks = round(number * profile.TimeSeparation.Value * 10_000)
            point.TimeStamp.Ticks = 621_355_968_000_000_000 + 10_000_000 + ticks
        scene.measured += 1
        self.MeasurementArrived.fire(self, Collection(points), error)

    def MeasureStationary(self) -> Any:
        tracker, scene = self._tracker, self._tracker.scene
        scene.command("MeasureStationary")
        if isinstance(self.Profiles.Selected, ContinuousTimeProfile):
            raise LmfException(302, "Wrong profile", "Select a stationary one.")
        if self.Status.Preconditions:
            raise LmfException(301, "Not ready", "Preconditions are not met.")
        if scene.beam_breaks:
            tracker.lose_target()
            raise LmfException(301, "Measurement aborted")
        scene.measured += 1
        turned = tracker.locked in scene.probes
        return StationaryMeasurement6D(tracker) if turned else StationaryMeasurement3D(tracker)


class StationaryMeasurement3D(Net):
    def __init__(self, tracker: Tracker) -> None:
        scene = tracker.scene
        units = tracker.Settings.Units
        p_M = scene.targets[tracker.locked].copy()
        cartesian = tracker.Settings.CoordinateType == E["ECoordinateType"].Cartesian
        scale, name = _METRES[int(units.LengthUnit)], _METRE_NAMES[int(units.LengthUnit)]
        distance = float(np.linalg.norm(p_M))
        numbers = p_M / scale
        if not cartesian:
            angles = np.array([math.atan2(p_M[0], p_M[1]), math.acos(p_M[2] / distance)])
            numbers = np.array([*(angles / _RADIANS[int(units.AngleUnit)]), distance / scale])
        position = Net()
        sigma = scene.precision_m / math.sqrt(3.0) / scale
        for axis, number in enumerate(numbers, start=1):
            value = StatisticValue(partial(float, number), lambda: name, lambda: sigma)
            setattr(position, f"Coordinate{axis}", value)
        position.CoordinateType = tracker.Settings.CoordinateType
        position.IsFace2 = tracker.face2
        self.Position = position
        celsius = units.TemperatureUnit == E["ETemperatureUnit"].Celsius
        hpa = units.PressureUnit == E["EPressureUnit"].HPascal
        meteo = tracker.MeteoStation
        live = meteo.Source.Value == E["EMeteoSource"].LiveMeteo
        t, p, h = (
            (scene.temperature_c, 1009.0, 41.0)
            if live
            else (meteo.ManualTemperature.Value, meteo.ManualPressure.Value, meteo.ManualHumidity.Value)
        )
        self.Temperature = ReadOnlyValue(lambda: t if celsius else t * 1.8 + 32.0)
        self.Pressure = ReadOnlyValue(lambda: p if hpa else p / 33.8638866667)
        self.Humidity = ReadOnlyValue(lambda: h)
        self.Info = Net()
        self.Info.FlagsWithWarnings = getattr(E["EFlags"], scene.flags)
        self.TimeStamp = Net()
        self.TimeStamp.Ticks = 621_355_968_000_000_000 + scene.measured * 10_000_000


class StationaryMeasurement6D(StationaryMeasurement3D):
    """A point with the rotation of the probe that is locked, as numbers of the form that is set."""

    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker)
        kind, numbers = tracker.Settings.RotationType, tracker.scene.probes[tracker.locked]
        if kind != E["ERotationType"].Quaternion:
            radian = _RADIANS[int(tracker.Settings.Units.AngleUnit)]
            numbers = Rotation.from_quat(np.roll(numbers, -1)).as_euler("XYZ") / radian
        self.Rotation = Net()
        self.Rotation.RotationType = kind
        for place, number in enumerate(numbers):
            setattr(self.Rotation, f"{tracker.scene.rotation_member}{place}", ReadOnlyValue(partial(float, number)))


class SingleShotMeasurement3D(StationaryMeasurement3D):
    """A point of a continuous measurement: its coordinates have no precision."""

    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker)
        for axis in (1, 2, 3):
            with_precision = getattr(self.Position, f"Coordinate{axis}")
            setattr(self.Position, f"Coordinate{axis}", ReadOnlyValue(with_precision._read, with_precision._unit))


class Face(Net):
    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker

    @property
    def IsFace1(self) -> ReadOnlyValue:
        return ReadOnlyValue(lambda: not self._tracker.face2)

    def Change(self) -> None:
        self._tracker.scene.command("Face.Change")
        self._tracker.face2 = not self._tracker.face2


class Monitoring(Net):
    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self.Active = Value(False)
        self.seal()

    def Reset(self) -> None:
        self._tracker.scene.command("Monitoring.Reset")


class InclinationSensor(Net):
    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        persistent = tracker.scene.persistent

        def keep() -> None:
            persistent["gravity"] = self.InclinedToGravity.Value

        self.InclinedToGravity = Value(persistent.get("gravity", False), changed=keep)
        self.Monitoring = Monitoring(tracker)
        self.seal()

    def GetInclinationToGravity(self) -> None:
        self._tracker.scene.command("GetInclinationToGravity")


class MeteoStation(Net):
    def __init__(self, tracker: Tracker) -> None:
        scene = tracker.scene
        self.Source = Value(scene.persistent.get("meteo", E["EMeteoSource"].ManualMeteo))
        self.ManualTemperature = Value(20.0, scene=scene, name="ManualTemperature", span=(-20.0, 60.0))
        self.ManualPressure = Value(1013.25, scene=scene, name="ManualPressure", span=(500.0, 1200.0))
        self.ManualHumidity = Value(50.0, scene=scene, name="ManualHumidity", span=(0.0, 100.0))
        self.IsAirSensorConnected = ReadOnlyValue(lambda: scene.air_sensor)
        self.seal()


class Tracker(Net):
    """Like ``LMF.Tracker.AT960Tracker`` right after a connect: nearly all settings are LMF's defaults."""

    def __init__(self, scene: Scene, address: str) -> None:
        self.scene, self.address = scene, address
        self.locked, self.face2 = "", False
        self.events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        threading.Thread(target=deliver, args=(self.events,), name="LMF events", daemon=True).start()
        self.Name, self.ProductName, self.SerialNumber = "cell tracker", "AT960-LR", scene.serial
        self.InstalledFirmware, self.ExpectedFirmware = "2.3.0.1", "2.3"
        self.IsCompatibleWithInstalledFirmware = ReadOnlyValue(lambda: scene.compatible)
        self.Disconnected = Event("Disconnected", scene, self.events)
        self.ErrorArrived = Event("ErrorArrived", scene, self.events)
        self.WarningArrived = Event("WarningArrived", scene, self.events)
        self.Settings = Settings()
        self.Targets = Collection(
            [
                RedRingReflector15(self, "RRR 1.5in", "Red Ring Reflector 1.5in"),
                BreakResistantReflector15(self, "BRR 1.5in", "Break Resistant Reflector 1.5in"),
                TMac(self, "T-Mac", "T-Mac", selectable=False),
            ]
        )
        self.Targets.PreSelected = self.Targets[1]
        self.Targets.SelectedChanged = Event("SelectedChanged", scene, self.events)
        self.Measurement = Measurement(self)
        self.Measurement.Profiles = Collection(
            [
                *([ContinuousTimeProfile(self)] if scene.continuous else []),
                StationaryMeasurementProfile(self),
                CustomStationaryMeasurementProfile(self),
            ]
        )
        self.Measurement.Profiles.Selected = self.Measurement.Profiles[0]
        self.PowerLock = Net()
        self.PowerLock.UsePowerLock = Value(False, changed=self.warn_of_property)
        self.TargetSearch = Net()
        self.TargetSearch.Radius = Value(5.0, unit=lambda: _METRE_NAMES[int(self.Settings.Units.LengthUnit)])
        self.Face = Face(self)
        self.Laser = Net()
        self.Laser.IsOn = ReadOnlyValue(lambda: scene.laser_on)
        self.Laser.IsLaserWarmedUp = ReadOnlyValue(lambda: scene.warmed_up)
        self.QuickRelease = ReadOnlyValue(lambda: scene.read("QuickRelease", scene.quick_release))
        self.Compensations = Net()
        self.Compensations.Selected = Net()
        self.InclinationSensor = InclinationSensor(self) if scene.level else None
        self.MeteoStation = MeteoStation(self)
        self.seal()

    def angle(self, radians: float) -> ReadOnlyValue:
        def unit() -> int:
            return int(self.Settings.Units.AngleUnit)

        return ReadOnlyValue(lambda: radians / _RADIANS[unit()], lambda: _RADIAN_NAMES[unit()])

    def warn_of_property(self) -> None:
        """Send an event because a property was set; the setter waits until it is delivered."""
        self.WarningArrived.fire(self, LmfException(7, "Setting changed"), by_property=True)

    def warn(self, title: str) -> None:
        self.WarningArrived.fire(self, LmfException(4711, title, "Something is not well.", "Look at it."))

    def lose_target(self) -> None:
        self.locked = ""
        self.Targets.Selected = None
        self.Targets.SelectedChanged.fire(self.Targets, None)

    def Initialize(self) -> None:
        self.scene.command("Initialize")
        self.scene.initialised = True

    def PositionTo(self, search: bool, relative: bool, p1: float, p2: float, p3: float) -> Any:
        self.scene.command("PositionTo")
        if relative:
            raise LmfException(5, "Relative moves need spherical coordinates")
        if self.Settings.CoordinateType != E["ECoordinateType"].Cartesian:
            raise LmfException(6, "This stand-in only points in Cartesian coordinates")
        self.lose_target()
        self.WarningArrived.fire(self, LmfException(8, "Head moved"))
        wanted = np.array([p1, p2, p3]) * _METRES[int(self.Settings.Units.LengthUnit)]
        if not search:
            return None
        seen = {name: p for name, p in self.scene.targets.items() if name not in self.scene.hidden}
        near = min(seen, key=lambda name: float(np.linalg.norm(seen[name] - wanted)), default="")
        if not near or np.linalg.norm(seen[near] - wanted) > self.scene.search_m:
            raise LmfException(9, "No target found")
        self.locked = near
        self.Targets.Selected = self.Targets[2] if near.startswith("T-Mac") else self.Targets.PreSelected
        return self.Targets.Selected

    def Disconnect(self) -> None:
        self.scene.command("Disconnect")
        if self.address in self.scene.connected:
            self.scene.connected.remove(self.address)
        self.events.put(None)

    def drop(self) -> None:
        """Simulate a network failure, which LMF reports."""
        self.Disconnected.fire(self, LmfException(1, "Connection lost"))


class Connection:
    """``LMF.Tracker.Connection``."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def Connect(self, address: str) -> Tracker:
        scene = self._scene
        scene.command("Connect")
        simulated = "simulator" in address.casefold()
        if simulated and _SIMULATOR.fullmatch(address.casefold()) is None:
            raise LmfException(2, "Unknown simulator", address)
        if not simulated and address != "192.168.0.1":
            raise LmfException(3, "Not reachable", f"No tracker at {address}.", "Check the cable.")
        if address.casefold() in scene.connected:
            raise LmfException(10011, "Controller Already In Use")
        tracker = Tracker(scene, address.casefold())
        scene.connected.append(tracker.address)
        scene.persistent["tracker"] = tracker
        return tracker


class TrackerFinder:
    """``LMF.Tracker.TrackerFinder``."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._found = Collection([])

    def Refresh(self) -> None:
        self._scene.command("Refresh")
        found = []
        for address, model, serial in self._scene.network:
            info = Net()
            info.IPAddress, info.Type, info.SerialNumber = address, model, serial
            found.append(info)
        self._found = Collection(found)

    @property
    def Trackers(self) -> Collection:
        return self._found
