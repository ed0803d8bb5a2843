"""The cell as its owner describes it: YAML read into frozen, validated objects. The one door for profiles.

Lengths, angles and the rest are SI numbers or texts with a unit (see ``cellapp.quantities``). Frames: C is the cell
(floor or table, z up), M the tracker, B an arm's base, F its flange, S the SMR centre.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StrictFloat,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from cellapp.errors import InputError
from cellapp.quantities import (
    Angle,
    AngularAcceleration,
    AngularSpeed,
    Length,
    Mass,
    RelativeLength,
    Temperature,
    Time,
)

_ARM_SCALE_M = 10.0
_CELL_SCALE_M = 100.0
_SERIAL_SCHEMES = ("socket", "rfc2217", "loop", "spy", "alt", "hwgrep")


_VERSION = 1


class Section(BaseModel):
    """A part of a profile: immutable, and no key passes that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")


def _plausible(value: float, limit_m: float) -> float:
    if abs(value) > limit_m:
        raise ValueError(f"{value:g} m is beyond {limit_m:g} m; a plain number is metres, write '{value:g} mm' for mm")
    return value


def _arm_length(value: float) -> float:
    return _plausible(value, _ARM_SCALE_M)


def _cell_length(value: float) -> float:
    return _plausible(value, _CELL_SCALE_M)


def _turns(value: float) -> float:
    if abs(value) > 4.0 * math.pi:
        raise ValueError(
            f"{value:g} rad is more than two turns; a plain number is radians, write '{value:g} deg' for degrees"
        )
    return value


ArmLength = Annotated[Length, AfterValidator(_arm_length)]
CellLength = Annotated[Length, AfterValidator(_cell_length)]
Turn = Annotated[Angle, AfterValidator(_turns)]
ArmPoint = tuple[ArmLength, ArmLength, ArmLength]
CellPoint = tuple[CellLength, CellLength, CellLength]


class Joint(Section):
    """One row of the D-H table with what else is known of that joint and of the body behind it.

    ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)``; a Hayati ``rot_y(beta)`` is added by the program where the
    next axis is nominally parallel. ``mass`` and ``center_of_mass`` are of the body fixed to D-H frame i.
    """

    theta: Turn = 0.0
    d: ArmLength = 0.0
    a: ArmLength = 0.0
    alpha: Turn = 0.0
    limit: tuple[Turn, Turn] = (-2.0 * math.pi, 2.0 * math.pi)
    speed: Annotated[AngularSpeed, Field(gt=0.0, le=10.0)] = math.pi / 2.0
    acceleration: Annotated[AngularAcceleration, Field(gt=0.0, le=100.0)] = math.pi / 2.0
    mass: Annotated[Mass, Field(ge=0.0, le=1000.0)] = 0.0
    center_of_mass: ArmPoint = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        if self.limit[0] >= self.limit[1]:
            raise ValueError(
                f"limit: the lower one ({self.limit[0]:g} rad) must be below the upper one ({self.limit[1]:g} rad)"
            )
        return self


class Capsule(Section):
    """A body for collision checks: all points within ``radius`` of a segment in D-H frame ``frame`` (0: base)."""

    frame: Annotated[int, Field(strict=True, ge=0)]
    start: ArmPoint
    end: ArmPoint
    radius: Annotated[ArmLength, Field(gt=0.0)]


class ArmType(Section):
    """A make of arm, as its maker publishes it; kept in a file of its own so that a new one is a file, not code."""

    model: str
    source: str = ""
    joints: Annotated[tuple[Joint, ...], Field(min_length=2)]
    capsules: tuple[Capsule, ...] = ()

    @model_validator(mode="after")
    def _frames_exist(self) -> Self:
        for index, capsule in enumerate(self.capsules):
            if capsule.frame > len(self.joints):
                raise ValueError(f"capsules[{index}].frame: {capsule.frame} is beyond the last, {len(self.joints)}")
        return self


class Pose(Section):
    """Where something stands in the cell frame: roll, pitch, yaw are ``R = rot_z(yaw) rot_y(pitch) rot_x(roll)``."""

    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)


class Smr(Section):
    """The retroreflector on a flange. ``offset: unknown`` lets the data find it; ``normal`` is the way it looks."""

    offset: ArmPoint | Literal["unknown"]
    normal: tuple[StrictFloat, StrictFloat, StrictFloat] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle, Field(gt=0.0, le=math.pi)] = math.radians(30.0)

    @field_validator("normal")
    @classmethod
    def _a_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not 0.9 < math.hypot(*value) < 1.1:
            raise ValueError("normal must be a unit vector in the flange frame")
        return value


class Payload(Section):
    """What the controller is told it carries: tool and load together, centre of mass in the flange frame."""

    mass: Annotated[Mass, Field(ge=0.0, le=1000.0)] = 0.0
    center_of_mass: ArmPoint = (0.0, 0.0, 0.0)


