"""What a cell is: the sections of a profile, their keys and the checks of their values.

Lengths, angles and other quantities are SI numbers or texts with a unit (``drivers.quantities``). Frames: C is the cell
(floor or table, z up), M the tracker, B an arm's base, F its flange, S the SMR centre. The sections ``driver`` of arms
and tracker, and the sensors, hold the settings of one of the kinds that are registered in ``drivers``.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from cellapp.ground.counting import did_you_mean
from cellapp.ground.network_kind import NetworkKind
from cellapp.ground.profile.sections import (
    ArmPoint,
    CellPoint,
    Collection,
    ControllerTable,
    GrownSection,
    Obstacles,
    Plan,
    Smr,
    Tolerances,
    Traceability,
)
from drivers.arms.registry import ARMS
from drivers.arms.settings import ArmSettings
from drivers.quantities import (
    Angle,
    AngularAcceleration,
    AngularSpeed,
    ArmLength,
    CellLength,
    Length,
    Mass,
    RelativeLength,
    Temperature,
    Time,
    Turn,
    parse_quantity,
)
from drivers.sensors.registry import AIR_SENSORS
from drivers.sensors.settings import AirSensorSettings
from drivers.settings import OneOf, Section
from drivers.trackers.registry import TRACKERS
from drivers.trackers.settings import TrackerSettings

VERSION = 1
"""Version of the profile's format; ``Profile.version`` accepts this one only."""

CellKind = Literal["simulated", "emulated", "real", "none"]
"""What moves in a cell: simulated arms, controllers emulated on this computer, real arms, or nothing (imported)."""


_ROUNDING_RAD = 1e-9
"""Conversion of the same angle from degrees in two files."""


class Joint(Section):
    """One row of the D-H table, the limits of that joint, and the body that it carries.

    ``A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha)``. Where the next axis is nominally parallel, the program
    adds Hayati's ``rot_y(beta)``. ``mass`` and ``center_of_mass`` describe the body fixed to D-H frame i.
    """

    theta: Turn = 0.0
    d: ArmLength = 0.0
    a: ArmLength = 0.0
    alpha: Turn = 0.0
    limit: tuple[Turn, Turn] = (-2.0 * math.pi, 2.0 * math.pi)
    speed: Annotated[AngularSpeed, Field(gt=0.0, le=30.0)] = math.pi / 2.0
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
    """An arm as its maker publishes it. Each type is a file of its own: a new one needs no code."""

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
    """A pose in the cell frame; ``rpy`` is roll, pitch, yaw of ``R = rot_z(yaw) rot_y(pitch) rot_x(roll)``."""

    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)


SAME_PAYLOAD_KG = 0.05
"""Payloads that differ by no more are the same; controllers round theirs."""


class Payload(Section):
    """Payload set on the controller: tool and load together, centre of mass in the flange frame."""

    mass: Annotated[Mass, Field(ge=0.0, le=1000.0)] = 0.0
    center_of_mass: ArmPoint = (0.0, 0.0, 0.0)


_ROW_KEYS = ("theta", "d", "a", "alpha", "beta")


def _kind_of(parameter: str) -> str:
    return "angle" if parameter.startswith(("theta", "alpha", "beta")) else "length"


def _bounds_in_si(value: object) -> object:
    """Convert pairs with units, by parameter, to SI."""
    if not isinstance(value, dict):
        return value
    found: dict[object, object] = {}
    for name, pair in value.items():
        if str(name).rstrip("0123456789") not in {*_ROW_KEYS, "tx", "ty", "tz"}:
            found[name] = (0.0, 0.0)  # the check of the names refuses it
            continue
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise ValueError(f"{name}: expected lower and upper bound, got {pair!r:.40}")
        try:
            found[name] = tuple(parse_quantity(_kind_of(str(name)), one) for one in pair)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    return found


