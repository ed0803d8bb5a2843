"""Sections of a profile: collection, plan, SMR, controller table, obstacles, acceptance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import date
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    StrictFloat,
    field_validator,
    model_serializer,
    model_validator,
)

from cellapp.ground.results import DecisionRule
from drivers.quantities import Angle, ArmLength, CellLength, Length, Temperature, Time, Turn
from drivers.settings import Section

# -- Base of sections of a profile that got keys later ----------------------------------------------------------------


class GrownSection(Section):
    """A section that got keys later: profiles without them keep the JSON text, and so the hash, of earlier results."""

    later_keys: ClassVar[frozenset[str]] = frozenset()
    """Left out of the JSON where they have their defaults."""

    @model_serializer(mode="wrap")
    def _without_later_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = handler(self)
        fields = type(self).model_fields
        usual = {
            key for key in self.later_keys if getattr(self, key) == fields[key].get_default(call_default_factory=True)
        }
        return {key: value for key, value in content.items() if key not in usual}


# -- The profile's section ``collection``: how stops are measured, what is waited for, when the job ends --------------

CellPoint = tuple[CellLength, CellLength, CellLength]


class Reference(Section):
    """Reference measurements: both arms at home, and fixed nests, every ``every`` stops and at the end; 0: none."""

    every: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    drift: Annotated[Length, Field(gt=0.0, le=0.01)] = 100e-6
    """Largest accepted distance of a reference from its first measurement."""
    nests: dict[str, CellPoint] = Field(default_factory=dict)
    """Fixed nests with an SMR: name -> position in the cell frame C."""


class Repeat(Section):
    """Repetition of a measurement until the standard deviation of its mean is below ``precision``; None: one each."""

    precision: Annotated[Length, Field(gt=0.0, le=0.01)] | None = None
    times: Annotated[int, Field(strict=True, ge=2, le=50)] = 5
    """Most measurements of one SMR at one stop."""


class SlowStart(Section):
    """The first motions on real hardware: their number, and the share of the usual speed."""

    stops: Annotated[int, Field(strict=True, ge=0, le=1000)] = 3
    speed: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.2


class Finish(Section):
    """An early end: when the standard uncertainty of predicted positions of every arm is below ``standard_error``."""

    standard_error: Annotated[Length, Field(gt=0.0, le=0.01)] | None = None
    least_stops: Annotated[int, Field(strict=True, ge=10, le=100_000)] = 60


class AirLimits(Section):
    """Air temperatures at which measuring is allowed."""

    temperature: tuple[Temperature, Temperature] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.temperature is not None and self.temperature[0] >= self.temperature[1]:
            raise ValueError("temperature: the lower limit must be below the upper one")
        return self


class Suspension(Section):
    """Waiting for a cause to pass: at most ``times`` in a session, each at most ``wait``. 0 times: never."""

    times: Annotated[int, Field(strict=True, ge=0, le=1000)] = 10
    wait: Annotated[Time, Field(gt=0.0, le=86_400.0)] = 20.0
    retry: Annotated[Time, Field(gt=0.0, le=3600.0)] = 2.0
    """Time between two tries."""


class Suspend(Section):
    """Causes that are no danger and for which collection waits and continues by itself.

    Faults of an arm and safety stops are not here: they always need a person.
    """

    target: Suspension = Suspension()
    """The beam is broken, or no SMR is found where one should be."""
    air: Suspension = Suspension(times=10, wait=1800.0, retry=30.0)
    """The air is out of ``air.temperature``."""
    drift: Suspension = Suspension(times=5, wait=600.0, retry=60.0)
    """A reference measurement is out of ``reference.drift``."""
    tracker_warm_up: Suspension = Suspension(times=0, wait=3600.0, retry=10.0)
    """The tracker is not ready to measure: it warms up, or lacks something that a person must do. Opt-in."""
    host_stall: Suspension = Suspension(times=0, wait=30.0, retry=1.0)
    """This computer was silent, so that a controller's watchdog stopped its arm. Opt-in."""


class Collection(Section):
    """How planned stops are measured."""

    reference: Reference = Reference()
    warm_up: Annotated[Time, Field(ge=0.0, le=14_400.0)] = 0.0
    """The arms exercise along planned stops for this time before the first measurement."""
    repeat: Repeat = Repeat()
    slow_start: SlowStart = SlowStart()
    finish: Finish = Finish()
    air: AirLimits = AirLimits()
    suspend: Suspend = Suspend()
    motion_rate: Annotated[float, Field(strict=True, ge=5.0, le=1000.0)] = 250.0
    """Points of the tracker in a second while an arm sweeps [1/s]; a serial line carries 150."""
    tolerated: Annotated[float, Field(strict=True, ge=0.0, le=1.0)] = 0.05
    """Share of planned measurements that may be missing at the end without a failure."""