class SimulatedArmDriver(Section):
    """An arm of the simulated cell."""

    kind: Literal["simulated"]


class UrArmDriver(Section):
    """A UR controller. What is given of ``serial``, ``tcp`` and ``checksum`` is compared before the first motion."""

    kind: Literal["ur"]
    host: str
    serial: str | None = None
    timeout: Annotated[Time, Field(gt=0.0, le=60.0)] = 5.0
    startup_timeout: Annotated[Time, Field(ge=1.0, le=120.0)] = 15.0
    """For the client to connect and its program to start on the controller."""
    watchdog_hz: Annotated[float, Field(strict=True, ge=1.0, le=25.0)] = 5.0
    """The controller stops the arm when this computer falls silent for the inverse of it."""
    tcp: tuple[ArmLength, ArmLength, ArmLength, Turn, Turn, Turn] | None = None
    """Tool centre point set on the controller: position and rotation vector, as the pendant shows them."""
    checksum: str | None = None
    """Of the controller's calibrated D-H at the last calibration, as ``doctor`` shows it; a change warns."""
    payload_tolerance: Annotated[Mass, Field(gt=0.0, le=10.0)] = 0.05
    payload_center_tolerance: Annotated[ArmLength, Field(gt=0.0, le=0.5)] = 0.01
    settle_time: Annotated[Time, Field(ge=0.02, le=60.0)] = 0.2
    """The arm rests when no joint was faster than ``settle_speed`` nor left ``settle_window`` for so long."""
    settle_speed: Annotated[AngularSpeed, Field(gt=0.0, le=0.1)] = 0.005
    settle_window: Annotated[Angle, Field(gt=0.0, le=0.01)] = 2e-4


class NoDriver(Section):
    """No device: the readings come from a file."""

    kind: Literal["none"]


class Arm(Section):
    """One arm. ``base`` is its approximate pose in the cell; it is needed to plan and to point, not to calibrate."""

    type: ArmType
    driver: Annotated[SimulatedArmDriver | UrArmDriver | NoDriver, Field(discriminator="kind")]
    smr: Smr
    base: Pose | None = None
    payload: Payload = Payload()
    limits: tuple[tuple[Turn, Turn], ...] | None = None
    """Joint ranges of this cell where they are tighter than the type's."""
    home: tuple[Turn, ...] | None = None
    """Where the arm stands before and after a job [rad]; needed to plan."""
    speed_scale: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.5

    @model_validator(mode="after")
    def _one_limit_a_joint(self) -> Self:
        if self.limits is not None:
            joints = self.type.joints
            if len(self.limits) != len(joints):
                raise ValueError(f"limits: {len(self.limits)} ranges for the {len(joints)} joints of {self.type.model}")
            for number, ((low, high), joint) in enumerate(zip(self.limits, joints, strict=True), start=1):
                if low >= high or low < joint.limit[0] - 1e-9 or high > joint.limit[1] + 1e-9:
                    raise ValueError(
                        f"limits: joint {number} has [{low:g}, {high:g}] rad, which is not inside"
                        f" the type's [{joint.limit[0]:g}, {joint.limit[1]:g}] rad"
                    )
        return self


class SimulatedTrackerDriver(Section):
    """The tracker of the simulated cell."""

    kind: Literal["simulated"]


class Air(Section):
    """Air that the tracker shall correct the refraction with instead of what its own station measures."""

    temperature: Annotated[Temperature, Field(ge=-40.0, le=85.0)]
    pressure_hpa: Annotated[float, Field(strict=True, ge=500.0, le=1200.0)]
    humidity_percent: Annotated[float, Field(strict=True, ge=0.0, le=100.0)]


class LmfTrackerDriver(Section):
    """An AT960 through Leica's LMF, on the Windows PC it is wired to.

    ``serial`` is compared at each connect where it is given. ``stationary`` says who decides how long is averaged: the
    tracker by ``accuracy``, or ``tracker.averaging``. ``gravity`` levels the tracker.
    """

    kind: Literal["lmf"]
    address: Annotated[str, Field(min_length=1)]
    """IP address or host name, or one of LMF's simulators such as AT960LRSimulator#1."""
    serial: str | None = None
    reflector: Annotated[str, Field(max_length=60)] = ""
    """The reflector type as LMF names it, or its class such as RedRingReflector15; empty: what is selected there."""
    accuracy: Literal["fast", "standard", "precise"] = "standard"
    air: Air | None = None
    library: Annotated[str, Field(min_length=1)] = "LMF.Tracker.Connection"
    """Path of LMF.Tracker.Connection.dll, or its bare name where Python's path finds it."""
    stationary: Literal["accuracy", "time"] = "accuracy"
    power_lock: Annotated[bool, Field(strict=True)] = True
    search_radius: Annotated[CellLength, Field(gt=0.0)] | None = None
    wrong_target: Annotated[CellLength, Field(gt=0.0, le=1.0)] = 0.05
    shaking: Annotated[Length, Field(gt=0.0, le=0.01)] = 100e-6
    gravity: Annotated[bool, Field(strict=True)] = False
    target_words: tuple[str, ...] = ("target", "reflector")
    """Words by which LMF says that nothing is locked, which before pointing is no obstacle."""
    lost_numbers: tuple[Annotated[int, Field(strict=True)], ...] = (840702,)
    """LMF's error numbers of a lost target; Leica publishes no list."""
    timeout: Annotated[Time, Field(gt=0.0, le=120.0)] = 15.0
    """Of all that Leica recommends no limit for, pointing and searching included."""


