"""Targets: SMR positions and flange rotations in any frame of the cell; lists of them, read from files and checked."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    AllowInfNan,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from cellapp.cell.profile.loader import document_in_memory, read_yaml
from cellapp.cell.profile.messages import KeyPath, YamlDocument, short, validation_message
from cellapp.cell.run.csv_text import is_frame, table_of_frame
from cellapp.cell.targets.records import TargetRecord
from cellapp.cell.targets.target_csv import document_of_table, is_csv, read_csv
from cellapp.ground.counting import first_few
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import CORRECTED
from cellapp.ground.profile import CellPoint, Profile
from cellapp.ground.results import plain_data
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    register,
    rotation_from_vector,
    rotations_of,
    xyz_of,
    zyx_angles,
)
from drivers.quantities import Angle, ArmLength, Length, Mass, Temperature, Time, Turn
from drivers.settings import Section

if TYPE_CHECKING:
    import pandas as pd


# -- Rotation of a target: roll, pitch and yaw, a quaternion, a rotation vector or a matrix ---------------------------


_LARGEST = 1e-3
"""Largest deviation from one of a quaternion's norm, or of a matrix times its transpose: rounding to three digits.
Beyond it is no rotation, or one that was copied wrongly."""
_Number = Annotated[float, Strict(), AllowInfNan(False)]
_Row = tuple[_Number, _Number, _Number]
_RollPitchYaw = tuple[Turn, Turn, Turn]
_Quaternion = Annotated[tuple[_Number, _Number, _Number, _Number] | None, Field(exclude=True)]
_RotationVector = Annotated[tuple[Turn, Turn, Turn] | None, Field(exclude=True)]
_Matrix = Annotated[tuple[_Row, _Row, _Row] | None, Field(exclude=True)]
R = TypeVar("R", bound=Section)


def _as_rpy(rotated: R) -> R:
    """Keep the rotation of a target as ``rpy`` alone, whatever it is given as."""
    keys = ("rpy", *_READERS)
    given = [key for key in keys if getattr(rotated, key) is not None]
    if len(given) > 1:
        raise ValueError(f"{given[1]}: '{given[0]}' is there too; give one of {', '.join(keys)}")
    if given and given != ["rpy"]:
        yaw, pitch, roll = zyx_angles(_READERS[given[0]](getattr(rotated, given[0])))
        # a frozen section, still being made; no -0.0
        vars(rotated).update({"rpy": (roll + 0.0, pitch + 0.0, yaw + 0.0), given[0]: None})
    return rotated


def _of_quaternion(quaternion: Sequence[float]) -> Array:
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > _LARGEST:
        raise ValueError(
            f"quaternion: its norm is {norm:.6g}, {abs(norm - 1.0):.2g} from one (at most {_LARGEST:g}), so it is no"
            " rotation; give w, x, y, z of unit norm"
        )
    return rotations_of(quaternion)


def _of_matrix(rows: Sequence[Sequence[float]]) -> Array:
    matrix = np.array(rows)
    with np.errstate(over="ignore", invalid="ignore"):  # entries of 1e200
        off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if not off <= _LARGEST:
        raise ValueError(
            f"matrix: its rows are off unit length and right angles by {off:.2g} (at most {_LARGEST:g}), so it is no"
            " rotation; give three rows of unit length at right angles"
        )
    if np.linalg.det(matrix) < 0.0:
        raise ValueError("matrix: its determinant is -1: a reflection, no rotation; give right-handed axes")
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)  # the nearest rotation


_READERS: Mapping[str, Callable[[Any], Array]] = {
    "quaternion": _of_quaternion,
    "rotation_vector": rotation_from_vector,
    "matrix": _of_matrix,
}
"""Keys beside ``rpy`` by which a target may give its rotation -> the rotation (3, 3) that they say."""


_LOOSEST_M = 0.01
"""Largest accepted tolerance [m]: uncalibrated arms are better. A larger one was meant in mm, as 0.1 without unit."""
_LOOSEST_RAD = 0.02
"""Largest accepted orientation tolerance [rad]; a larger one was meant in mrad or degrees."""
_FARTHEST_M = 10.0
"""Largest coordinate in a base frame [m]: no arm reaches farther. A larger one was meant in mm."""
_DIGEST = 16
"""Hexadecimal digits of a digest: 64 bits are enough to distinguish the versions of one target."""
_BASE, _TRACKER = "base", "tracker"
_THREE = ("origin", "x", "xy")


def _tolerance(loosest: float, unit: str) -> AfterValidator:
    """Return the check of a tolerance in an SI unit that people often state in thousandths."""

    def check(value: float) -> float:
        if not 0.0 < value <= loosest:
            raise ValueError(
                f"expected a tolerance above 0 and at most {loosest * 1e3:g} m{unit}, got {value:g} {unit}; is it"
                f" '{value:g} m{unit}'?"
            )
        return value

    return AfterValidator(check)


class FramePoint(Section):
    """One point of a work frame: its coordinates in that frame and where it was measured [m]."""

    nominal: CellPoint
    measured: CellPoint


_OfThree = Annotated[CellPoint | None, Field(exclude=True)]


class WorkFrame(Section):
    """A work frame W, given by three or more points measured in ``parent``: "tracker" or the name of an arm (its base).

    The pose of W in ``parent`` is the rigid registration of the points. A file may give ``in`` for ``parent``, and for
    ``points`` three measured ones: ``origin``, ``x`` on the positive x axis, ``xy`` in the x-y plane with y > 0.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    name: Annotated[str, Field(min_length=1)]
    parent: Annotated[str, Field(alias="in")] = _TRACKER
    points: tuple[FramePoint, ...] = ()
    origin: _OfThree = None
    x: _OfThree = None
    xy: _OfThree = None

    @model_validator(mode="after")
    def _one_rigid_body(self) -> Self:
        three = {key: point for key in _THREE if (point := getattr(self, key)) is not None}
        if three and not self.points:
            if missing := [key for key in _THREE if key not in three]:
                raise ValueError(f"{missing[0]}: missing; give {', '.join(_THREE)}, or points")
            measured = np.array(list(three.values()))
            places = three_points(*measured)
            points = [FramePoint(nominal=xyz_of(p), measured=xyz_of(m)) for p, m in zip(places, measured, strict=True)]
            vars(self).update(dict.fromkeys(_THREE) | {"points": tuple(points)})  # a frozen section, still being made
        if len(self.points) < 3:
            raise ValueError(f"points: expected at least 3 values, got a list of {len(self.points)}")
        nominal, measured = (
            np.array([getattr(point, which) for point in self.points]) for which in ("nominal", "measured")
        )
        if fault := frame_fault(nominal, measured):
            raise ValueError(fault)
        return self


