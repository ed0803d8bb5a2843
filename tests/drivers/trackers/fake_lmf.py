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
_CARTESIAN_SI = ("Cartesian", "Meter", "Radian", "Celsius", "HPascal")
"""The only coordinates and units in which this stand-in points and measures."""
_TICKS_OF_1970 = 621_355_968_000_000_000


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

    def __init__(self, **attributes: Any) -> None:
        self.__dict__.update(attributes)

    def __setattr__(self, name: str, value: object) -> None:
        if not hasattr(self, name):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")


class Choices(Net):
    """Properties that are enumerations, and take members of the same one only."""

    def __setattr__(self, name: str, value: object) -> None:
        if type(value) is not type(getattr(self, name)):
            raise TypeError(f"{name}: '{type(value).__name__}' cannot be converted")
        super().__setattr__(name, value)


class ReadOnlyValue(Net):
    """A value object that only LMF changes; ``read`` returns the value. A coordinate at rest has a precision, too."""

    def __init__(self, read: Callable[[], Any], unit: str = "", **precision: float) -> None:
        super().__init__(_read=read, UnitString=unit, **precision)

    @property
    def Value(self) -> Any:
        return self._read()


class Value(Net):
    """A writable value object of one type, optionally with a range."""

    _value: Any

    def __init__(
        self,
        value: Any,
        *,
        scene: Scene | None = None,
        name: str = "",
        span: tuple[float, float] | None = None,
        unit: str = "",
        changed: Callable[[], None] = lambda: None,
        number: bool = False,
    ) -> None:
        super().__init__(
            _value=value, _scene=scene, _name=name, _span=span, _changed=changed, _number=number, UnitString=unit
        )

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


# -- the object tree --------------------------------------------------------------------------------------------------


class Profile(Net):
    """A profile of measurements, with its settings."""

    def __init__(self, tracker: Tracker, name: str, **settings: Value) -> None:
        super().__init__(_tracker=tracker, Name=name, **settings)

    def Select(self) -> None:
        self._tracker.scene.command("Select profile")
        if self._tracker.Measurement.MeasurementInProgress.Value:
            raise LmfException(200001, "Measurement in progress")
        self._tracker.Measurement.Profiles.Selected = self


class StationaryMeasurementProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        accuracy = Value(E["EAccuracy"].Fast, number=tracker.scene.number_accuracy)
        super().__init__(
            tracker, "Stationary", Accuracy=accuracy, TwoFace=Value(True, scene=tracker.scene, name="TwoFace")
        )


class CustomStationaryMeasurementProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        time = Value(500.0, span=(100.0, 100_000.0), unit="ms", changed=tracker.warn_of_property)
        super().__init__(tracker, "Custom", Time=time)


class ContinuousTimeProfile(Profile):
    def __init__(self, tracker: Tracker) -> None:
        separation = Value(500.0, span=(1.0, 9e5), unit="ms", changed=tracker.warn_of_property)
        rate = Value(5, span=(1, 50), scene=tracker.scene, name="PacketRate")
        super().__init__(tracker, "Continuous Time", TimeSeparation=separation, PacketRate=rate)


class Collection(Net):
    def __init__(self, items: list[Any]) -> None:
        super().__init__(_items=items, Selected=None, PreSelected=None, SelectedChanged=None)

    @property
    def Count(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> Any:
        return self._items[index]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)


class Target(Net):
    def __init__(self, tracker: Tracker, name: str, product: str, selectable: bool = True) -> None:
        told = selectable if tracker.scene.bool_selectable else ReadOnlyValue(lambda: selectable)
        super().__init__(_tracker=tracker, Name=name, ProductName=product, IsSelectable=told)

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


def precondition(number: int, title: str, solution: str) -> Net:
    return Net(Number=number, Title=title, Description="", Solution=solution)