_SOCKET_URL = re.compile(r"socket://(\[[0-9A-Fa-f:.]+\]|[^\s:/@?#\[\]]+):([0-9]{1,5})")


class BridgeTrackerDriver(Section):
    """A tracker served by ``cellapp tracker-bridge`` on another computer; see drivers/trackers/BRIDGE.md.

    ``url`` is what pyserial takes: ``socket://host:port``, ``rfc2217://host:port``, ``/dev/ttyUSB0``, ``COM3``. The
    shared token stands in the file ``token_file`` or in the environment variable named ``token_env``, never here.
    """

    kind: Literal["bridge"]
    url: Annotated[str, Field(min_length=1)]
    baud: Annotated[int, Field(strict=True, ge=300, le=4_000_000)] = 115200
    token_file: str | None = None
    token_env: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=100)] | None = None
    timeout: Annotated[Time, Field(ge=2.0, le=60.0)] = 5.0
    reflector: Annotated[str, Field(max_length=60)] = ""
    """The reflector type as the tracker's software names it; empty: what is selected there."""
    accuracy: Literal["fast", "standard", "precise"] = "standard"

    @field_validator("url")
    @classmethod
    def _a_port(cls, value: str) -> str:
        scheme, found, _ = value.partition("://")
        if found and scheme not in ("socket", "rfc2217", "spy", "alt", "hwgrep"):
            raise ValueError(f"pyserial has no {scheme}; write socket://host:port, rfc2217://host:port, or a device")
        if scheme == "socket" and found:
            match = _SOCKET_URL.fullmatch(value)
            if match is None or not 0 < int(match.group(2)) < 65536:
                raise ValueError("expected socket://host:port, as socket://192.168.0.20:50960")
        return value

    @field_validator("token_file")
    @classmethod
    def _found_from_anywhere(cls, value: str | None) -> str | None:
        if value is not None and not (value.startswith("~") or Path(value).is_absolute()):
            raise ValueError("write an absolute path, or one that begins with ~: a run knows its profile's text alone")
        return value

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        if self.token_file is not None and self.token_env is not None:
            raise ValueError("token_env: the token comes from token_file already; keep one of them")
        return self


class PermissibleError(Section):
    """A maximum permissible error ``constant + proportional * distance``; half of it is one standard deviation."""

    constant: Annotated[Length, Field(gt=0.0, le=0.01)]
    proportional: Annotated[RelativeLength, Field(ge=0.0, le=0.01)] = 0.0


class Tracker(Section):
    """The laser tracker, where it stands and what it can see. Its z axis points up, unless ``pose`` says otherwise."""

    driver: Annotated[
        SimulatedTrackerDriver | LmfTrackerDriver | BridgeTrackerDriver | NoDriver, Field(discriminator="kind")
    ]
    pose: Pose | None = None
    transverse: PermissibleError = PermissibleError(constant=15e-6, proportional=6e-6)
    range: PermissibleError = PermissibleError(constant=10e-6, proportional=0.3e-6)
    azimuth: tuple[Turn, Turn] = (-2.0 * math.pi, 2.0 * math.pi)
    elevation: tuple[Turn, Turn] = (math.radians(-55.0), math.radians(55.0))
    distance: tuple[CellLength, CellLength] = (1.0, 40.0)
    averaging: Annotated[Time, Field(gt=0.0, le=60.0)] = 1.0


class SimulatedSensor(Section):
    """The weather station of the simulated cell."""

    kind: Literal["simulated"]


class SensorUnits(Section):
    """Units of a line that does not name them."""

    temperature: Literal["degC", "degF", "K"] = "degC"
    object_temperature: Literal["degC", "degF", "K"] = "degC"
    pressure: Literal["hPa", "mbar", "kPa", "Pa", "bar", "mmHg", "inHg", "psi"] = "hPa"
    humidity: Literal["%"] = "%"