class WorkingConditions(Section):
    """Conditions at a target that effects depend on; None where not stated.

    Attributes
    ----------
    payload : float or None
        [kg]; None: that of the profile.
    temperature : float or None
        Of arm and air [degC].
    time : float or None
        Since the run began [s]; None: now, the state at the end of the run.
    dwell : float or None
        Rest before the arm works or is measured [s].
    """

    payload: Annotated[Mass, Field(ge=0.0)] | None = None
    temperature: Annotated[Temperature, Field(ge=-50.0, le=100.0)] | None = None
    time: Annotated[Time, Field(ge=0.0)] | None = None
    dwell: Annotated[Time, Field(ge=0.0)] | None = None


class Partner(Section):
    """The second arm of a cooperative target: where its SMR is, seen from the first arm's SMR.

    ``position`` [m] and ``rpy`` are in the frame with its origin at the first arm's SMR centre and the axes of the
    first arm's flange. Without ``rpy`` the rotation of the second flange is free. ``moves`` says which arms are
    compensated: "both", or "partner": the first arm keeps the command of its published geometry, and the partner makes
    up for the errors of both.
    """

    arm: str
    position: tuple[ArmLength, ArmLength, ArmLength]
    rpy: _RollPitchYaw | None = None
    conditions: WorkingConditions = WorkingConditions()
    moves: Literal["both", "partner"] = "both"
    quaternion: _Quaternion = None
    rotation_vector: _RotationVector = None
    matrix: _Matrix = None

    _rotation = model_validator(mode="after")(_as_rpy)