# -- The profile's section ``plan``: number of stops, what keeps them safe, what they shall tell ----------------------

CANDIDATES_PER_STOP, OF_SMALL_PLANS = 12, 50
ENOUGH_CANDIDATES, MOST_CANDIDATES = 5_000, 20_000


class Plan(Section):
    """Number of stops and how they are chosen. ``floor`` is the height in C below which no body may reach.

    ``method``: ``designed`` chooses the stops that tell most about geometry and effects, with planned approach, dwell
    and order; ``random`` samples them, with straight ways.
    """

    stops: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 400
    clearance: Annotated[CellLength, Field(ge=0.0)] = 0.05
    floor: CellLength = 0.0
    ceiling: CellLength | None = None
    """Height in C above which no body may reach; None: no ceiling."""
    reserve: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    """Further stops, planned after the others; each replaces one that could not be measured."""
    ranges: tuple[tuple[Turn, Turn], ...] | None = None
    """Joint ranges to sample from, for all arms; None: the limits of each arm, at most one turn."""
    method: Literal["designed", "random"] = "designed"
    candidates: Annotated[int, Field(strict=True, ge=100, le=1_000_000)] | None = None
    """Random configurations of each arm from which, and near the best of which, a design is chosen; None: 50 a stop, at
    most 5000, or 12 a stop."""
    effects: tuple[str, ...] | None = None
    """Slugs of the effects whose coefficients the stops shall tell; None: all that the program knows."""
    incidence: Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0)] = math.radians(20.0)
    """Angle between beam and the SMR's viewing direction up to which the tracker has its full accuracy."""
    steps: tuple[Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0)], ...] = (math.radians(2.0), math.radians(8.0))
    """Sizes of each joint's last motion before a stop; its side is planned too. Empty: straight ways."""
    dwell: Annotated[tuple[Annotated[Time, Field(ge=0.0, le=600.0)], ...], Field(min_length=1)] = (0.0,)
    """Rests before a measurement that are varied, beside the settling that the arm needs."""
    repeats: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 10
    """Of the stops, those that visit an earlier configuration again, from the other side of every joint."""
    blocks: Annotated[int, Field(strict=True, ge=1, le=1000)] | None = None
    """Parts of the run in random order, so that drift in time is not confounded with posture; None: by the stops."""
    other_arm: Literal["resting", "swinging"] = "resting"
    """What the other arm does while one sweeps; swinging, it is recorded beside and not measured."""
    largest_gap: Annotated[Angle, Field(gt=0.0, le=2.0 * math.pi)] | None = None
    """Largest part of any joint's travelled range without a stop; None: as the number of stops allows."""

    @property
    def pool_size(self) -> int:
        """Number of candidate configurations of each arm."""
        stops = self.stops + self.reserve
        of_large = min(CANDIDATES_PER_STOP * stops, MOST_CANDIDATES)
        return self.candidates or min(OF_SMALL_PLANS * stops, max(ENOUGH_CANDIDATES, of_large))

    def reserves(self, total: int) -> range:
        """Return the numbers of the reserve stops in a plan of ``total`` stops: they follow the asked ones."""
        return range(min(self.stops, total), min(self.stops + self.reserve, total))


# -- What is on a flange for the tracker to see: an SMR or a 6-D probe ------------------------------------------------

ArmPoint = tuple[ArmLength, ArmLength, ArmLength]


class Probe(Section):
    """A 6-D probe, as a T-Mac, whose origin the SMR is.

    ``rpy`` is the rotation of its frame in the flange frame, which is identified from the data either way; a
    simulated cell needs it. ``sigma`` is the standard uncertainty of a measured orientation about each axis.
    """

    rpy: tuple[Turn, Turn, Turn] | Literal["unknown"] = "unknown"
    sigma: Annotated[Angle, Field(gt=0.0, le=0.1)] = 40e-6