class Measurement(Net):
    """``Tracker.Measurement``."""

    def __init__(self, tracker: Tracker, profiles: Collection) -> None:
        super().__init__(
            _tracker=tracker,
            MeasurementInProgress=Value(tracker.scene.persistent.get("busy", False)),
            Profiles=profiles,
            MeasurementArrived=Event("MeasurementArrived", tracker.scene, tracker.events),
        )

    @property
    def Status(self) -> Any:
        missing = []
        if not self._tracker.scene.initialised:
            missing.append(precondition(300, "Tracker not initialized", "Initialize it."))
        if self._tracker.Targets.Selected is None:
            missing.append(precondition(301, "No target locked", "Point at a reflector."))
        status = E["EMeasurementStatus"]
        return Net(Preconditions=missing, Value=status.NotReady if missing else status.ReadyToMeasure)

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
            point.TimeStamp.Ticks = _TICKS_OF_1970 + 10_000_000 + round(number * profile.TimeSeparation.Value * 10_000)
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
    def __init__(self, tracker: Tracker, **more: Net) -> None:
        tracker.check_units()
        scene, meteo = tracker.scene, tracker.MeteoStation
        air = (scene.temperature_c, 1009.0, 41.0)
        if meteo.Source.Value != E["EMeteoSource"].LiveMeteo:
            air = tuple(one.Value for one in (meteo.ManualTemperature, meteo.ManualPressure, meteo.ManualHumidity))
        super().__init__(
            Position=Net(
                **{
                    f"Coordinate{axis}": value for axis, value in enumerate(self._coordinates(scene, tracker.locked), 1)
                },
                CoordinateType=tracker.Settings.CoordinateType,
                IsFace2=tracker.face2,
            ),
            Info=Net(FlagsWithWarnings=getattr(E["EFlags"], scene.flags)),
            TimeStamp=Net(Ticks=_TICKS_OF_1970 + scene.measured * 10_000_000),
            **{
                name: ReadOnlyValue(partial(float, value))
                for name, value in zip(("Temperature", "Pressure", "Humidity"), air, strict=True)
            },
            **more,
        )

    def _coordinates(self, scene: Scene, locked: str) -> list[ReadOnlyValue]:
        sigma_m = scene.precision_m / math.sqrt(3.0)
        return [ReadOnlyValue(partial(float, number), "m", Precision=sigma_m) for number in scene.targets[locked]]


class StationaryMeasurement6D(StationaryMeasurement3D):
    """A point with the rotation of the probe that is locked, as numbers of the form that is set."""

    def __init__(self, tracker: Tracker) -> None:
        kind, numbers = tracker.Settings.RotationType, tracker.scene.probes[tracker.locked]
        if kind != E["ERotationType"].Quaternion:
            numbers = Rotation.from_quat(np.roll(numbers, -1)).as_euler("XYZ")
        member = tracker.scene.rotation_member
        values = {f"{member}{place}": ReadOnlyValue(partial(float, number)) for place, number in enumerate(numbers)}
        super().__init__(tracker, Rotation=Net(RotationType=kind, **values))


class SingleShotMeasurement3D(StationaryMeasurement3D):
    """A point of a continuous measurement: its coordinates have no precision."""

    def _coordinates(self, scene: Scene, locked: str) -> list[ReadOnlyValue]:
        return [ReadOnlyValue(partial(float, number), "m") for number in scene.targets[locked]]


class Face(Net):
    @property
    def IsFace1(self) -> ReadOnlyValue:
        return ReadOnlyValue(lambda: not self._tracker.face2)

    def Change(self) -> None:
        self._tracker.scene.command("Face.Change")
        self._tracker.face2 = not self._tracker.face2


class Monitoring(Net):
    def Reset(self) -> None:
        self._tracker.scene.command("Monitoring.Reset")


class InclinationSensor(Net):
    def __init__(self, tracker: Tracker) -> None:
        persistent = tracker.scene.persistent

        def keep() -> None:
            persistent["gravity"] = self.InclinedToGravity.Value

        super().__init__(
            _tracker=tracker,
            InclinedToGravity=Value(persistent.get("gravity", False), changed=keep),
            Monitoring=Monitoring(_tracker=tracker, Active=Value(False)),
        )

    def GetInclinationToGravity(self) -> None:
        self._tracker.scene.command("GetInclinationToGravity")