class Target(Section):
    """One target: SMR position and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)`` in a frame.

    Attributes
    ----------
    name, arm : str
    position : three numbers
        SMR centre [m].
    rpy : three numbers or None
        Roll, pitch, yaw [rad]; None: any rotation will do.
    frame : str
        "base": the arm's own base; "tracker"; the name of an arm: that arm's base; else the name of ``work_frame``.
    work_frame : WorkFrame or None
    tolerance : float or None
        How far the SMR may be from the target, and the distance between two SMRs from the wanted one [m].
    orientation_tolerance : float or None
        By what angle the flange may be turned from the target's rotation [rad].
    approach : signs or None
        Preferred sign of each joint's last motion, 0 where it does not matter; None: as the way leads.
    conditions : WorkingConditions
        Of ``arm``.
    partner : Partner or None
        The other arm of a cooperative target, whose pose relative to the first one keeps the tolerances, too.
    """

    name: Annotated[str, Field(min_length=1)]
    arm: str
    position: CellPoint
    rpy: _RollPitchYaw | None = None
    frame: str = "base"
    work_frame: WorkFrame | None = None
    tolerance: Annotated[Length, _tolerance(_LOOSEST_M, "m")] | None = None
    approach: tuple[Literal[-1, 0, 1], ...] | None = None
    conditions: WorkingConditions = WorkingConditions()
    partner: Partner | None = None
    orientation_tolerance: Annotated[Angle, _tolerance(_LOOSEST_RAD, "rad")] | None = None
    quaternion: _Quaternion = None
    rotation_vector: _RotationVector = None
    matrix: _Matrix = None

    _rotation = model_validator(mode="after")(_as_rpy)

    @property
    def tolerance_mm(self) -> float | None:
        """Tolerance [mm]."""
        return None if self.tolerance is None else self.tolerance * 1e3

    @property
    def orientation_tolerance_mrad(self) -> float | None:
        """Tolerance of the flange's rotation [mrad]."""
        return None if self.orientation_tolerance is None else self.orientation_tolerance * 1e3

    @property
    def holds_first(self) -> bool:
        """Whether the first arm keeps the command of its published geometry."""
        return self.partner is not None and self.partner.moves == "partner"

    @property
    def arms(self) -> tuple[str, ...]:
        """The arms that must reach the target."""
        return (self.arm,) if self.partner is None else (self.arm, self.partner.arm)


class TargetList(Section):
    """A file of targets.

    ``frames`` are work frames by name; ``conditions``, by the name of an arm, hold wherever a target states none.
    """

    schema_: Literal["cellapp-targets"] = Field(alias="schema")
    version: Literal[1]
    frames: dict[str, WorkFrame] = Field(default_factory=dict)
    conditions: dict[str, WorkingConditions] = Field(default_factory=dict)
    targets: Annotated[tuple[Target, ...], Field(min_length=1)]

    @field_validator("frames", mode="before")
    @classmethod
    def _with_names(cls, frames: object) -> object:
        if not isinstance(frames, dict):
            return frames
        return {name: {**keys, "name": name} if isinstance(keys, dict) else keys for name, keys in frames.items()}

    @field_validator("targets", mode="before")
    @classmethod
    def _resolved(cls, targets: object, info: ValidationInfo) -> object:
        frames, conditions = info.data.get("frames", {}), info.data.get("conditions", {})
        if not isinstance(targets, list):
            return targets
        return [_with_sections(keys, frames, conditions) if isinstance(keys, dict) else keys for keys in targets]


_HEAD = 64 * 1024
"""Bytes of a file in which a mark of compensated commands stands."""


def load_targets(path: Path, profile: Profile) -> tuple[Target, ...]:
    """Read a target list: CSV if the file name ends so, else YAML, whose ``targets`` may name a CSV file.

    Raises
    ------
    InputError
        With file, line and target of the first problems.
    """
    joints = {name: len(arm.type.joints) for name, arm in profile.arms.items()}
    return targets_of(_document(Path(path), joints), profile)


def named_targets(profile: Profile, path: Path) -> tuple[Target, ...]:
    """Read the targets that the profile at ``path`` names, none if it names none. Raise as ``load_targets``."""
    return () if profile.targets is None else load_targets(path.parent / profile.targets, profile)


