"""Read and check path files (YAML): poses joined by straight lines and arcs, with speeds."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from cellapp.cell.profile.messages import value_message
from cellapp.cell.targets.target_source import location, placed_error
from cellapp.cell.targets.target_yaml import read_yaml
from cellapp.cell.targets.targets import Target, WorkFrame, WorkingConditions
from cellapp.ground.errors import InputError
from cellapp.ground.profile import CellPoint, Profile
from drivers.quantities import Acceleration, Length, Speed, Turn
from drivers.settings import Section

_SCHEMA = "cellapp-paths"
_SHORTEST_M = 1e-4
"""Shortest piece [m]; a shorter one is a mistake, because the tracker cannot distinguish its ends."""
_FASTEST_M_S = 3.0
"""Highest tool speed that a UR controller accepts [m/s]; a plain number above it was meant in mm/s."""
_COLLINEAR = 1e-3
"""Height of an arc relative to its chord below which its three points count as collinear."""


def _speed(value: float) -> float:
    if not 0.0 < value <= _FASTEST_M_S:
        raise ValueError(
            f"expected a speed above 0 and at most {_FASTEST_M_S:g} m/s, got {value:g} m/s;"
            f" a plain number is m/s, write '{value:g} mm/s' for mm/s"
        )
    return value


def _above_zero(value: float) -> float:
    if not value > 0.0:
        raise ValueError(f"expected a value above 0, got {value:g}")
    return value


PathSpeed = Annotated[Speed, AfterValidator(_speed)]


class PathPose(Section):
    """One pose of a path: SMR position and flange rotation ``rot_z(yaw) rot_y(pitch) rot_x(roll)``.

    Attributes
    ----------
    position : three numbers
        SMR centre [m].
    rpy : three numbers or None
        Roll, pitch, yaw [rad]; None: as at the pose before.
    speed : float or None
        Of the SMR on the way to this pose [m/s]; None: that of the path.
    via : three numbers or None
        A point [m] on the way, which is an arc through it then; None: a straight line.
    blend : float
        Distance [m] before and after this pose over which its corner is rounded; 0: the arm stops at a corner.
    """

    position: CellPoint
    rpy: tuple[Turn, Turn, Turn] | None = None
    speed: PathSpeed | None = None
    via: CellPoint | None = None
    blend: Annotated[Length, Field(ge=0.0, le=1.0)] = 0.0


class PathSpec(Section):
    """One path of one arm; the frames are those of a target list.

    Attributes
    ----------
    tolerance : float
        How far the true SMR may be from the path [m].
    speed, acceleration : float
        Of the SMR along the path, where a pose does not say otherwise [m/s]; its largest acceleration [m/s^2].
    poses : tuple of PathPose
        The first is where the path begins.
    """

    name: Annotated[str, Field(min_length=1)]
    arm: str
    frame: str = "base"
    work_frame: WorkFrame | None = None
    tolerance: Annotated[Length, Field(gt=0.0, le=0.01)]
    speed: PathSpeed
    acceleration: Annotated[Acceleration, AfterValidator(_above_zero), Field(le=10.0)] = 0.5
    conditions: WorkingConditions = WorkingConditions()
    poses: Annotated[tuple[PathPose, ...], Field(min_length=2)]

    @field_validator("poses")
    @classmethod
    def _poses_make_a_path(cls, poses: tuple[PathPose, ...]) -> tuple[PathPose, ...]:
        _require_path(poses)
        return poses

    @model_validator(mode="after")
    def _frame_is_known(self) -> Self:
        if self.work_frame is not None and self.frame != self.work_frame.name:
            raise ValueError(f"frame: '{self.frame}' is not the work frame '{self.work_frame.name}'")
        return self

    def targets(self) -> tuple[Target, ...]:
        """Return poses and points of arcs as targets, in order, in order to find them in the tracker frame."""
        rpy = self.poses[0].rpy
        found: list[Target] = []
        for number, pose in enumerate(self.poses):
            rpy = pose.rpy or rpy
            for kind, position in (("via", pose.via), ("pose", pose.position)):
                if position is not None:
                    found.append(self._target(f"{kind} {number + 1}", position, rpy))
        return tuple(found)

    def _target(
        self, name: str, position: tuple[float, float, float], rpy: tuple[float, float, float] | None
    ) -> Target:
        return Target(name=name, arm=self.arm, position=position, rpy=rpy, frame=self.frame, work_frame=self.work_frame)


class PathList(Section):
    """A file of paths."""

    schema_: Literal["cellapp-paths"] = Field(alias="schema")  # as _SCHEMA
    version: Literal[1]
    paths: Annotated[tuple[PathSpec, ...], Field(min_length=1)]


def holds_paths(path: Path) -> bool:
    """Return whether a file is a path file: YAML that says so in its key ``schema``."""
    content = None if path.suffix.lower() == ".csv" else read_yaml(path).content
    return isinstance(content, dict) and content.get("schema") == _SCHEMA


def load_paths(path: Path, profile: Profile) -> tuple[PathSpec, ...]:
    """Read a path file (YAML). Raise ``InputError`` with the file, the line and the path."""
    source = read_yaml(path, "path file", "YAML")
    try:
        listed = PathList.model_validate(source.content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(f"{source.place(location(first))}: {key}: {value_message(first)}") from None
    for index, spec in enumerate(listed.paths):
        if problem := _misfit(spec, listed.paths[:index], profile):
            raise InputError(f"{source.place(('paths', index))}: path '{spec.name}'{problem}")
    return listed.paths


# -- inside -----------------------------------------------------------------------------------------------------------


def _misfit(spec: PathSpec, others: tuple[PathSpec, ...], profile: Profile) -> str:
    """Return why a path does not fit the cell or the other paths, to follow its name; empty if it does."""
    arms = ", ".join(profile.arms)
    if spec.arm not in profile.arms:
        return f": no arm '{spec.arm}'; arms are {arms}"
    frames = ("base", "tracker", *profile.arms)
    if spec.work_frame is None and spec.frame not in frames:
        return f": no frame '{spec.frame}'; frames are {', '.join(frames)}, or that of 'work_frame'"
    if spec.work_frame is not None and spec.work_frame.parent not in ("tracker", *profile.arms):
        return f": work_frame: no parent '{spec.work_frame.parent}'; parents are tracker, {arms}"
    if any(other.name == spec.name for other in others):
        return " is listed twice; give every path its own name"
    return ""


def _pose_problem(pose: int, text: str) -> PydanticCustomError:
    return placed_error((pose,), f"pose {pose + 1}: {text}")


def _require_path(poses: tuple[PathPose, ...]) -> None:
    """Raise an error placed at the wrong pose if poses do not make a path."""
    first, last = poses[0], len(poses) - 1
    if first.rpy is None:
        raise _pose_problem(0, "'rpy' is needed: a path begins with a full pose")
    if first.via is not None or first.blend or first.speed is not None:
        raise _pose_problem(0, "'via', 'blend' and 'speed' belong to a pose that is reached from another one")
    if poses[last].blend:
        raise _pose_problem(last, "'blend' at the end of a path rounds no corner")
    for number, (before, pose) in enumerate(itertools.pairwise(poses), start=1):
        if problem := _piece_problem(before, pose):
            raise _pose_problem(number, problem)
    lengths = np.linalg.norm(np.diff([pose.position for pose in poses], axis=0), axis=1).tolist()
    for number, pose in enumerate(poses[1:-1], start=1):
        shortest = min(lengths[number - 1], lengths[number])
        if pose.blend > 0.5 * shortest:
            raise _pose_problem(
                number,
                f"blend {pose.blend * 1e3:g} mm is more than half of {shortest * 1e3:.1f} mm, the distance to the next"
                " pose or from the one before",
            )


def _piece_problem(before: PathPose, pose: PathPose) -> str:
    a, b = np.array(before.position), np.array(pose.position)
    chord = float(np.linalg.norm(b - a))
    if pose.via is None:
        return "" if chord >= _SHORTEST_M else f"the way to it is {chord * 1e3:.3f} mm long; at least 0.1 mm are needed"
    via = np.array(pose.via) - a
    longest = max(chord, float(np.linalg.norm(via)))
    if longest < _SHORTEST_M:
        return f"its arc is {longest * 1e3:.3f} mm long; at least 0.1 mm are needed"
    if chord < _SHORTEST_M:
        return "an arc cannot end where it begins; divide a full circle into two arcs"
    height = float(np.linalg.norm(np.cross(via, b - a))) / chord
    if height < _COLLINEAR * longest:
        return "the three points of its arc lie on one line; leave 'via' out for a straight line"
    return ""
