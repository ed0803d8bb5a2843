"""Result of ``iso9283``: performance characteristics of arms by ISO 9283, and of two arms together beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.ground.results import Record, Result

Vector3 = tuple[float, float, float]


class IsoValue(Record):
    """A characteristic [mm] from ``n`` cycles, and its expanded uncertainty (coverage factor 2).

    ``expanded_mm`` is None where the tracker states no uncertainty.
    """

    value_mm: float
    expanded_mm: float | None
    n: int


class OrientationCharacteristics(Record):
    """Accuracy AP_a, AP_b, AP_c and repeatability RP_a, RP_b, RP_c of the orientation at one pose.

    Angles about the axes of the arm's base from the commanded to the attained orientation [mrad], with the expanded
    uncertainties of both (coverage factor 2), of ``n`` cycles.
    """

    accuracy_mrad: Vector3
    accuracy_expanded_mrad: float
    repeatability_mrad: Vector3
    repeatability_expanded_mrad: float
    n: int


class PoseCharacteristics(Record):
    """Accuracy AP and repeatability RP at one pose.

    Attributes
    ----------
    error_mm : three numbers
        From the commanded to the mean attained position, along the axes of the arm's base: AP_x, AP_y, AP_z. Of
        cooperative tests: of the vector between both SMRs, along the axes of the tracker.
    tracker_rp_mm : float or None
        RP that the tracker's stated uncertainty alone would show, if all of it scattered from cycle to cycle.
    orientation : OrientationCharacteristics or None
        Where the orientation of a probe was measured.
    """

    pose: str
    error_mm: Vector3
    accuracy: IsoValue
    repeatability: IsoValue
    tracker_rp_mm: float | None = None
    orientation: OrientationCharacteristics | None = None
    omitted_when_none = frozenset({"orientation"})


class DirectionalCharacteristics(Record):
    """Multi-directional pose accuracy variation vAP at one pose.

    ``errors_mm`` maps each direction of approach ("x", "y", "z" of the arm's base) to the error of the mean position.
    """

    pose: str
    variation: IsoValue
    errors_mm: Mapping[str, Vector3]


class DistanceCharacteristics(Record):
    """Distance accuracy AD (measured minus commanded, with its sign) and repeatability RD, of one pair of positions."""

    between: tuple[str, str]
    commanded_mm: float
    accuracy: IsoValue
    repeatability: IsoValue
    errors_mm: tuple[float, ...]


class DriftGroup(Record):
    """AP and RP of one group of cycles, ``minutes`` after the first one."""

    minutes: float
    accuracy_mm: float
    repeatability_mm: float
    error_mm: Vector3
    n: int
    temperature_c: float | None = None


class DriftCharacteristics(Record):
    """Drift at one pose: largest change of AP and of RP against the first group of cycles.

    ``shift_mm`` is the largest displacement of the mean position, which AP does not show where the distance from the
    commanded position stays. ``minutes`` is how long was observed.
    """

    pose: str
    minutes: float
    accuracy: IsoValue
    repeatability: IsoValue
    shift_mm: float
    groups: tuple[DriftGroup, ...]


class PathVelocity(Record):
    """Velocity along the middle half of a path, of ``n`` cycles.

    Attributes
    ----------
    accuracy_percent, expanded_percent : float
        AV and its expanded uncertainty, of the commanded speed.
    repeatability_percent : float
        RV
    fluctuation_mm_s, tracker_fluctuation_mm_s : float
        FV, and what the tracker's stated uncertainty alone would show.
    """

    accuracy_percent: float
    expanded_percent: float
    repeatability_percent: float
    fluctuation_mm_s: float
    tracker_fluctuation_mm_s: float
    n: int


class PathCharacteristics(Record):
    """Path accuracy AT and repeatability RT: the largest over ``points`` places along the path.

    ``velocity`` is None where it was not found. ``slowed`` says why the programme itself
    does not keep the commanded speed.
    """

    path: str
    speed_mm_s: float
    length_mm: float
    points: int
    accuracy: IsoValue
    repeatability: IsoValue
    velocity: PathVelocity | None = None
    slowed: str = ""


class SpeedSeries(Record):
    """Pose and path tests repeated at another share of the profile's speed."""

    speed_share: float
    pose: tuple[PoseCharacteristics, ...] = ()
    path: tuple[PathCharacteristics, ...] = ()


class CommandedTests(Record):
    """The tests of one arm with one kind of commands; empty or None where a test was not made."""

    pose: tuple[PoseCharacteristics, ...] = ()
    multidirectional: tuple[DirectionalCharacteristics, ...] = ()
    distance: tuple[DistanceCharacteristics, ...] = ()
    drift: DriftCharacteristics | None = None
    path: tuple[PathCharacteristics, ...] = ()
    series: tuple[SpeedSeries, ...] = ()


class IsoPose(Record):
    """A pose of the test, with the joint positions by the published geometry [rad]."""

    name: str
    position_B: Vector3
    q: tuple[float, ...]


class IsoCube(Record):
    """The test cube of an arm, edges along the axes of its base, and the plane in it with the poses P1 to P5.

    Attributes
    ----------
    edge_mm : float
    centre_B : three numbers
        [m] in the frame of the arm's base.
    plane : str
        The corners of the norm's plane, as "C1-C2-C7-C8".
    rpy : three numbers or None
        Roll, pitch, yaw of the flange in the base [rad], the same at all poses; None where it is free.
    poses : tuple of IsoPose
    limited_by : str
        What a larger cube offends.
    """

    edge_mm: float
    centre_B: Vector3
    plane: str
    rpy: Vector3 | None
    poses: tuple[IsoPose, ...]
    limited_by: str


class BaseAlignment(Record):
    """Base and SMR of an arm found by measuring, with the published geometry, where there is no calibration.

    ``rms_mm`` are the residuals of ``n`` positions, ``uncertainty_mm`` the standard uncertainty that the fit adds to a
    coordinate of a commanded position, rms over the poses of the test.
    """

    n: int
    rms_mm: float
    uncertainty_mm: float


class ArmIso9283(Record):
    """Characteristics of one arm. ``refused`` maps tests that were not made to the reason; some had other tests."""

    payload_kg: float
    cube: IsoCube | None = None
    base: BaseAlignment | None = None
    tests: Mapping[IsoCommands, CommandedTests] = {}
    refused: Mapping[str, str] = {}


class PairIso9283(Record):
    """Cooperative accuracy and repeatability of two arms, which the norm does not define.

    ``vector`` are AP and RP of the vector from the first SMR to the second, ``distance`` accuracy and repeatability of
    its length, with both arms at rest at poses of their own cubes.
    """

    arms: tuple[str, str]
    vector: Mapping[IsoCommands, tuple[PoseCharacteristics, ...]] = {}
    distance: Mapping[IsoCommands, tuple[DistanceCharacteristics, ...]] = {}
    refused: str = ""


IsoStatus = Literal["done", "in part", "not done"]


class IsoLine(Record):
    """A characteristic or condition that the norm asks for, and what was done of it, for ``arms``.

    ``words`` say how it was done, as "30 cycles, nominal commands", or why not.
    """

    clause: str
    characteristic: str
    arms: tuple[str, ...]
    status: IsoStatus
    words: str


class IsoConditions(Record):
    """Conditions of the tests.

    ``speed_share`` is of the speed that the profile allows, at ``also_speeds`` pose and path tests were repeated;
    ``cycles`` what was asked for, ``temperature_c`` lowest and highest of the measured air.
    """

    cycles: int
    speed_share: float
    dwell_s: float
    averaging_s: float
    commands: tuple[IsoCommands, ...]
    also_speeds: tuple[float, ...] = ()
    began: str = ""
    seconds: float = 0.0
    temperature_c: tuple[float, float] | None = None


class Iso9283Result(Result, schema="cellapp-iso9283"):
    """``iso9283``: the tests that were made, with their conditions; ``judgements`` against the profile's tolerances.

    ``tests`` of earlier versions may have other names.

    ``missing`` says which cycles, poses or tests could not be measured, and why. ``pairs`` are those of arms.
    ``coverage`` lists what the norm asks for, done or not; results of before it was kept have none.
    ``points_file`` in the folder of the run holds every measured point with its time; ``points_sha256`` is its hash.
    """

    tests: tuple[str, ...]
    arms: Mapping[str, ArmIso9283]
    pairs: tuple[PairIso9283, ...] = ()
    conditions: IsoConditions | None = None
    judgements: tuple[Judgement, ...] = ()
    coverage: tuple[IsoLine, ...] = ()
    missing: tuple[str, ...] = ()
    stopped: str = ""
    notes: tuple[str, ...] = ()
    points_file: str = ""
    points_sha256: str = ""

    def complaints(self) -> list[str]:
        """What did not hold: stopped, cycles missing, out of tolerance; empty if all is well."""
        out = [
            f"{one.characteristic.replace('_', ' ')} of {one.where}: {one.value_mm:.3f} mm, tolerance"
            f" {one.tolerance_mm:g} mm"
            for one in self.judgements
            if one.conformity == "does not conform" and one.value_mm is not None
        ]
        return [*([self.stopped] if self.stopped else []), *self.missing, *out]