def targets_of(document: YamlDocument, profile: Profile) -> tuple[Target, ...]:
    """Return the targets of a document, checked against each other and the cell. Raise as ``load_targets``."""
    document = replace(document, schema=TargetList)
    try:
        listed = TargetList.model_validate(document.data)
    except ValidationError as error:
        raise InputError(validation_message(error, _by_name(document))) from None
    if misfits := [*_misfits(listed, profile)]:
        places = _by_name(document).places
        lines = [f"{places.get(at) or places[at[:2]]}: {text}" for at, text in misfits]
        raise InputError("\n".join(first_few(lines, "and {} more")))
    return listed.targets


def _by_name(document: YamlDocument) -> YamlDocument:
    """Return the document with targets and frames by what people call them in its places."""

    def named(inside: KeyPath) -> KeyPath:
        match inside:
            case ("targets", int(index), *rest):
                keys = document.data["targets"][index]
                name = keys.get("name") if isinstance(keys, dict) else None
                called = f"target '{short(name)}'" if isinstance(name, str) and name else f"target {index + 1}"
                return (called, *rest)
            case ("frames", str(name), *rest):
                return (f"frame '{short(name)}'", *rest)
        return inside

    places = {at: replace(spot, inside=named(spot.inside)) for at, spot in document.places.items()}
    return replace(document, places=places)


def list_problems(
    targets: Sequence[Target], profile: Profile, frames: Iterable[str] = ()
) -> Iterator[tuple[int, str, str]]:
    """Yield the index of each target that does not fit the cell or the targets before it, the wrong key, and why."""
    known: dict[str, WorkFrame] = {}
    names: set[str] = set()
    work_frames = dict.fromkeys([*frames, *(t.work_frame.name for t in targets if t.work_frame is not None)])
    for index, target in enumerate(targets):
        frame = target.work_frame
        if problem := _misfit(target, profile, work_frames):
            yield index, *problem
        elif target.name in names:
            yield index, "name", "listed twice; give every target its own name"
        elif frame is not None and known.setdefault(frame.name, frame) != frame:
            text = f"another target has a frame '{frame.name}' with other points; give one of them another name"
            yield index, "frame", text
        names.add(target.name)


def frame_names(profile: Profile) -> tuple[str, ...]:
    """Return the names of the frames that need no points."""
    return (_BASE, _TRACKER, *profile.arms)


def frame_problem(frame: WorkFrame, profile: Profile) -> str:
    """Return why a work frame does not fit the cell; empty if it does."""
    if frame.name in frame_names(profile):
        return f"'{frame.name}' is the name of a frame that every cell has; give the work frame another name"
    parents = (_TRACKER, *profile.arms)
    if frame.parent not in parents:
        return f"in: expected {', '.join(parents)}, where its points were measured, got '{short(frame.parent)}'"
    return ""


def target_record(target: Target, arm: str) -> TargetRecord:
    """Return the record of a target for a result about one arm's part in it."""
    return TargetRecord.like(target, arm=arm, partner=partner_of(target, arm), definition=definition(target))


def partner_of(target: Target, arm: str) -> str:
    """Return the other arm of a cooperative target; empty if there is none."""
    return next((name for name in target.arms if name != arm), "")


def definition(target: Target) -> str:
    """Return a digest of everything that a target states, including frame, partner and conditions."""
    later: dict[str, bool | dict[str, bool]] = {}
    if target.orientation_tolerance is None:
        later["orientation_tolerance"] = True
    if target.partner is not None and not target.holds_first:
        later["partner"] = {"moves": True}
    return hashlib.sha256(target.model_dump_json(exclude=later).encode()).hexdigest()[:_DIGEST]


# -- what is written --------------------------------------------------------------------------------------------------