class Arm(GrownSection, defer_build=True):
    """One arm. ``base`` is its approximate pose in the cell; planning and pointing need it, calibration does not."""

    type: ArmType
    driver: Annotated[ArmSettings, OneOf(ARMS)]
    smr: Smr
    base: Pose | None = None
    payload: Payload = Payload()
    payloads: tuple[Payload, ...] = ()
    """Further loads, which a person hangs one after the other while the plan is measured; the last one stays."""
    limits: tuple[tuple[Turn, Turn], ...] | None = None
    """Joint ranges of this cell, if tighter than those of the type."""
    home: tuple[Turn, ...] | None = None
    """Configuration before and after a job [rad]; planning needs it."""
    speed_scale: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.5
    factory: ControllerTable | None = None
    """The controller's own calibration, which then is nominal instead of the published rows: a ``calibration.conf``."""
    fixed: tuple[str, ...] = ()
    """Parameters that keep their nominal values, as ``tx``, ``ty``, ``tz`` of a measured ``smr.offset``."""
    bounds: Annotated[dict[str, tuple[float, float]], BeforeValidator(_bounds_in_si)] = Field(default_factory=dict)
    """Lower and upper bound of parameters [m, rad]: one that would go beyond is held at its bound."""
    tied: tuple[tuple[str, ...], ...] = ()
    """Groups of parameters whose corrections, found less nominal, are equal."""
    later_keys = frozenset({"payloads", "factory", "fixed", "bounds", "tied"})

    @property
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Joint ranges [rad]: those of this cell, or of the type."""
        return self.limits or tuple(joint.limit for joint in self.type.joints)

    def payload_at(self, load: int) -> Payload:
        """What the arm carries at the stops of a load of the plan, from 0."""
        carried = (self.payload, *self.payloads)
        return carried[min(load, len(carried) - 1)]

    def listed_load(self, mass: float) -> Payload | None:
        """The load of this mass [kg] among those that the arm carries in a plan; None if there is none."""
        return next((one for one in (self.payload, *self.payloads) if abs(one.mass - mass) <= SAME_PAYLOAD_KG), None)

    @model_validator(mode="after")
    def _constraints_are_possible(self) -> Self:
        rows = enumerate(self.type.joints, start=1)
        nominal = {f"{key}{joint}": getattr(row, key, 0.0) for joint, row in rows for key in _ROW_KEYS}
        of_rows, offset = set(nominal), None if self.smr.offset == "unknown" else self.smr.offset
        nominal |= dict(zip(("tx", "ty", "tz"), offset or (0.0, 0.0, 0.0), strict=True))
        named = [("fixed", name) for name in self.fixed] + [("bounds", name) for name in self.bounds]
        for key, name in [*named, *(("tied", name) for group in self.tied for name in group)]:
            if name not in nominal:
                words = "is no parameter of a D-H row or of the SMR's offset (tx, ty, tz)"
                raise ValueError(f"{key}: '{name}' {words}{did_you_mean(name, nominal)}")
            if name not in of_rows and offset is None:
                raise ValueError(f"{key}: {name} has no value to start from: smr.offset is unknown; give it")
            if key != "fixed" and name in self.fixed:
                raise ValueError(f"{key}: {name} is also in fixed; take it out of one of the two")
        for name, (low, high) in self.bounds.items():
            if not low < nominal[name] < high:
                raise ValueError(
                    f"bounds: {name} is nominally {nominal[name]:g}, which [{low:g}, {high:g}] does not hold (SI); give"
                    " a lower and an upper bound about it, or correct the nominal value"
                )
            if self.factory is not None and name in of_rows:
                raise ValueError(f"bounds: {name} starts at the controller's value, not at the row's; take out factory")
        for place, group in enumerate(self.tied):
            if len(group) < 2 or len({*group}) < len(group):
                raise ValueError(f"tied: a group needs two parameters or more, each once; got [{', '.join(group)}]")
            if twice := [name for other in self.tied[:place] for name in other if name in group]:
                raise ValueError(f"tied: {twice[0]} is in two groups; write them as one group")
            if other := [name for name in group if _kind_of(name) != _kind_of(group[0])]:
                raise ValueError(
                    f"tied: {group[0]} is {_kind_of(group[0])}, {other[0]} is {_kind_of(other[0])}; tie like to like"
                )
        return self

    @model_validator(mode="after")
    def _factory_fits_the_type(self) -> Self:
        joints = len(self.type.joints)
        if self.factory is not None and len(self.factory.delta_theta) != joints:
            raise ValueError(
                f"factory: {len(self.factory.delta_theta)} deltas for the {joints} joints of {self.type.model}"
            )
        return self

    @model_validator(mode="after")
    def _limits_fit_the_type(self) -> Self:
        if self.limits is not None:
            joints = self.type.joints
            if len(self.limits) != len(joints):
                raise ValueError(f"limits: {len(self.limits)} ranges for the {len(joints)} joints of {self.type.model}")
            for number, ((low, high), joint) in enumerate(zip(self.limits, joints, strict=True), start=1):
                if low >= high or low < joint.limit[0] - _ROUNDING_RAD or high > joint.limit[1] + _ROUNDING_RAD:
                    raise ValueError(
                        f"limits: joint {number} has [{low:g}, {high:g}] rad, which is not inside"
                        f" the type's [{joint.limit[0]:g}, {joint.limit[1]:g}] rad"
                    )
        return self


class PermissibleError(Section):
    """A maximum permissible error ``constant + proportional * distance``; half of it is one standard deviation."""

    constant: Annotated[Length, Field(gt=0.0, le=0.01)]
    proportional: Annotated[RelativeLength, Field(ge=0.0, le=0.01)] = 0.0


class Tracker(Section, defer_build=True):
    """The laser tracker, its pose and its field of view. Its z axis points up, unless ``pose`` specifies otherwise."""

    driver: Annotated[TrackerSettings, OneOf(TRACKERS)]
    pose: Pose | None = None
    transverse: PermissibleError = PermissibleError(constant=15e-6, proportional=6e-6)
    range: PermissibleError = PermissibleError(constant=10e-6, proportional=0.3e-6)
    azimuth: tuple[Turn, Turn] = (-2.0 * math.pi, 2.0 * math.pi)
    elevation: tuple[Turn, Turn] = (math.radians(-55.0), math.radians(55.0))
    distance: tuple[CellLength, CellLength] = (1.0, 40.0)
    averaging: Annotated[Time, Field(gt=0.0, le=60.0)] = 1.0


class Sensors(Section, defer_build=True):
    """Sensors of the surroundings. Without ``air``, readings get the air temperature that the tracker reports."""

    air: Annotated[AirSensorSettings, OneOf(AIR_SENSORS)] | None = None


class Splits(Section):
    """Number of stops for each use; ``rest`` is all that remain. Those of the pair are sampled from all common
    stops."""

    identify: Annotated[int, Field(strict=True, ge=1)] = 100
    train: Annotated[int, Field(strict=True, ge=0)] = 200
    validate_: Annotated[int, Field(strict=True, ge=1)] | Literal["rest"] = Field(default=100, alias="validate")
    pair_identify: Annotated[int, Field(strict=True, ge=1)] = 100
    pair_validate: Annotated[int, Field(strict=True, ge=1)] = 100


class Priors(Section):
    """Prior standard deviations of the arm's own parameters about their nominal values. Base and tool never have one.

    None: with the set ``auto``, the spread that the arm's own parameters show; with the other sets, no prior.
    """

    length: Annotated[Length, Field(gt=0.0)] | None = None
    angle: Annotated[Angle, Field(gt=0.0)] | None = None


class CalibrationSettings(Section):
    """How the geometry is identified. ``robust`` selects Huber or Tukey weights against outliers.

    ``auto`` estimates all parameters with priors, and the results state those that the data determine; ``paper`` is the
    set of Bai et al., ``full`` all parameters without priors.
    """

    parameter_set: Literal["auto", "paper", "full"] = "auto"
    priors: Priors = Priors()
    robust: Literal["none", "huber", "tukey"] = "none"
    tolerance: Annotated[float, Field(strict=True, gt=0.0, le=1e-2)] = 1e-8
    max_iterations: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 200


class Network(Section):
    """The residual network on the residuals of the geometry.

    ``mlp`` is a committee that learns from at most 1200 readings; ``batches`` learns from all readings and recordings
    by torch, and takes the committee's place where it predicts left-out blocks of time better; ``none`` is none.
    """

    kind: NetworkKind = "mlp"
    folds: Annotated[int, Field(strict=True, ge=2, le=20)] = 5
    iterations: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 150


class Pair(Section):
    """The inter-base transform: from distances alone, as in the paper, or from the common tracker frame."""

    transform: Literal["distances", "tracker"] = "distances"


class DiscoverySettings(Section):
    """Search for missing effects: false-alarm rate of the whole scan, and the simulations that set its threshold.

    ``network`` says whether a residual network learns what the accepted effects leave where an effect stays unknown.
    Earlier profiles have ``always``, by which one was trained for comparison alone where the effects explained all.
    """

    false_alarm: Annotated[float, Field(strict=True, gt=0.0, lt=0.5)] = 0.003
    null_simulations: Annotated[int, Field(strict=True, ge=20, le=100_000)] = 400
    folds: Annotated[int, Field(strict=True, ge=2, le=50)] = 5
    network: Annotated[
        Literal["unknown", "never"], BeforeValidator(lambda value: "unknown" if value == "always" else value)
    ] = "unknown"


class GeometryErrors(GrownSection):
    """Standard deviations of the errors of the true cell against the nominal one; all zero: a perfect cell."""

    length: Annotated[Length, Field(ge=0.0)] = 0.3e-3
    angle: Annotated[Angle, Field(ge=0.0)] = math.radians(0.05)
    base_length: Annotated[Length, Field(ge=0.0)] = 5e-3
    base_angle: Annotated[Angle, Field(ge=0.0)] = math.radians(0.3)
    smr: Annotated[Length, Field(ge=0.0)] = 1e-3
    mass: Annotated[float, Field(strict=True, ge=0.0, lt=1.0)] = 0.0
    """Relative error of the mass of each body."""
    probe: Annotated[Angle, Field(ge=0.0)] = 0.0
    """Rotation of a 6-D probe about each axis."""
    later_keys = frozenset({"probe"})


class FactoryErrors(Section):
    """How well the factory's calibration in each controller knows the axes of its arm: standard deviations."""

    length: Annotated[Length, Field(ge=0.0)] = 0.1e-3
    angle: Annotated[Angle, Field(ge=0.0)] = 0.1e-3