class SerialSensor(Section):
    """A weather station over any pyserial URL, one line a reading: a known ``format``, or a ``pattern``.

    The pattern must fit the whole line; its named groups are ``temperature`` and, where there are any, ``pressure``,
    ``humidity``, ``object_temperature``, and each with ``_unit`` behind it where the line names the unit.
    """

    kind: Literal["serial"]
    url: Annotated[str, Field(min_length=1)]
    format: Literal["vaisala-ptu300"] | None = None
    pattern: str | None = None
    units: SensorUnits = SensorUnits()
    poll: str | None = None
    """What is sent to get a line, line end included; "" for a station that sends by itself; left out: as usual."""
    poll_interval: Annotated[Time, Field(ge=0.1, le=3600.0)] = 5.0
    baud: Annotated[int, Field(strict=True, ge=50, le=4_000_000)] | None = None
    framing: Annotated[str, Field(pattern=r"^[5-8][NEO][12]$")] | None = None
    max_age: Annotated[Time, Field(gt=0.0, le=3600.0)] = 60.0
    timeout: Annotated[Time, Field(gt=0.0, le=60.0)] = 5.0
    """How long a first reading is waited for; longer than the pause between the lines of a station that sends."""

    @field_validator("url")
    @classmethod
    def _a_kind_that_pyserial_opens(cls, value: str) -> str:
        scheme, found, _ = value.partition("://")
        if found and scheme not in _SERIAL_SCHEMES:
            known = ", ".join(f"{name}://" for name in _SERIAL_SCHEMES)
            raise ValueError(f"'{scheme}://' is not known; write a device such as /dev/ttyUSB0 or COM3, or {known}")
        return value

    @model_validator(mode="after")
    def _one_format(self) -> Self:
        if (self.format is None) == (self.pattern is None):
            raise ValueError("format: give either format or pattern")
        if self.pattern is not None:
            try:
                groups = set(re.compile(self.pattern).groupindex)
            except re.error as error:
                raise ValueError(f"pattern: no regular expression: {error}") from None
            known = {name + end for name in SensorUnits.model_fields for end in ("", "_unit")}
            if "temperature" not in groups:
                raise ValueError("pattern: it has no group (?P<temperature>...)")
            if groups - known:
                unknown = ", ".join(sorted(groups - known))
                raise ValueError(f"pattern: group {unknown} is not known; known are {', '.join(sorted(known))}")
        return self


class Sensors(Section):
    """What measures the surroundings. Without ``air`` the tracker's own air temperature goes with the readings."""

    air: Annotated[SimulatedSensor | SerialSensor, Field(discriminator="kind")] | None = None


class Plan(Section):
    """How many stops, and what keeps them safe. ``floor`` is the height in C below which no body may reach."""

    stops: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 400
    clearance: Annotated[CellLength, Field(ge=0.0)] = 0.05
    floor: CellLength = 0.0
    ceiling: CellLength | None = None
    """Height in C above which no body may reach; left out, there is none."""
    ranges: tuple[tuple[Turn, Turn], ...] | None = None
    """Joint ranges drawn from, the same for all arms; else each arm's limits, at most one turn."""


class Splits(Section):
    """How the stops are used. ``rest`` is what the others leave. The pair's two draw from all common stops."""

    identify: Annotated[int, Field(strict=True, ge=1)] = 100
    train: Annotated[int, Field(strict=True, ge=0)] = 200
    validate_: Annotated[int, Field(strict=True, ge=1)] | Literal["rest"] = Field(default=100, alias="validate")
    pair_identify: Annotated[int, Field(strict=True, ge=1)] = 100
    pair_validate: Annotated[int, Field(strict=True, ge=1)] = 100


class Priors(Section):
    """One standard deviation by which the arm's own parameters are expected to leave their nominal values.

    None (left out) means no prior. Base and tool never have one.
    """

    length: Annotated[Length, Field(gt=0.0)] | None = None
    angle: Annotated[Angle, Field(gt=0.0)] | None = None


class Calibration(Section):
    """How the geometry is identified. ``robust`` down-weights readings that do not fit (Huber or Tukey weights)."""

    parameter_set: Literal["auto", "paper", "full"] = "auto"
    priors: Priors = Priors()
    robust: Literal["none", "huber", "tukey"] = "none"
    tolerance: Annotated[float, Field(strict=True, gt=0.0, le=1e-2)] = 1e-8
    max_iterations: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 50


class Network(Section):
    """The residual network: ``mlp`` trains one on what geometry leaves, ``none`` does without."""

    kind: Literal["mlp", "none"] = "mlp"
    folds: Annotated[int, Field(strict=True, ge=2, le=20)] = 5
    iterations: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 150


class Pair(Section):
    """The inter-base transform: from distances alone, as the paper does, or from the common tracker frame."""

    transform: Literal["distances", "tracker"] = "distances"