class Smr(GrownSection):
    """The retroreflector on a flange.

    ``offset: unknown`` identifies it from the data. ``normal`` is the viewing direction, ``acceptance`` the half-angle
    about it within which the SMR returns the beam. With a ``probe`` its orientation is measured as well.
    """

    offset: ArmPoint | Literal["unknown"]
    normal: tuple[StrictFloat, StrictFloat, StrictFloat] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle, Field(gt=0.0, le=math.pi)] = math.radians(30.0)
    probe: Probe | None = None
    later_keys = frozenset({"probe"})

    @field_validator("normal")
    @classmethod
    def _unit_vector(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not 0.9 < math.hypot(*value) < 1.1:
            raise ValueError("normal must be a unit vector in the flange frame")
        return value


# -- The calibration that a controller brings from the factory: what it adds to the published D-H rows of its arm -----

_Deltas = tuple[Annotated[float, Field(strict=True, ge=-1e5, le=1e5)], ...]


class ControllerTable(Section):
    """Deltas of the D-H rows of a controller [rad, m, m, rad], one of each joint; plain rows, so that d may be large.

    ``checksum`` is that of the calibration in the controller, as ``doctor`` shows it; empty if the file has none.
    """

    delta_theta: _Deltas
    delta_d: _Deltas
    delta_a: _Deltas
    delta_alpha: _Deltas
    checksum: str = ""

    @property
    def deltas(self) -> tuple[_Deltas, _Deltas, _Deltas, _Deltas]:
        """Columns theta, d, a, alpha."""
        return self.delta_theta, self.delta_d, self.delta_a, self.delta_alpha

    @model_validator(mode="after")
    def _as_long_as_each_other(self) -> Self:
        lengths = [len(column) for column in self.deltas]
        if len(set(lengths)) > 1:
            raise ValueError(f"delta_theta, delta_d, delta_a, delta_alpha have {lengths} values, one a joint is needed")
        return self


# The profile's section ``obstacles``: what stands in the cell, or is mounted on an arm, beside the arms themselves.

Size = Annotated[CellLength, Field(gt=0.0)]


class Placement(Section):
    """Pose of an obstacle in the frame that it is fixed to; ``rpy``: ``R = rot_z(yaw) rot_y(pitch) rot_x(roll)``."""

    position: tuple[CellLength, CellLength, CellLength] = (0.0, 0.0, 0.0)
    rpy: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)


class Obstacle(Section):
    """What all shapes share. ``fixed_to``: the cell frame C, or base or flange of ``arm``."""

    fixed_to: Literal["cell", "base", "flange"] = "cell"
    arm: str | None = None
    pose: Placement = Placement()

    @model_validator(mode="after")
    def _arm_where_needed(self) -> Self:
        if (self.fixed_to == "cell") != (self.arm is None):
            need = "must not be given" if self.fixed_to == "cell" else "is missing"
            raise ValueError(f"arm: {need} for an obstacle that is fixed to the {self.fixed_to}")
        return self


class BoxObstacle(Obstacle):
    """A box with its centre at the pose; ``size`` are its full lengths along x, y, z."""

    shape: Literal["box"]
    size: tuple[Size, Size, Size]


class CylinderObstacle(Obstacle):
    """A cylinder with flat ends, its axis along z, its centre at the pose."""

    shape: Literal["cylinder"]
    radius: Size
    length: Size


class CapsuleObstacle(Obstacle):
    """All points within ``radius`` of a segment of ``length`` along z, its centre at the pose."""

    shape: Literal["capsule"]
    radius: Size
    length: Size


class SphereObstacle(Obstacle):
    """A sphere with its centre at the pose."""

    shape: Literal["sphere"]
    radius: Size


class MeshObstacle(Obstacle):
    """A triangle mesh from an STL file, relative to the profile; ``scale`` converts its unit to metres."""

    shape: Literal["mesh"]
    file: str
    scale: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0


AnyObstacle = Annotated[
    BoxObstacle | CylinderObstacle | CapsuleObstacle | SphereObstacle | MeshObstacle, Field(discriminator="shape")
]
Obstacles = dict[str, AnyObstacle]
"""Name -> obstacle."""


# The profile's sections ``tolerances`` and ``traceability``: what a cell is accepted by, who measured it with what.

MpeRule = Literal["rectangular", "half"]
"""The standard uncertainty that a maximum permissible error stands for: ``rectangular`` takes any error up to it as
equally likely, MPE / sqrt 3 (JCGM 100, 4.3.7); ``half`` is MPE / 2, for who knows that errors are mostly smaller."""
MPE_SHARE: Mapping[MpeRule, float] = {"rectangular": 1.0 / math.sqrt(3.0), "half": 0.5}

Tolerance = Annotated[Length, Field(gt=0.0, le=0.1)]