def _document(path: Path, joints: Mapping[str, int]) -> YamlDocument:
    with contextlib.suppress(OSError), path.open("rb") as file:
        if CORRECTED.encode() in file.read(_HEAD):
            raise InputError(f"{path}: compensated commands, no targets: they are corrected. Give the target list")
    if is_csv(path):
        return read_csv(path, joints)
    document = read_yaml(path, TargetList, "give a target list (YAML or CSV)")
    name = document.data.get("targets")
    if not isinstance(name, str) or not name.lower().endswith(".csv"):
        return document
    rows = read_csv(path.parent / name, joints)
    data = {**document.data, "targets": rows.data["targets"]}
    return replace(document, data=data, places={**document.places, **rows.places, (): document.places[()]})


def _with_sections(
    keys: Mapping[str, Any], frames: Mapping[str, WorkFrame], conditions: Mapping[str, WorkingConditions]
) -> dict[str, Any]:
    """Return the keys of a target with its work frame and the conditions of its arms."""
    resolved = {**keys}
    frame = keys.get("frame")
    if isinstance(frame, str) and frame in frames:
        resolved["work_frame"] = frames[frame]
    if conditions:
        resolved |= _conditions(keys, conditions)
        if isinstance(partner := keys.get("partner"), dict):
            resolved["partner"] = {**partner, **_conditions(partner, conditions)}
    return resolved


def _conditions(keys: Mapping[str, Any], usual: Mapping[str, WorkingConditions]) -> dict[str, Any]:
    """Return the conditions of one arm at a target; what the target does not state is taken from the file."""
    arm, own = keys.get("arm"), keys.get("conditions")
    if not isinstance(arm, str) or arm not in usual:
        return {}
    if isinstance(own, dict):
        return {"conditions": {**usual[arm].model_dump(exclude_none=True), **own}}
    return {"conditions": usual[arm]} if own is None else {}


# -- what does not fit ------------------------------------------------------------------------------------------------


def _misfits(listed: TargetList, profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    for name, frame in listed.frames.items():
        if problem := frame_problem(frame, profile):
            yield ("frames", name), problem
    for name in listed.conditions:
        if name not in profile.arms:
            yield ("conditions", name), f"no such arm; arms are {', '.join(profile.arms)}"
    for index, key, text in list_problems(listed.targets, profile, listed.frames):
        yield ("targets", index, key), text


def _misfit(target: Target, profile: Profile, frames: Iterable[str]) -> tuple[str, str] | None:
    """Return the wrong key of a target and why it does not fit the cell; None if it does."""
    if target.arm not in profile.arms:
        return "arm", f"no arm '{short(target.arm)}'; arms are {', '.join(profile.arms)}"
    frame, known = target.work_frame, frame_names(profile)
    if frame is None and target.frame not in known:
        names = ", ".join([*known, *frames])
        return (
            "frame",
            f"no frame '{short(target.frame)}'; frames are {names}; a YAML list, whose targets: may name a CSV file,"
            " gives others under frames:",
        )
    if frame is not None and (frame.name != target.frame or frame_problem(frame, profile)):
        return "frame", frame_problem(frame, profile) or "its work frame has another name"
    far = max(abs(value) for value in target.position)
    if target.frame in known and target.frame != _TRACKER and far > _FARTHEST_M:
        return "position", f"{far:g} m is farther from the base than any arm reaches; is it {far:g} mm?"
    joints = len(profile.arms[target.arm].type.joints)
    if target.approach is not None and len(target.approach) != joints:
        text = f"expected {joints} signs, one for each joint of arm {target.arm}, got {len(target.approach)}"
        return "approach", text
    if target.orientation_tolerance is not None and target.rpy is None:
        return "orientation_tolerance", "give the target a rotation; where any will do none is off"
    return None if target.partner is None else _partner_misfit(target, target.partner, profile)


def _partner_misfit(target: Target, partner: Partner, profile: Profile) -> tuple[str, str] | None:
    others = ", ".join(name for name in profile.arms if name != target.arm) or "none: this cell has one arm"
    if partner.arm not in profile.arms:
        return "partner", f"no arm '{short(partner.arm)}'; the others are {others}"
    if partner.arm == target.arm:
        return "partner", f"arm {partner.arm} cannot be its own partner; the others are {others}"
    if target.rpy is None:
        text = "a partner's place is given in the axes of the first arm's flange; give the target a rotation"
        return "rpy", text
    return None


# -- Check that points determine a work frame; arrays only ------------------------------------------------------------


_LARGEST_M = 0.005
"""Largest disagreement of distances [m]: fixtures fit drawings better; more means swapped points or wrong units."""
_NARROWEST = 0.01
"""Smallest width of the points across their line, relative to their length. With a smaller one, noise rotates the frame
by more than a hundred times the angle that it rotates an equilateral one."""


def three_points(origin: Array, x: Array, xy: Array) -> Array:
    """Return the coordinates (3, 3) [m] of three measured points in the frame that they determine.

    ``origin`` is its origin, ``x`` is on its positive x axis, ``xy`` in its x-y plane with a positive y.
    """
    along, across = x - origin, xy - origin
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0.0 else along
    part = float(across @ axis)
    width = float(np.linalg.norm(across - part * axis))
    return np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], [part, width, 0.0]])