class Plant(GrownSection):
    """The simulated cell behind the simulated drivers. ``effects`` specifies the hidden physics of each arm."""

    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    geometry: GeometryErrors = GeometryErrors()
    repeatability: Annotated[Angle, Field(ge=0.0)] = 0.0
    temperature: Temperature = 20.0
    noise: Annotated[bool, Field(strict=True)] = True
    effects: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    """Arm -> effect -> parameters; see ``drivers/plant/effects``."""
    tracker_pose: Pose | None = None
    """Where the simulated tracker really stands, if that is not ``tracker.pose``, as after it was moved."""
    factory: FactoryErrors | None = None
    """The controllers' own calibration; if left out, they compute with the published rows."""
    earlier_jobs: Annotated[int, Field(strict=True, ge=0)] = 0
    """Jobs of the run that measured before: the noise of each is another. The program counts them."""
    later_keys = frozenset({"tracker_pose", "factory", "earlier_jobs"})

    def after(self, jobs: int) -> Self:
        """Return the cell when ``jobs`` have measured in it."""
        return self.model_copy(update={"earlier_jobs": jobs})


def _name(given: str) -> str:
    """Return the name of a cell or an arm. Files and folders are called so: it may be no path."""
    if given.strip(" .") != given or any(sign in "/\\" or not sign.isprintable() for sign in given):
        raise ValueError(f"{given!r} is no name: files are called so; leave out / and \\, dots and blanks at its ends")
    return given