def _span_of(value: object) -> object:
    """One number stands for a quantity that did not change."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if isinstance(value, str | bool):
        raise ValueError(f"expected a number, or the smallest and the largest in brackets, got {value!r}")
    return value


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError(f"expected the smaller value first, got {span[0]:g} and {span[1]:g}")
    return span


Pressure = Annotated[float, Field(strict=True, ge=300.0, le=1200.0)]
Humidity = Annotated[float, Field(strict=True, ge=0.0, le=100.0)]
PressureSpan = Annotated[tuple[Pressure, Pressure], BeforeValidator(_span_of), AfterValidator(_in_order)]
"""Smallest and largest absolute pressure [hPa]."""
HumiditySpan = Annotated[tuple[Humidity, Humidity], BeforeValidator(_span_of), AfterValidator(_in_order)]
"""Smallest and largest relative humidity [%]."""


class Tolerances(GrownSection):
    """Largest permissible errors of a cell; what is left out is not judged.

    ``position`` is the distance of an arm's SMR from where it was commanded, at any target; ``orientation`` the angle
    of its flange from the wanted rotation, where a probe measures that; ``distance`` the error of the distance between
    two positions of one arm; ``cooperative`` the error of the distance between the SMRs of two arms,
    ``cooperative_orientation`` the angle of one flange in the other's frame from the wanted one, where both have a
    probe. The others are the characteristics of ISO 9283. ``decision`` and ``mpe`` say how all of them are judged, and
    the tolerances of targets and paths.
    """

    position: Tolerance | None = None
    orientation: Annotated[Angle, Field(gt=0.0, le=0.02)] | None = None
    distance: Tolerance | None = None
    cooperative: Tolerance | None = None
    cooperative_orientation: Annotated[Angle, Field(gt=0.0, le=0.02)] | None = None
    pose_accuracy: Tolerance | None = None
    pose_repeatability: Tolerance | None = None
    multidirectional: Tolerance | None = None
    distance_accuracy: Tolerance | None = None
    distance_repeatability: Tolerance | None = None
    drift: Tolerance | None = None
    path_accuracy: Tolerance | None = None
    path_repeatability: Tolerance | None = None
    decision: DecisionRule = "guarded"
    mpe: MpeRule = "rectangular"

    later_keys = frozenset({"mpe", "orientation", "cooperative_orientation"})

    @property
    def covariance_factor(self) -> float:
        """Factor for a tracker's covariance: drivers take half of the maximum permissible error as sigma."""
        return (MPE_SHARE[self.mpe] / MPE_SHARE["half"]) ** 2

    @property
    def any_given(self) -> bool:
        """Whether anything is judged."""
        rules = ("decision", "mpe")
        return any(getattr(self, name) is not None for name in type(self).model_fields if name not in rules)


class Instrument(Section):
    """A measuring instrument or standard as its calibration certificate describes it."""

    model: str = ""
    serial: str = ""
    calibrated: date | None = None
    due: date | None = None
    certificate: str = ""
    """Number of its calibration certificate, and the laboratory."""

    @model_validator(mode="after")
    def _dates_in_order(self) -> Self:
        if self.calibrated is not None and self.due is not None and self.due <= self.calibrated:
            raise ValueError(f"due: {self.due} is not after 'calibrated' ({self.calibrated})")
        return self


class TraceableArm(Section):
    """What identifies an arm that its controller does not tell: serial number of the arm itself, name in the plant."""

    serial: str = ""
    asset: str = ""


class Traceability(GrownSection):
    """Who measured with what, for certificates. What is left out is reported as not given, never assumed.

    ``client`` is for whom the certificate is made, with the address; ``procedure`` the written procedure of the
    organisation by which one measured, with its revision. ``air_pressure`` [hPa] and ``relative_humidity`` [%] are
    those while measuring: a number, or the smallest and the largest. ``smr_centering`` is the standard uncertainty of
    the SMR's optical centre in its sphere and nest, ``air_temperature_uncertainty`` that of the air temperature along
    the beam.
    """

    later_keys = frozenset({"client", "procedure", "air_pressure", "relative_humidity"})

    organisation: str = ""
    location: str = ""
    operator: str = ""
    client: str = ""
    procedure: str = ""
    tracker: Instrument = Instrument()
    smr: Mapping[str, Instrument] = {}
    """By arm."""
    instruments: Mapping[str, Instrument] = {}
    """Further ones by name, as a thermometer or a reference bar."""
    arms: Mapping[str, TraceableArm] = {}
    air_pressure: PressureSpan | None = None
    relative_humidity: HumiditySpan | None = None
    smr_centering: Annotated[Length, Field(gt=0.0, le=1e-3)] | None = None
    air_temperature_uncertainty: Annotated[float, Field(strict=True, gt=0.0, le=20.0)] | None = None
    """Kelvin."""