def frame_fault(nominal: Array, measured: Array) -> str:
    """Return why points (n, 3) [m] do not determine a frame, or differ between both sets; empty if all is well."""
    for points, which in ((nominal, "nominal"), (measured, "measured")):
        length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[:2]
        if width <= _NARROWEST * length:
            return (
                f"the {which} points lie on one line, so that the frame can rotate about it; give a point at least"
                f" {_NARROWEST:.0%} of their distance off that line"
            )
    return _disagreement(nominal, measured) or _reflection(nominal, measured)


# -- inside -----------------------------------------------------------------------------------------------------------


def _disagreement(nominal: Array, measured: Array) -> str:
    """Report the point whose distances from the others differ most, if they differ by too much."""
    between_nominal, between_measured = _distances(nominal), _distances(measured)
    off = np.abs(between_measured - between_nominal)
    if off.max() <= _LARGEST_M:
        return ""
    worst = int(np.argmax(off.sum(axis=1)))
    other = int(np.argmax(off[worst]))
    return (
        f"point {worst + 1} is {between_nominal[worst, other] * 1e3:.3f} mm from point {other + 1} by its nominal"
        f" coordinates and {between_measured[worst, other] * 1e3:.3f} mm as measured, {off[worst, other] * 1e3:.3f} mm"
        f" apart; expected at most {_LARGEST_M * 1e3:g} mm: check the order of the points and their units"
    )


def _reflection(nominal: Array, measured: Array) -> str:
    """Report mirrored points: their distances agree, but no rigid motion maps one set to the other."""
    residual = np.linalg.norm(measured - apply(register(measured, nominal), nominal), axis=1)
    worst = int(np.argmax(residual))
    if residual[worst] <= _LARGEST_M:
        return ""
    return (
        f"the measured points are the mirror image of the nominal ones: point {worst + 1} stays"
        f" {residual[worst] * 1e3:.3f} mm off; give both in right-handed coordinates"
    )


def _distances(points: Array) -> Array:
    """Return the distances (n, n) [m] between points (n, 3) [m]."""
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


# -- Targets in memory instead of a file: keys with values, a list of them, or a data frame; checked as all targets ---


def targets_in_memory(given: Mapping[str, Any] | Sequence[Any] | pd.DataFrame, profile: Profile) -> tuple[Target, ...]:
    """Return the targets of a cell.

    Parameters
    ----------
    given : sequence, mapping or data frame
        A list of ``Target`` objects or of mappings with the keys that a target has in a YAML file; a mapping with the
        keys of such a file (``targets``, ``frames``, ``conditions``); or a data frame with the columns of a CSV file of
        targets. A plain number is in metres or radians.

    Raises
    ------
    InputError
        As ``load_targets``; problems are located by the target, or the row of the data frame.
    """
    if is_frame(given):
        joints = {name: len(arm.type.joints) for name, arm in profile.arms.items()}
        return targets_of(document_of_table(table_of_frame(given), joints), profile)
    content = plain_data(given)
    if isinstance(content, list):
        content = {"targets": content}
    if not isinstance(content, dict):
        raise InputError(f"targets: expected a path, a list, keys with values or a data frame, got {given!r:.60}")
    content = {"schema": "cellapp-targets", "version": 1, **content}
    return targets_of(document_in_memory(content, "targets"), profile)