class Discovery(Section):
    """How missing effects are looked for: the false-alarm rate for the whole scan and the simulations that set it."""

    false_alarm: Annotated[float, Field(strict=True, gt=0.0, lt=0.5)] = 0.003
    null_simulations: Annotated[int, Field(strict=True, ge=20, le=100_000)] = 400
    folds: Annotated[int, Field(strict=True, ge=2, le=50)] = 5


class GeometryErrors(Section):
    """One standard deviation of each error of the true cell against the nominal one; all zero is a perfect cell."""

    length: Annotated[Length, Field(ge=0.0)] = 0.3e-3
    angle: Annotated[Angle, Field(ge=0.0)] = math.radians(0.05)
    base_length: Annotated[Length, Field(ge=0.0)] = 5e-3
    base_angle: Annotated[Angle, Field(ge=0.0)] = math.radians(0.3)
    smr: Annotated[Length, Field(ge=0.0)] = 1e-3
    mass: Annotated[float, Field(strict=True, ge=0.0, lt=1.0)] = 0.0
    """Of the mass of each body, as a share of the nominal one."""


class Plant(Section):
    """The simulated cell behind the simulated drivers. ``effects`` names the hidden physics of each arm."""

    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    geometry: GeometryErrors = GeometryErrors()
    repeatability: Annotated[Angle, Field(ge=0.0)] = 0.0
    temperature: Temperature = 20.0
    noise: Annotated[bool, Field(strict=True)] = True
    effects: dict[str, dict[str, dict[str, Any]]] = {}
    """arm -> effect -> parameters; see drivers/plant for the effects and their parameters."""


