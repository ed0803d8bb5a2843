"""The answers file of ``cellapp init``: the keys of a profile, with tracker points in place of the pose of a base."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import TypeAdapter, ValidationError

from cellapp.cell.profile.loader import checked_profile, load_text
from cellapp.cell.profile.messages import KeyPath, YamlDocument, dotted, value_message
from cellapp.cell.profile.starters import FOLDER, SurveyPoint, arm_type_files, copies
from cellapp.commands.init.own_data import InitResult
from cellapp.estimation.calibration.station_location import BaseFit, base_from_points
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import path_exists, write_new
from cellapp.ground.profile import Arm, Pose
from cellapp.ground.profile.schema import VERSION
from cellapp.ground.starters import starters_folder
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array, rpy_of
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

_POINTS = TypeAdapter(tuple[SurveyPoint, ...])
_HEAD: dict[str, Any] = {"schema": "cellapp-profile", "version": VERSION}
_USUAL: Mapping[str, Any] = {"seed": 1, "calibration": {"robust": "huber"}}
"""What a new profile says if the answers do not: a wrong target in one stop does not spoil the rest."""
_COMMENT = """\
# A cell for cellapp. Check it with `cellapp doctor` before anything moves; ur10-ur5.yaml, which comes with cellapp
# (`cellapp init --from ur10-ur5`), explains the sections that may be added. A plain number is SI, a text has its unit.
"""


def write_answers(answers: Path, folder: Path) -> InitResult:
    """Write the profile of an answers file into ``folder/profiles``.

    Raises
    ------
    InputError
        If an answer is missing or wrong, points do not fix a base, or the file exists or cannot be written.
    """
    document = load_text(answers)
    surveys = _taken_points(document)
    document.data = _HEAD | document.data | {key: one for key, one in _USUAL.items() if key not in document.data}
    _name_type_files(document.data)
    content, profiles = deepcopy(document.data), folder / FOLDER
    profile = checked_profile(document, (profiles, starters_folder()))
    notes = []
    for name, points in surveys.items():
        assert profile.tracker.pose is not None, "asked for where the points were taken"
        try:
            base, fit = surveyed_base(profile.arms[name], points, profile.tracker.pose)
        except InputError as error:
            raise InputError(f"{answers}: arms.{name}.base.points: {error}") from None
        position = [round(float(value), 4) for value in base.position]
        rpy = [f"{value:z.3f} deg" for value in np.degrees(base.rpy)]
        content["arms"][name]["base"] = {"position": position, "rpy": rpy}
        notes.append(f"arm {name}: {fit.sentence}")
    target = profiles / f"{re.sub(r'[^A-Za-z0-9_-]+', '-', profile.name).strip('-') or 'cell'}.yaml"
    if path_exists(target):
        raise InputError(f"{target} exists already; nothing was written. Give another name, or move it away")
    text = _COMMENT + "".join(f"# Base from tracker points, {note}.\n" for note in notes)
    text += yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
    write_new({**copies(_new_types(content, profiles), profiles), target: text})
    return InitResult(profile=str(target), notes=tuple(notes))


def _name_type_files(data: dict[str, Any]) -> None:
    """Replace short names of arm types, such as ur10, by their files."""
    files = {path.stem: f"arms/{path.name}" for path in arm_type_files()}
    arms = data.get("arms")
    for arm in (arms if isinstance(arms, dict) else {}).values():
        if isinstance(arm, dict) and isinstance(arm.get("type"), str):
            arm["type"] = files.get(arm["type"], arm["type"])


def _new_types(content: dict[str, Any], profiles: Path) -> list[str]:
    """Return the files of the program's arm types that the profile names and that are not beside it yet."""
    own = {f"arms/{path.name}" for path in arm_type_files()}
    named = {arm["type"] for arm in content["arms"].values() if isinstance(arm["type"], str)}
    return sorted(name for name in named & own if not path_exists(profiles / name))


# -- bases from points -------------------------------------------------------------------------------------------------


def _taken_points(document: YamlDocument) -> Mapping[str, tuple[SurveyPoint, ...]]:
    """Parse the points of each base, and put a pose in their place until it is computed."""
    arms, tracker = document.data.get("arms"), document.data.get("tracker")
    surveys = {}
    for name, arm in (arms if isinstance(arms, dict) else {}).items():
        base = arm.get("base") if isinstance(arm, dict) else None
        if isinstance(base, dict) and "points" in base:
            at: KeyPath = ("arms", name, "base", "points")
            if len(base) > 1:
                raise InputError(f"{document.places[at]}: give points or a pose, not both")
            if not isinstance(tracker, dict) or tracker.get("pose") is None:
                raise InputError(
                    f"{document.places[at]}: tracker.pose: missing; points in the tracker frame give a base only with"
                    " the tracker's pose"
                )
            surveys[name] = _points(document, at, base.pop("points"))
            base["position"] = [0, 0, 0]
    return surveys


def _points(document: YamlDocument, at: KeyPath, listed: object) -> tuple[SurveyPoint, ...]:
    try:
        return _POINTS.validate_python(tuple(listed) if isinstance(listed, list) else listed)
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        inside = (*at, *details["loc"])
        raise InputError(f"{document.places[at].file}: {dotted(inside)}: {value_message(details)}") from None


def surveyed_base(arm: Arm, points: Sequence[SurveyPoint], tracker: Pose) -> tuple[Pose, BaseFit]:
    """Compute the pose of an arm's base in C, and the fit, from points in the tracker frame and its pose in C.

    Points given by joint positions use the arm's nominal geometry and its SMR offset.

    Raises
    ------
    InputError
        If a point cannot be used, or the points do not determine the base.
    """
    p_B = np.array([_point_at_base(arm, number, point) for number, point in enumerate(points, start=1)])
    p_M = np.array([point.tracker for point in points])
    fit = base_from_points(p_B.reshape(-1, 3), p_M.reshape(-1, 3))
    T_C_B = pose_matrix(tracker) @ fit.T_M_B
    x, y, z = T_C_B[:3, 3].tolist()
    return Pose(position=(x, y, z), rpy=rpy_of(T_C_B[:3, :3])), fit


def _point_at_base(arm: Arm, number: int, point: SurveyPoint) -> Array:
    """Return the point in the base frame, (3,) [m]."""
    if point.joints is None:
        return np.array(point.base)
    if len(point.joints) != len(arm.type.joints):
        raise InputError(
            f"point {number}: {len(point.joints)} joint positions for the {len(arm.type.joints)} joints of"
            f" {arm.type.model}"
        )
    if arm.smr.offset == "unknown":
        raise InputError(
            f"point {number}: joint positions need the SMR offset; give it, or coordinates in the base frame"
        )
    position: Array = smr_positions(nominal_arm(arm), np.array([point.joints]))[0]
    return position