def meteo_station(scene: Scene) -> Net:
    manual = {
        name: Value(value, scene=scene, name=name, span=span)
        for name, value, span in (
            ("ManualTemperature", 20.0, (-20.0, 60.0)),
            ("ManualPressure", 1013.25, (500.0, 1200.0)),
            ("ManualHumidity", 50.0, (0.0, 100.0)),
        )
    }
    source = Value(scene.persistent.get("meteo", E["EMeteoSource"].ManualMeteo))
    return Net(Source=source, IsAirSensorConnected=ReadOnlyValue(lambda: scene.air_sensor), **manual)


class Tracker(Net):
    """Like ``LMF.Tracker.AT960Tracker`` right after a connect: nearly all settings are LMF's defaults."""

    def __init__(self, scene: Scene, address: str) -> None:
        events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        threading.Thread(target=deliver, args=(events,), name="LMF events", daemon=True).start()
        super().__init__(scene=scene, address=address, events=events, locked="", face2=False, Measurement=None)
        self.__dict__.update(
            Name="cell tracker",
            ProductName="AT960-LR",
            SerialNumber=scene.serial,
            InstalledFirmware="2.3.0.1",
            ExpectedFirmware="2.3",
            IsCompatibleWithInstalledFirmware=ReadOnlyValue(lambda: scene.compatible),
            **{name: Event(name, scene, events) for name in ("Disconnected", "ErrorArrived", "WarningArrived")},
            Settings=Choices(
                CoordinateType=E["ECoordinateType"].Spherical,
                RotationType=E["ERotationType"].RotationAngles,
                Units=Choices(
                    LengthUnit=E["ELengthUnit"].Millimeter,
                    AngleUnit=E["EAngleUnit"].Degree,
                    TemperatureUnit=E["ETemperatureUnit"].Fahrenheit,
                    PressureUnit=E["EPressureUnit"].InHg,
                ),
            ),
            PowerLock=Net(UsePowerLock=Value(False, changed=self.warn_of_property)),
            TargetSearch=Net(Radius=Value(5.0, unit="m")),
            Laser=Net(
                IsOn=ReadOnlyValue(lambda: scene.laser_on), IsLaserWarmedUp=ReadOnlyValue(lambda: scene.warmed_up)
            ),
            QuickRelease=ReadOnlyValue(lambda: scene.read("QuickRelease", scene.quick_release)),
            Compensations=Net(Selected=Net()),
            MeteoStation=meteo_station(scene),
            Face=Face(_tracker=self),
            Targets=Collection(
                [
                    RedRingReflector15(self, "RRR 1.5in", "Red Ring Reflector 1.5in"),
                    BreakResistantReflector15(self, "BRR 1.5in", "Break Resistant Reflector 1.5in"),
                    TMac(self, "T-Mac", "T-Mac", selectable=False),
                ]
            ),
            InclinationSensor=InclinationSensor(self) if scene.level else None,
        )
        self.Targets.PreSelected = self.Targets[1]
        self.Targets.SelectedChanged = Event("SelectedChanged", scene, events)
        kinds = (ContinuousTimeProfile, StationaryMeasurementProfile, CustomStationaryMeasurementProfile)
        profiles = Collection([kind(self) for kind in kinds[0 if scene.continuous else 1 :]])
        profiles.Selected = profiles[0]
        self.Measurement = Measurement(self, profiles)

    def check_units(self) -> None:
        """Raise LMF's error if anything but Cartesian coordinates in SI units is set."""
        units = self.Settings.Units
        found = (units.LengthUnit, units.AngleUnit, units.TemperatureUnit, units.PressureUnit)
        if tuple(map(str, (self.Settings.CoordinateType, *found))) != _CARTESIAN_SI:
            raise LmfException(6, "This stand-in points and measures in Cartesian coordinates and SI units only")

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
        self.check_units()
        self.lose_target()
        self.WarningArrived.fire(self, LmfException(8, "Head moved"))
        wanted = np.array([p1, p2, p3])
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
        self._found = Collection(
            [Net(IPAddress=address, Type=model, SerialNumber=serial) for address, model, serial in self._scene.network]
        )

    @property
    def Trackers(self) -> Collection:
        return self._found