class Profile(Section):
    """A whole cell."""

    schema_: Literal["cellapp-profile"] = Field(alias="schema")
    version: Literal[1]
    name: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    arms: Annotated[dict[str, Arm], Field(min_length=1)]
    tracker: Tracker
    sensors: Sensors = Sensors()
    plan: Plan = Plan()
    splits: Splits = Splits()
    calibration: Calibration = Calibration()
    network: Network = Network()
    pair: Pair = Pair()
    discovery: Discovery = Discovery()
    plant: Plant | None = None
    targets: str | None = None
    """A target list, relative to the profile's file; used by ``run``."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        simulated = [name for name, arm in self.arms.items() if arm.driver.kind == "simulated"]
        air = self.sensors.air
        if air is not None and air.kind == "simulated" and self.plant is None:
            raise ValueError("sensors.air: a simulated station needs a section 'plant' that it measures")
        if (simulated or self.tracker.driver.kind == "simulated") and self.plant is None:
            raise ValueError("plant: simulated drivers need a section 'plant' that says what they simulate")
        if self.plant is not None:
            for name in self.plant.effects:
                if name not in self.arms:
                    raise ValueError(f"plant.effects.{name}: there is no such arm; arms are {', '.join(self.arms)}")
        for name, arm in self.arms.items():
            if arm.driver.kind != "none":
                needed = {
                    f"arms.{name}.base": arm.base,
                    f"arms.{name}.home": arm.home,
                    "tracker.pose": self.tracker.pose,
                }
                for key, value in needed.items():
                    if value is None:
                        raise ValueError(f"{key}: missing; arm {name} has a driver, and to plan and to point needs it")
            if arm.home is not None and len(arm.home) != len(arm.type.joints):
                raise ValueError(f"arms.{name}.home: {len(arm.home)} positions for {len(arm.type.joints)} joints")
            if self.plan.ranges is not None and len(self.plan.ranges) != len(arm.type.joints):
                raise ValueError(
                    f"plan.ranges: {len(self.plan.ranges)} ranges for the {len(arm.type.joints)} joints of arm {name}"
                )
        return self


# -- the loader -------------------------------------------------------------------------------------------------------

_SHOWN = 5
_MOST_LEVELS = 50
_MOST_VALUES = 100_000
_LARGEST_INT = 2**63
_SURROGATE = frozenset(map(chr, range(0xD800, 0xE000)))
_MISSING = ": missing; it must be given"
_Key = str | int
_Path = tuple[_Key, ...]


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, which also takes 1e-8 and 2.5e4 for numbers (YAML 1.1 would leave texts)."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+"),
    list("-+.0123456789"),
)


@dataclass(frozen=True)
class _Place:
    """Where a value was written: file, line, and its path inside that file."""

    file: str
    line: int
    inside: _Path


@dataclass
class _Written:
    """A profile as plain data, with the place of each of its values."""

    data: Any = None
    places: dict[_Path, _Place] = field(default_factory=dict)


def load_profile(path: Path) -> Profile:
    """Read and check a profile.

    ``type`` of an arm may be the path of an arm-type file, relative to the profile's file.

    Raises
    ------
    InputError
        One clear sentence for each of the first few things that are wrong, with file, line and key.
    """
    path = Path(path)
    written = _read_yaml(path)
    _check_version(written)
    arms = written.data.get("arms")
    for name, arm in (arms if isinstance(arms, dict) else {}).items():
        if isinstance(arm, dict) and isinstance(arm.get("type"), str):
            at: _Path = ("arms", name, "type")
            _splice(written, at, _read_arm_type(path, arm["type"], written.places[at]))
            arm["type"] = written.data["arms"][name]["type"]
    return _validated(written)


def profile_to_json(profile: Profile) -> str:
    """A profile as one JSON text that needs no other file; ``profile_from_json`` gives back an equal profile."""
    return profile.model_dump_json(by_alias=True)


def profile_from_json(text: str) -> Profile:
    """The profile that ``profile_to_json`` wrote. Raises ``InputError`` if the text is none."""
    try:
        return Profile.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(key) for key in first["loc"])
        raise InputError(f"stored profile: {where or 'text'}: {_plain(first['msg'])}") from None


def _read_arm_type(profile: Path, name: str, place: _Place) -> _Written:
    path = profile.parent / name
    try:
        there = path.is_file()
    except OSError:  # for one, a name longer than any file's
        there = False
    if not there:
        raise InputError(
            f"{_where(place)}: there is no file {_short(str(path), 200)}; give a path relative to the profile's file,"
            " or the keys here"
        )
    return _read_yaml(path)


def _splice(written: _Written, at: _Path, part: _Written) -> None:
    parent = written.data
    for key in at[:-1]:
        parent = parent[key]
    parent[at[-1]] = part.data
    for path, place in part.places.items():
        written.places[at + path] = place


# -- YAML with its lines


def _read_yaml(path: Path) -> _Written:
    text = _read_text(path)
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            raise InputError(f"{path}: the file is empty; expected a mapping of keys to values")
        if not isinstance(node, yaml.MappingNode):
            raise InputError(f"{path}:{_line(node)}: expected keys with values at the top, got {_kind(node)}")
        written = _Written()
        written.data = _plain_data(node, (), _Place(str(path), _line(node), ()), written.places, loader)
        return written
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        problem = error.problem or error.context
        raise InputError(f"{path}{line}: not YAML: {problem}; check indentation and quotes") from None
    except yaml.YAMLError as error:
        position = getattr(error, "position", None)
        line = f":{text.count(chr(10), 0, position) + 1}" if position is not None else ""
        raise InputError(f"{path}{line}: not YAML: {getattr(error, 'reason', error)}; remove that character") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply; a profile has a handful of levels") from None


def _read_text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; give a profile such as profiles/twin.yaml") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a profile") from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: not UTF-8 text ({error.reason}); save the file as UTF-8") from None


def _plain_data(node: yaml.Node, at: _Path, place: _Place, places: dict[_Path, _Place], loader: _Loader) -> Any:
    """A node as dict, list, text, number, bool or None; notes its place and those of all below it."""
    if len(at) > _MOST_LEVELS:  # an alias may contain itself
        raise InputError(f"{_where(place)}: nested too deeply; a profile has a handful of levels")
    if len(places) > _MOST_VALUES:  # aliases of aliases multiply
        raise InputError(f"{place.file}: more than {_MOST_VALUES} values; a profile has some hundreds")
    places[at] = place
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for key_node, value_node in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key is None or key_node.tag != "tag:yaml.org,2002:str":
                text = f"'{_short(key)}' is" if key is not None else "this is"
                raise InputError(f"{place.file}:{_line(key_node)}: {text} no key; a key is a word, or put it in quotes")
            here = _Place(place.file, _line(key_node), (*place.inside, key))
            if key in result:
                raise InputError(f"{_where(here)}: the key is there twice (first in line {lines[key]}); keep one")
            lines[key] = here.line
            result[key] = _plain_data(value_node, (*at, key), here, places, loader)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [
            _plain_data(item, (*at, index), _Place(place.file, _line(item), (*place.inside, index)), places, loader)
            for index, item in enumerate(node.value)
        ]
    return _scalar(node, place, loader)


def _scalar(node: yaml.Node, place: _Place, loader: _Loader) -> str | int | float | bool | None:
    kind = node.tag.removeprefix("tag:yaml.org,2002:")
    if kind == "timestamp":
        return str(node.value)
    if kind not in ("str", "int", "float", "bool", "null"):
        raise InputError(f"{_where(place)}: '{node.tag}' is not used in profiles; write a number, a text or true/false")
    try:
        value: str | int | float | bool | None = loader.construct_object(node)
    except (ValueError, KeyError):
        raise InputError(
            f"{_where(place)}: '{_short(node.value)}' is no {kind}; write a number, a text, true or false"
        ) from None
    endless = isinstance(value, float) and not math.isfinite(value)
    if endless and (value != math.inf or place.inside[:2] != ("plant", "effects")):  # there it is a stiff joint
        raise InputError(f"{_where(place)}: expected a finite number, got {node.value}")
    if isinstance(value, str) and not _SURROGATE.isdisjoint(value):
        raise InputError(f"{_where(place)}: half a character (an escape such as \\ud800); write the whole character")
    if isinstance(value, int) and abs(value) > _LARGEST_INT:
        raise InputError(f"{_where(place)}: {str(node.value)[:20]}... is too large a number")
    return value


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


def _kind(value: object) -> str:
    """What a person would call a value."""
    match value:
        case yaml.SequenceNode():
            return "a list"
        case yaml.ScalarNode():
            return f"'{_short(value.value)}'"
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case str():
            return f"'{_short(value)}'"
        case dict():
            return "keys with values"
        case list() | tuple():
            return f"a list of {len(value)}"
        case _:
            return str(value)


def _short(text: str, most: int = 60) -> str:
    """A text of a profile in one line of a message."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[: most - 3] + "..."