Name = Annotated[str, Field(min_length=1), AfterValidator(_name)]


class Profile(GrownSection, defer_build=True):
    """A whole cell."""

    schema_: Literal["cellapp-profile"] = Field(alias="schema")
    version: Literal[1]
    name: Name
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    arms: Annotated[dict[Name, Arm], Field(min_length=1)]
    tracker: Tracker
    sensors: Sensors = Field(default_factory=Sensors)
    obstacles: Obstacles = Field(default_factory=dict)
    plan: Plan = Plan()
    splits: Splits = Splits()
    calibration: CalibrationSettings = CalibrationSettings()
    network: Network = Network()
    pair: Pair = Pair()
    collection: Collection = Collection()
    discovery: DiscoverySettings = DiscoverySettings()
    plant: Plant | None = None
    targets: str | None = None
    """Path of a target list, relative to the profile; used by ``run``."""
    tolerances: Tolerances = Tolerances()
    traceability: Traceability = Traceability()
    later_keys = frozenset({"tolerances", "traceability"})

    @property
    def moves_hardware(self) -> bool:
        """Whether a motion in this cell moves a real arm."""
        return any(arm.driver.moves_hardware for arm in self.arms.values())

    @property
    def loads(self) -> int:
        """Number of loads with which the plan is measured, one after the other."""
        return 1 + max(len(arm.payloads) for arm in self.arms.values())

    def with_load(self, load: int) -> Self:
        """The cell whose arms carry a load of the plan."""
        arms = {name: arm.model_copy(update={"payload": arm.payload_at(load)}) for name, arm in self.arms.items()}
        return self.model_copy(update={"arms": arms})

    @property
    def cell_kind(self) -> CellKind:
        """What moves in this cell: real arms if any arm is real, simulated ones if all are simulated."""
        drivers = [arm.driver for arm in self.arms.values()]
        if self.moves_hardware:
            return "real"
        if not any(driver.has_device for driver in drivers):
            return "none"
        return "simulated" if all(driver.needs_plant for driver in drivers) else "emulated"

    @property
    def is_simulated(self) -> bool:
        """Whether what this cell measures is simulated: it has simulated devices, or emulated ones alone."""
        kinds = {self.tracker.driver.kind, *(arm.driver.kind for arm in self.arms.values())}
        return "simulated" in kinds or (self.plant is not None and not self.moves_hardware)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        self._check_plant()
        if self.collection.air.temperature is not None and self.sensors.air is None:
            raise ValueError("collection.air: limits of the air need a weather station; add 'sensors.air'")
        for section in ("smr", "arms"):
            for name in getattr(self.traceability, section):
                if name not in self.arms:
                    raise ValueError(f"traceability.{section}.{name}: unknown arm; arms are {', '.join(self.arms)}")
        for name, obstacle in self.obstacles.items():
            if obstacle.arm is not None and obstacle.arm not in self.arms:
                raise ValueError(f"obstacles.{name}.arm: unknown arm; arms are {', '.join(self.arms)}")
            if name in self.arms or not name.strip():
                raise ValueError(f"obstacles.{name}: an obstacle needs a name of its own, other than those of the arms")
        for name, arm in self.arms.items():
            if arm.driver.has_device:
                needed = {
                    f"arms.{name}.base": arm.base,
                    f"arms.{name}.home": arm.home,
                    "tracker.pose": self.tracker.pose,
                }
                for key, value in needed.items():
                    if value is None:
                        raise ValueError(f"{key}: missing; arm {name} has a driver: planning and pointing need it")
            joints = len(arm.type.joints)
            if arm.home is not None and len(arm.home) != joints:
                raise ValueError(f"arms.{name}.home: {len(arm.home)} positions for {joints} joints")
            if self.plan.ranges is not None and len(self.plan.ranges) != joints:
                raise ValueError(f"plan.ranges: {len(self.plan.ranges)} ranges for the {joints} joints of arm {name}")
        return self

    def _check_plant(self) -> None:
        if self.plant is None:
            if self.sensors.air is not None and self.sensors.air.needs_plant:
                raise ValueError("sensors.air: a simulated station needs a section 'plant' that it measures")
            if self.tracker.driver.needs_plant or any(arm.driver.needs_plant for arm in self.arms.values()):
                raise ValueError("plant: simulated drivers need a section 'plant' that specifies what they simulate")
            return
        for name in self.plant.effects:
            if name not in self.arms:
                raise ValueError(f"plant.effects.{name}: unknown arm; arms are {', '.join(self.arms)}")
