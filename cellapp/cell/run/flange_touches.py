"""Touches of sockets on the other arm's flange: read from a CSV file, checked against the nominal arms, and stored.

They are stored as a document of the run, as readings are of a ball in points that stand still.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellapp.cell.run.csv_text import NUMBER, CsvTable, Problems, read_table_of, short
from cellapp.cell.run.distances import published_arm
from cellapp.cell.run.rows import select_document
from cellapp.estimation.calibration.pair_on_flange import doubtful_touches, nominal_flange_rows
from cellapp.estimation.readings import FlangeTouches, Readings
from cellapp.estimation.sockets import in_sockets
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, invert
from cellapp.robot.model.nominal import pose_matrix

FLANGE_TOUCHES_RESULT = "flange_touches"
"""Name of the document in which a run keeps them; it is part of the file format."""
OFF_M = 0.03
"""Distance from the socket by the other touches above which a touch is refused: two nominal arms are off by less."""
_FULL_TURN = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class FlangeTouch:
    """One touch: the arm with the ball, the socket, and both arms' joint positions [rad]."""

    arm: str
    socket: str
    q: Array
    other_q: Array


def read_flange_touches(path: Path, profile: Profile, readings: Mapping[str, Readings]) -> list[FlangeTouch]:
    """Read the touches of a file, checked against the nominal arms; ``readings`` are those of each arm in sockets.

    Raises
    ------
    InputError
        Names file, line and column of a value that is missing, not a number, out of reach, or contradicts the arms.
    """
    joints = require_pair(profile, str(path))
    columns = [f"{prefix}{joint}" for prefix in ("q", "other_q") for joint in range(1, joints + 1)]
    table = read_table_of(Path(path), "touches on a flange", "touch", "a row per touch", ["arm", "socket", *columns])
    problems = Problems(table.place)
    found = dict(_checked(table, problems, profile))
    problems.check()
    touches = list(found.values())
    for (line, touch), off in zip(found.items(), off_m(profile, readings, touches).tolist(), strict=True):
        if off > OFF_M:
            problems.add(
                line,
                "socket",
                f"'{touch.socket}' is {off * 1e3:.0f} mm from where the other touches have it by the published arms;"
                " check its name, and which arm has the ball",
            )
    problems.check()
    return touches


def require_pair(profile: Profile, place: str) -> int:
    """Return the number of joints of both arms of a pair. Raise ``InputError`` if there is no pair."""
    counts = {len(arm.type.joints) for arm in profile.arms.values()}
    if len(profile.arms) != 2 or len(counts) != 1:
        raise InputError(
            f"{place}: touches on a flange are of two arms with as many joints; the profile has"
            f" {', '.join(f'{name} with {len(arm.type.joints)}' for name, arm in profile.arms.items())}"
        )
    return counts.pop()


def flange_touches_text(touches: Sequence[FlangeTouch]) -> str:
    """Compose the document that a run keeps."""
    return json.dumps(
        [{"arm": t.arm, "socket": t.socket, "q": t.q.tolist(), "other_q": t.other_q.tolist()} for t in touches]
    )


def flange_touches_of(text: str | None) -> list[FlangeTouch]:
    """Parse the touches of a document; none without one."""
    rows = [] if text is None else json.loads(text)
    return [FlangeTouch(t["arm"], t["socket"], np.array(t["q"]), np.array(t["other_q"])) for t in rows]


def with_flange_touches(connection: sqlite3.Connection, arm: str, readings: Readings) -> Readings:
    """Add the stored touches of an arm's ball on the other arm's flange to its readings in sockets."""
    if readings.point is None:
        return readings
    document = select_document(connection, FLANGE_TOUCHES_RESULT)
    return readings if document is None else _joined(arm, readings, flange_touches_of(document.text))


def _joined(arm: str, readings: Readings, touches: Sequence[FlangeTouch]) -> Readings:
    own = [one for one in touches if one.arm == arm]
    if not own:
        return readings
    q, other_q = np.array([one.q for one in own]), np.array([one.other_q for one in own])
    return replace(readings, on_flange=FlangeTouches(tuple(one.socket for one in own), q, other_q))


def _checked(table: CsvTable, problems: Problems, profile: Profile) -> Iterator[tuple[int, FlangeTouch]]:
    """Yield the touches by line; errors are noted."""
    for row, line in enumerate(table.lines):
        before = problems.count
        name, socket = table.cells["arm"][row].strip(), table.cells["socket"][row].strip()
        if name not in profile.arms:
            problems.add(line, "arm", f"no arm '{short(name)}'; arms are {', '.join(profile.arms)}")
            continue
        if not socket:
            problems.add(line, "socket", "is empty; expected the name of a socket on the other arm's flange")
        (other,) = [one for one in profile.arms if one != name]
        q = _joints(table, problems, row, "q", profile.arms[name].joint_limits)
        other_q = _joints(table, problems, row, "other_q", profile.arms[other].joint_limits)
        if problems.count == before:
            yield line, FlangeTouch(name, socket, q, other_q)


def _joints(table: CsvTable, problems: Problems, row: int, prefix: str, limits: Sequence[tuple[float, float]]) -> Array:
    values = []
    for joint, (low, high) in enumerate(limits, start=1):
        text = table.cells[f"{prefix}{joint}"][row].strip()
        value = float(text) if NUMBER.fullmatch(text) else math.nan
        if not low - _FULL_TURN <= value <= high + _FULL_TURN:
            words = f"expected radians from {low:.2f} to {high:.2f}, got '{short(text)}'; are these degrees?"
            problems.add(table.lines[row], f"{prefix}{joint}", words)
        values.append(value)
    return np.array(values)


def off_m(profile: Profile, readings: Mapping[str, Readings], touches: Sequence[FlangeTouch]) -> Array:
    """Compute how far each touch is from its socket by the others (n,) [m]; zero where too few were recorded."""
    if not touches:
        return np.zeros(0)
    if not all(name in readings and in_sockets(readings[name]) for name in profile.arms):
        raise InputError("touches on a flange tie two arms that were in sockets; no reading names a point")
    both = [_joined(name, readings[name], touches) for name in profile.arms]
    chains = [published_arm(profile, name, its) for name, its in zip(profile.arms, both, strict=True)]
    bases = [np.eye(4) if arm.base is None else pose_matrix(arm.base) for arm in profile.arms.values()]
    off = doubtful_touches(nominal_flange_rows(both, chains), np.asarray(invert(bases[1]) @ bases[0]))
    found, place = np.zeros(len(touches)), [k for name in profile.arms for k, t in enumerate(touches) if t.arm == name]
    if off is not None:
        found[place] = off
    return found