def _where(place: _Place) -> str:
    key = _dotted(place.inside)
    return f"{place.file}:{place.line}: {key}" if key else f"{place.file}:{place.line}"


def _dotted(path: Sequence[_Key]) -> str:
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{_short(key)}" for key in path)
    return text.removeprefix(".")


# -- what pydantic found, for a person


def _check_version(written: _Written) -> None:
    version = written.data.get("version")
    if isinstance(version, int) and not isinstance(version, bool) and version > _VERSION:
        raise InputError(
            f"{_where(written.places['version',])}: this profile is of version {version}, this cellapp knows up to"
            f" {_VERSION}; install a newer cellapp"
        )


def _validated(written: _Written) -> Profile:
    try:
        return Profile.model_validate(written.data)
    except ValidationError as error:
        found: dict[tuple[_Path, str], list[str]] = {}
        for details in _of_the_meant_branch(error.errors(include_url=False), written.places):
            at, message = _told(details, written)
            missing = message.partition(": ")[0] if message.endswith(_MISSING) else ""
            texts = found.setdefault((at, missing), [])
            if message not in texts:
                texts.append(message)
        told = [(written.places[at], texts) for (at, _), texts in found.items()]
        ordered = sorted(told, key=lambda entry: (entry[0].file, entry[0].line))
        lines = [_sentence(place, texts) for place, texts in ordered]
        more = [f"and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
        raise InputError("\n".join(lines[:_SHOWN] + more)) from None


def _of_the_meant_branch(errors: Sequence[ErrorDetails], places: dict[_Path, _Place]) -> Iterator[ErrorDetails]:
    """Leave out that a list is not the word which might stand in its place where more is said of that list."""
    paths = [_walk(details["loc"], places)[0] for details in errors]
    for index, (at, details) in enumerate(zip(paths, errors, strict=True)):
        others = paths[:index] + paths[index + 1 :]
        word = details["type"] == "literal_error" and isinstance(details["input"], list | tuple | dict)
        if not (word and any(other[: len(at)] == at for other in others)):
            yield details


def _sentence(place: _Place, texts: Sequence[str]) -> str:
    first, rest = texts[0], texts[1:]
    if rest:  # alternatives of one value: "expected A, got x" and "expected B, got x"
        expected = [text.removeprefix("expected ").partition(", got ")[0] for text in texts]
        first = f"expected {' or '.join(expected)}, got {texts[0].partition(', got ')[2]}"
    first = _short(first, 300)
    return f"{_where(place)}: {first}" if not first.startswith(".") else f"{_where(place)}{first}"


def _told(details: ErrorDetails, written: _Written) -> tuple[_Path, str]:
    """Where an error is (a path that was written), and what it is; one with a dot in front goes on with the key."""
    at, rest = _walk(details["loc"], written.places)
    context = details.get("ctx", {})
    value = details["input"]
    got = _kind(value)
    match details["type"]:
        case "extra_forbidden":
            return at, _unknown_key(details["loc"])
        case "missing" if rest and isinstance(rest[-1], int):
            count = _how_many(details["loc"], rest[-1] + 1)
            return at, f"expected {count} values, got {_kind(_value(written.data, at))}"
        case "missing":
            dot = "." if written.places[at].inside else ""
            return at, f"{dot}{rest[-1]}{_MISSING}"
        case "union_tag_not_found":
            return at, f".{str(context['discriminator']).strip(chr(39))}{_MISSING}"
        case "union_tag_invalid":
            kind = str(context["discriminator"]).strip("'")
            below = (*at, kind)
            message = f"expected {_choices(str(context['expected_tags']))}, got '{context['tag']}'"
            return (below, message) if below in written.places else (at, message)
        case "value_error":
            return _own_message(at, _plain(details["msg"]), written.places)
        case "literal_error":
            near = difflib.get_close_matches(str(value), re.findall(r"'([^']*)'", str(context["expected"])), n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            return at, f"expected {_choices(str(context['expected']))}, got {got}{hint}"
        case "greater_than":
            return at, f"expected more than {context['gt']:g}{_si(value)}, got {got}"
        case "greater_than_equal":
            return at, f"expected at least {context['ge']:g}{_si(value)}, got {got}"
        case "less_than":
            return at, f"expected less than {context['lt']:g}{_si(value)}, got {got}"
        case "less_than_equal":
            return at, f"expected at most {context['le']:g}{_si(value)}, got {got}"
        case "too_long":
            return at, f"expected at most {context['max_length']} values, got {_kind(_value(written.data, at))}"
        case "too_short":
            return at, f"expected at least {context['min_length']} values, got {got}"
        case "string_too_short":
            return at, "expected a text, got an empty one"
        case kind if kind in _EXPECTED:
            hint = "; put it in quotes" if kind == "string_type" and isinstance(value, int | float) else ""
            return at, f"expected {_EXPECTED[kind]}, got {got}{hint}"
        case _:
            return at, _plain(details["msg"])


_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "keys with values",
    "model_type": "keys with values",
    "model_attributes_type": "keys with values",
}


def _walk(location: Sequence[_Key], places: dict[_Path, _Place]) -> tuple[_Path, list[_Key]]:
    """The written path nearest to pydantic's location, which also names the branches of unions, and what is left."""
    at: _Path = ()
    rest: list[_Key] = []
    for key in location:
        if (*at, key) in places:
            at, rest = (*at, key), []
        else:
            rest.append(key)
    return at, rest


def _value(data: Any, at: _Path) -> Any:
    for key in at:
        data = data[key]
    return data


def _own_message(at: _Path, message: str, places: dict[_Path, _Place]) -> tuple[_Path, str]:
    """Our own validators begin with the key below the section they check; move it into the place."""
    match = re.match(r"([A-Za-z_][\w.\[\]]*): ", message)
    if match:
        keys = tuple(int(key) if key.isdigit() else key for key in re.findall(r"\w+", match.group(1)))
        known = next(count for count in range(len(keys), -1, -1) if (*at, *keys[:count]) in places)
        here = (*at, *keys[:known])
        dot = "." if keys[known:] and isinstance(keys[known], str) and places[here].inside else ""
        rest = f"{dot}{_dotted(keys[known:])}: " if keys[known:] else ""
        return here, rest + message[match.end() :]
    return at, message


def _plain(message: str) -> str:
    return message.removeprefix("Value error, ").replace("got NoneType", "got nothing")


def _si(value: object) -> str:
    """Limits are in SI; say so where a text with a unit was given."""
    return " (SI)" if isinstance(value, str) else ""


def _choices(expected: str) -> str:
    words = re.findall(r"'[^']*'", expected)
    return expected if len(words) < 2 else f"{', '.join(words[:-1])} or {words[-1]}"


def _how_many(location: Sequence[_Key], least: int) -> int:
    """Length of the tuple whose item at the end of ``location`` is missing."""
    fixed = [get_args(hint) for hint in _hints_at(location[:-1]) if get_origin(hint) is tuple]
    return max((len(items) for items in fixed if ... not in items), default=least)


def _unknown_key(location: Sequence[_Key]) -> str:
    known = [name for hint in _hints_at(location[:-1]) for name in _fields_of(hint)]
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    if near:
        return f"unknown key; did you mean '{near[0]}'?"
    return f"unknown key; known here are {', '.join(known)}"


def _hints_at(location: Sequence[_Key]) -> list[Any]:
    """The types that may stand at a location of the profile."""
    hints: list[Any] = [Profile]
    for key in location:
        below: list[Any] = []
        for hint in hints:
            if isinstance(key, str) and key in _fields_of(hint):
                below += _alternatives(_fields_of(hint)[key])
            elif get_origin(hint) is dict:
                below += _alternatives(get_args(hint)[1])
            elif get_origin(hint) is tuple and isinstance(key, int):
                below += _alternatives(get_args(hint)[0])
            elif isinstance(key, str) and "kind" in _fields_of(hint) and key in get_args(_fields_of(hint)["kind"]):
                below.append(hint)  # the branch of a union that was chosen by its kind
        hints = below or hints
    return hints


def _fields_of(hint: Any) -> dict[str, Any]:
    if isinstance(hint, type) and issubclass(hint, Section):
        return {info.alias or name: info.annotation for name, info in hint.model_fields.items()}
    return {}


def _alternatives(hint: Any) -> Iterator[Any]:
    if get_origin(hint) is Annotated:
        yield from _alternatives(get_args(hint)[0])
    elif get_origin(hint) in (Union, UnionType):
        for part in get_args(hint):
            yield from _alternatives(part)
    elif hint is not NoneType:
        yield hint
