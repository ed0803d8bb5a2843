"""Make a profile for readings recorded elsewhere: ``cellapp init --readings FILE``. Nothing moves."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from cellapp.cell.profile.loader import arm_type_of_text
from cellapp.cell.profile.starters import FOLDER, READINGS, arm_type_files
from cellapp.cell.run.columns import (
    EXAMPLES,
    KINDS,
    POINT,
    UNITS_OF_TIME,
    AngleUnit,
    LengthUnit,
    understood,
    usual_step,
)
from cellapp.cell.run.csv_text import NUMBER, Problems, read_header, short, table_text
from cellapp.cell.run.recorded_csv import Choose, Recorded, converted, nobody, read_recorded
from cellapp.commands.init.request import TABLES, InitRequest
from cellapp.estimation.calibration.quantities import repeats_words
from cellapp.estimation.calibration.station_location import COMPUTED, Explained, better_reading, explained
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import file_text
from cellapp.ground.outputs import NEW_ONLY, Outputs, write_new
from cellapp.ground.profile.schema import ArmType
from cellapp.ground.results import Result
from cellapp.ground.shell import shell_word
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.transforms import Array

_ANGLES = ("theta", "alpha")
_DH_UNITS = {
    True: {"deg": math.pi / 180.0, "°": math.pi / 180.0, "rad": 1.0},
    False: {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 0.0254},
}
"""Factors to SI by whether a quantity is an angle."""
_USUAL = {True: ("deg", "rad"), False: ("mm", "m")}
_LARGE = {True: 2.0 * math.pi + 0.01, False: 5.0}
"""Angles and lengths beyond these, without a unit, are degrees and millimetres."""
_FEWEST = 2
_EXAMPLE = "theta_deg,d_mm,a_mm,alpha_deg"


def arm_type_text(path: Path, joints: int = 0, *, modified: bool = False) -> tuple[str, tuple[str, ...]]:
    """Convert D-H rows, one for each joint, to the YAML of an arm type; its joint limits allow two turns.

    One row more than the ``joints`` of the readings is the flange, a fixed part of the tool, whose point on the last
    frame is identified; a note says so.

    Standard rows are ``rot_z(q + theta) trans(a, 0, d) rot_x(alpha)``. Modified ones (Craig, Introduction to Robotics,
    section 3.4: ``rot_x(alpha) trans(a, 0, 0) rot_z(q + theta) trans(0, 0, d)``, where ``a`` and ``alpha`` of a row lie
    before its joint) are the same chain with ``a`` and ``alpha`` one row later; those of the first belong to the base.

    Raises
    ------
    InputError
        If the file cannot be read, a heading is missing or has no unit, or a cell is no number.
    """
    rows, said = _rows(path)
    if modified:
        after = [(a, alpha) for _, _, a, alpha in rows[1:]] + [(0.0, 0.0)]
        rows = [(theta, d, *link) for (theta, d, _, _), link in zip(rows, after, strict=True)]
    notes = tuple(said)
    if len(rows) == joints + 1:
        theta, d, a, alpha = rows.pop()
        fixed = (
            f"theta {math.degrees(theta):g} deg, d {1e3 * d:g} mm, a {1e3 * a:g} mm, alpha {math.degrees(alpha):g} deg"
        )
        notes += (f"{path}: row {joints + 1} of {joints} joints is the flange ({fixed}): taken as part of the tool",)
    named = [dict(zip(("theta", "d", "a", "alpha"), map(float, row), strict=True)) for row in rows]
    content = {"model": path.stem, "source": f"D-H rows of {path.name}", "joints": named}
    head = (
        "# D-H (standard): A_i = rot_z(q_i + theta) trans(a, 0, d) rot_x(alpha); numbers are SI (m, rad).\n"
        "# limit, speed, mass, center_of_mass and capsules may be added; see the arm types that come with cellapp.\n"
    )
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True), notes


def _rows(path: Path) -> tuple[list[tuple[float, float, float, float]], list[str]]:
    """Return theta, d, a, alpha of each joint [rad, m], and a sentence on units that the file does not say."""
    file = read_header(path, "D-H rows", _EXAMPLE)
    rows, problems = [*file.rows()], Problems(lambda line: f"{path}:{line}")
    columns, large = dict[str, tuple[str, list[tuple[float, bool]]]](), {True: False, False: False}
    for quantity in ("theta", "d", "a", "alpha"):
        angle = quantity in _ANGLES
        found = [(place, match[2]) for place, name in enumerate(file.names) if (match := _named(name, quantity))]
        if len(found) != 1 or (found[0][1] or _USUAL[angle][0]) not in _DH_UNITS[angle]:
            units = " or ".join(_USUAL[angle])
            text = f"expected one column {quantity}_UNIT with {units}; write the header as {_EXAMPLE}"
            problems.add(file.head, quantity, text)
            continue
        ((place, unit),) = found
        values = [_value(cells[place], angle) for _, cells in rows]
        for (line, cells), value in zip(rows, values, strict=True):
            if value is None:
                problems.add(line, file.names[place], f"expected a number, got '{short(cells[place])}'")
        numbers = [value for value in values if value is not None]
        large[angle] |= not unit and any(abs(one) > _LARGE[angle] for one, radians in numbers if not radians)
        columns[quantity] = unit, numbers
    problems.check()
    if len(rows) < _FEWEST:
        raise InputError(f"{path}: expected a row for each of at least {_FEWEST} joints")
    taken, si = {angle: _USUAL[angle][not large[angle]] for angle in large}, list[list[float]]()
    for quantity, (unit, numbers) in columns.items():
        factor = _DH_UNITS[quantity in _ANGLES][unit or taken[quantity in _ANGLES]]
        si.append([number * (1.0 if radians else factor) for number, radians in numbers])
    unsaid = [f"{name} in {_UNITS[taken[name in _ANGLES]]}" for name, (unit, _) in columns.items() if not unit]
    notes = [f"{path}: {', '.join(unsaid)}, by their size"] if unsaid else []
    return list(zip(*si, strict=True)), notes


def _named(name: str, quantity: str) -> re.Match[str] | None:
    """Return a match with the unit in its second group if a heading, as ``α_{i-1} [deg]``, is of this quantity."""
    plain = re.sub(r"[\\{}]|_?\(?i(?: ?- ?1)?\)?(?=[\W_]|$)", "", name.lower().replace("θ", "theta"))
    return re.fullmatch(rf"({quantity})(?:[ _]*[ _\[(]\s*([a-z°]+)\s*[\])]?)?[ _]*", plain.replace("α", "alpha"))


def _value(cell: str, angle: bool) -> tuple[float, bool] | None:
    """Return a number, and whether it is in radians whatever the heading says; None if it is none.

    An angle may be a fraction of pi, have a degree sign, and stand beside its joint's variable: ``θ1 - π/2``.
    """
    text = re.sub(r"[\s\\{}*]", "", cell.replace("\N{MINUS SIGN}", "-")).replace("π", "pi")
    if angle:
        text = re.sub(r"^\+?(?:theta|θ|q)_?[0-9i]\+?|\+(?:theta|θ|q)_?[0-9i]$", "", text).rstrip("°") or "0"
        if match := re.fullmatch(rf"([+-]?)({NUMBER.pattern})?pi(?:/({NUMBER.pattern}))?", text):
            number = float(match[2] or 1.0) * math.pi / float(match[3] or 1.0)
            return (-number if match[1] == "-" else number), True
    return (float(text), False) if NUMBER.fullmatch(text) else None


ARM = "robot"
"""Name of the arm if the file has none."""
_IDENTIFY_SHARE = 0.75
"""Share of the rows for identification; the others are held out and show the accuracy of the calibration."""
_PREVIEWED = 3
_LOOKED_AT, _SWIFT_ROWS = 2000, 50
"""Numbers of rows, at most and at least, that decide between a motion and stops."""
_OTHER_WAY = 0.3
"""Share of the remaining error below which the other convention of D-H rows is named."""
_UNITS = {"rad": "radians", "deg": "degrees"} | {"m": "metres", "mm": "millimetres", "um": "micrometres"}
_UNITS |= {"cm": "centimetres", "in": "inches"}

_MOTION_S, _USUAL_MOTION_S, _STOPS_S = (5e-5, 0.2), (5e-4, 0.05), (0.5, 300.0)
"""Times from row to row [s] of a recording of motion, the same where the unit is not sure, and of readings at rest."""
_SMOOTH, _JUMPS = 0.02, 0.1
"""Steps of the joints from row to row, as a share of their range: below the first a motion, above the second stops."""


class InitResult(Result, schema="cellapp-init"):
    """``init``: the profile that was written, and what is to be known about it; ``readings`` are the converted ones,
    ``joints`` the file of joint positions of a motion, ``points`` that of its points, where it is known, ``smr`` the
    one of two SMRs that is taken."""

    profile: str
    notes: tuple[str, ...] = ()
    readings: str | None = None
    joints: str | None = None
    points: str | None = None
    smr: str | None = None
    omitted_when_none = frozenset({"readings", "joints", "points", "smr"})


def write_own_data(own: InitRequest, choose: Choose = nobody, outputs: Outputs = NEW_ONLY) -> InitResult:
    """Write profile, arm type and readings in SI units below the folder of the request.

    Raises
    ------
    InputError
        If readings or rows cannot be understood, an answer is missing and nobody can be asked, or a file exists.
    """
    assert own.readings is not None
    folder, looked = own.folder, read_recorded(own.readings, own.column, choose, most=_LOOKED_AT)
    name = own.name or own.readings.stem.lower().replace(" ", "-")
    profile, readings = folder / FOLDER / f"{name}.yaml", folder / READINGS / f"{name}.csv"
    rows, ground = _rows_are(own, looked, choose)
    types = _types(own, len(looked.joints))
    if rows == "motion":
        if not own.arm:
            words = ", ".join(one.name for one in types)
            raise InputError(
                f"{own.readings}: joint positions of a motion; which arm? Give --arm NAME ({words}), the file of an arm"
                " type, or one of D-H rows"
            )
        return _for_recordings(own.readings, profile, looked, types[0], outputs)
    recorded = read_recorded(own.readings, looked.taken, choose)
    angles, lengths = _decided_units(own, recorded, types, choose)
    q, p_M = recorded.of_one_point(angles, lengths)
    names = recorded.smrs
    arm_type = _decided_type(own, types, q, p_M, choose)
    arms = recorded.arms or (ARM,)
    header, cells = converted(recorded, angles, lengths, ARM, _clock_of_stops(recorded))
    files = {
        folder / FOLDER / arm_type.file: arm_type.text,
        readings: table_text(header, cells),
        profile: _profile_text(name, arms, arm_type.file, len(cells) // max(1, len(names)), readings, profile),
    }
    write_new(files, outputs)
    if len(names) > 1:
        taken = "three or more give a position and an orientation"
        taken = taken if len(names) > 2 else f"two give no orientation: the next command takes {names[0]}"
        ground = (*ground, f"SMRs {', '.join(names)}: {taken}; --smr NAME takes another one alone")
    notes = (
        *_preview(recorded, angles, lengths),
        *ground,
        *recorded.notes,
        *arm_type.notes,
        *((words,) if (words := repeats_words(q, p_M)) else ()),
        _judged(arm_type, q, p_M, own.modified),
    )
    smr = names[0] if len(names) == 2 else None
    return InitResult(profile=str(profile), notes=notes, readings=str(readings), smr=smr)


def _rows_are(own: InitRequest, recorded: Recorded, choose: Choose) -> tuple[str, tuple[str, ...]]:
    """Return whether the rows are "stops" or samples of a "motion", and a sentence on what was derived.

    Rows seconds apart are stops; rows without points are joint positions of a motion, whose points stand elsewhere.
    """
    stamps, name = recorded.stamps, recorded.known.others.get("time_s", "time_s")
    if not recorded.points and stamps is None:
        raise InputError(
            f"{own.readings}: joint positions without points and without time; readings at rest need x, y, z in each"
            " row, a recording of a motion needs a column of time, such as time_s; the file has"
            f" {short(', '.join(recorded.known.others.get(one, one) for one in recorded.table.names), 200)}"
        )
    if own.rows or not recorded.points:
        return (own.rows if own.rows and recorded.points else "motion"), ()
    if stamps is None or len(stamps) < _SWIFT_ROWS or not (np.diff(stamps) >= 0.0).all():
        return "stops", ()
    step, units = usual_step(stamps), [recorded.clock] if recorded.clock else [*UNITS_OF_TIME.values()]
    q, swift = recorded.in_si("rad", "m")[0], _MOTION_S if recorded.clock else _USUAL_MOTION_S
    motion, stops = (any(low <= step * unit <= high for unit in units) for low, high in (swift, _STOPS_S))
    if motion != stops:
        return "motion" if motion else "stops", ()
    share = float(np.median(np.abs(np.diff(q, axis=0)).max(axis=1)) / max(np.ptp(q, axis=0).max(), 1e-300))
    words = f"{own.readings}: rows {step:.3g} apart in '{name}', joints move by {share:.2g} of their range between rows"
    kinds = ("stops", "motion")
    rows = "motion" if share <= _SMOOTH else "stops" if share >= _JUMPS else choose(f"{words}: which are they?", kinds)
    if rows not in kinds:
        raise InputError(f"{words}: readings at stops, or samples of a motion? Give --rows stops or --rows motion")
    return rows, (f"{words}: taken as {rows}; else give --rows",)


def _clock_of_stops(recorded: Recorded) -> float | None:
    """Return the unit of the times of stops, where the file does not say it [s]; None if none is plausible."""
    step = 0.0 if recorded.stamps is None else float(np.median(np.abs(np.diff(recorded.stamps))))
    return next((unit for unit in UNITS_OF_TIME.values() if _STOPS_S[0] <= step * unit <= _STOPS_S[1]), None)


def _for_recordings(joints: Path, profile: Path, recorded: Recorded, arm: _Type, outputs: Outputs) -> InitResult:
    """Write the profile and arm type for recordings of motion; ``joints`` has the joint positions."""
    text = _profile_text(profile.stem, recorded.arms or (ARM,), arm.file, 100, Path("READINGS.csv"), profile)
    points = joints if recorded.points else _points_beside(joints)
    streams = f"--joints {shell_word(joints)} --points {shell_word(points or 'FILE')}"
    head = f"# For recordings of motion: `cellapp import {shell_word(profile)} {streams} --run DIR`.\n"
    write_new({profile.parent / arm.file: arm.text, profile: head + text}, outputs)
    where = (
        "the points of the tracker stand beside them"
        if recorded.points
        else f"the points come from {points}, the only file beside it that has points and their times"
        if points
        else "the points come from another file: import takes both, with --joints and --points"
    )
    note = f"{joints}: joint positions of a motion, {len(recorded.joints)} joints; {where}"
    notes = (note, *recorded.notes)
    beside = None if points is None else str(points)
    return InitResult(profile=str(profile), notes=notes, joints=str(joints), points=beside)


def _points_beside(joints: Path) -> Path | None:
    """Return the only file beside one of ``joints`` that holds points of a motion; None unless there is just one."""
    found = []
    for path in (one for one in joints.absolute().parent.iterdir() if one.suffix.lower() in TABLES):
        with suppress(InputError):
            names = read_header(path, "points", EXAMPLES["points"]).names
            as_points, as_joints = (understood(names, kind, ("time_s", *POINT)).names for kind in KINDS[::-1])
            if {"time_s", *POINT} <= {*as_points} and "q1" not in as_joints:
                found.append(joints.parent / path.name)
    return found[0] if len(found) == 1 else None


# -- arm types --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Type:
    """An arm type: short name, file below the folder of profiles, text and parsed content."""

    name: str
    file: str
    text: str
    content: ArmType
    notes: tuple[str, ...] = ()
    other: ArmType | None = None
    """The same rows in the other convention, standard or modified."""

    def explained(self, q: Array, p_M: Array) -> Explained:
        return explained(nominal_geometry(self._rows(), np.zeros(3)), q, p_M)

    def better_reading(self, q: Array, p_M: Array) -> tuple[str, Explained] | None:
        return better_reading(nominal_geometry(self._rows(), np.zeros(3)), q, p_M)

    def _rows(self) -> Array:
        return np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in self.content.joints])


def _types(own: InitRequest, joints: int) -> list[_Type]:
    """Return the named type, else all types of this program with this number of joints."""
    arm = own.arm or ""
    path = Path(arm)
    if own.arm and path.suffix.lower() in (".yaml", ".yml", ".csv"):
        notes, other = tuple[str, ...](), None
        if path.suffix.lower() == ".csv":
            text, notes = arm_type_text(path, joints, modified=own.modified)
            other = arm_type_of_text(arm_type_text(path, joints, modified=not own.modified)[0], path)
        else:
            text = file_text(path, "--arm takes the file of an arm type")
        found = [_Type(path.stem, f"arms/{path.stem.lower()}.yaml", text, arm_type_of_text(text, path), notes, other)]
    else:
        found = [one for one in _all_arms() if arm.lower() in ("", one.name)]
    if not found:
        known = ", ".join(file.stem for file in arm_type_files())
        raise InputError(
            f"--arm: '{arm}' is no arm that comes with cellapp; there are {known}. Give the file of an arm type"
            " (.yaml), or of D-H rows (.csv)"
        )
    fitting = [one for one in found if len(one.content.joints) == joints]
    if not fitting and own.arm:
        raise InputError(f"--arm: {own.arm} has {len(found[0].content.joints)} joints, {own.readings} has {joints}")
    if not fitting:
        raise InputError(
            f"{own.readings} has {joints} joints, and no arm that comes with cellapp has so many; give its D-H rows"
            " with --arm ROWS.csv"
        )
    return fitting


def _all_arms() -> list[_Type]:
    """Return the arm types of this program."""
    texts = {file: file.read_text("utf-8") for file in arm_type_files()}
    return [_Type(file.stem, f"arms/{file.name}", text, arm_type_of_text(text, file)) for file, text in texts.items()]


def _decided_type(own: InitRequest, types: list[_Type], q: Array, p_M: Array, choose: Choose) -> _Type:
    """Return the named type; else ask a person, listing first the types that explain the readings."""
    if own.arm:
        return types[0]
    fits = sorted(((one.explained(q, p_M).rms_m, one) for one in types), key=lambda fit: fit[0])
    words = ", ".join(f"{one.name} ({1e3 * rms:.1f} mm)" for rms, one in fits)
    answer = choose(f"Which arm is it? What each leaves of the points: {words}", tuple(one.name for _, one in fits))
    for _, one in fits:
        if one.name == answer:
            return one
    raise InputError(
        f"{own.readings}: which arm? Give --arm NAME, the file of an arm type, or one of D-H rows. What each arm with"
        f" {q.shape[1]} joints leaves of the points (the right one leaves a few mm): {words}"
    )


# -- units ------------------------------------------------------------------------------------------------------------


def _decided_units(
    own: InitRequest, recorded: Recorded, types: list[_Type], choose: Choose
) -> tuple[AngleUnit, LengthUnit]:
    """Return the units: as given, as in the file, as the only ones that explain the points, or as a person says."""
    angles, lengths = own.angles or recorded.angles, own.lengths or recorded.lengths
    ways = [
        (angle, length)
        for angle in ((angles,) if angles else ("rad", "deg"))
        for length in ((lengths,) if lengths else ("m", "mm"))
    ]
    if len(ways) > 1:
        ways = [way for way in ways if _explains(recorded, types, *way)] or ways
    for place, (what, units, option) in enumerate(
        (("joint positions", ("rad", "deg"), "--angles"), ("points", ("m", "mm"), "--lengths"))
    ):
        possible = tuple(unit for unit in units if any(way[place] == unit for way in ways))
        if len(possible) > 1:
            answer = choose(f"In which unit are the {what}? {_extremes(recorded, what)}", possible)
            if answer not in possible:
                raise InputError(
                    f"{own.readings}: the unit of the {what} is not clear ({_extremes(recorded, what)}); give {option}"
                    f" {' or '.join(possible)}, or write it into the header, as in {'q1_deg' if place == 0 else 'x_mm'}"
                )
            ways = [way for way in ways if way[place] == answer]
    return ways[0]


def _explains(recorded: Recorded, types: list[_Type], angles: AngleUnit, lengths: LengthUnit) -> bool:
    q, p_M = recorded.of_one_point(angles, lengths)
    return any(one.explained(q, p_M).holds for one in types)


def _extremes(recorded: Recorded, what: str) -> str:
    values = recorded.in_si("rad", "m")[what == "points"]
    return f"they lie between {values.min():g} and {values.max():g}"


# -- what is written and said -----------------------------------------------------------------------------------------


def _profile_text(name: str, arms: tuple[str, ...], type_file: str, rows: int, readings: Path, profile: Path) -> str:
    identify = max(1, round(_IDENTIFY_SHARE * rows / len(arms)))
    arm: Mapping[str, object] = {"type": type_file, "driver": {"kind": "none"}, "smr": {"offset": "unknown"}}
    content = {
        "schema": "cellapp-profile",
        "version": 1,
        "name": name,
        "seed": 0,
        "arms": {one: dict(arm) for one in arms},
        "tracker": {"driver": {"kind": "none"}},
        "splits": {"identify": identify, "train": 0, "validate": "rest"},
        "calibration": {"parameter_set": "auto", "priors": {"length": "3 mm", "angle": "5 mrad"}},
    }
    head = (
        f"# Readings that were recorded elsewhere, for `cellapp import {shell_word(profile)}"
        f" {shell_word(readings)} --run DIR`.\n"
        "# Nothing is planned or moved, so no poses are needed. `cellapp docs readings` goes on from here.\n"
        "# smr.offset: where the measured point lies on the flange; the data find it.\n"
        "# splits: readings that identify the arm; the others are held out and show what the calibration is worth.\n"
        "# priors: how far lengths and angles may be from the published ones (one standard deviation).\n"
    )
    return head + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _preview(recorded: Recorded, angles: AngleUnit, lengths: LengthUnit) -> tuple[str, ...]:
    """Say how the file was understood."""
    decimals = ", decimal commas" if recorded.decimal_comma else ""
    unused = recorded.unknown
    known = [f"{other} = {name}" for name, other in recorded.known.others.items() if other not in (name, *unused)]
    rows = list(zip(*recorded.table.cells.values(), strict=True))
    first = "; ".join(" ".join(row) for row in rows[:_PREVIEWED])
    return (
        f"{recorded.path}: {counted(len(rows), 'row')}, {len(recorded.joints)} joints, separated by"
        f" {recorded.separator}{decimals}; joint positions in {_UNITS[angles]}, points in {_UNITS[lengths]}",
        f"first rows: {first}",
        *([f"columns: {', '.join(known)}"] if known else []),
        *([f"kept and not used: {', '.join(unused)}"] if unused else []),
    )


def _judged(arm_type: _Type, q: Array, p_M: Array, modified: bool) -> str:
    """Say whether the published arm explains the points."""
    now = arm_type.explained(q, p_M)
    other = None if arm_type.other is None else replace(arm_type, content=arm_type.other).explained(q, p_M)
    misfit = f"the published geometry of {arm_type.content.model} leaves {1e3 * now.rms_m:.1f} mm rms of the points"
    if other is not None and other.rms_m < _OTHER_WAY * now.rms_m:
        words = "without --modified (standard rows)" if modified else "as modified rows"
        do = "leave --modified out" if modified else "give --modified"
        return f"WARNING: {misfit}, {words} {1e3 * other.rms_m:.1f} mm: {do}"
    if now.computed:
        return f"WARNING: {misfit}: {COMPUTED}"
    if now.holds:
        return f"{misfit}: arm, units and signs fit"
    better = arm_type.better_reading(q, p_M)
    if better is None:
        alike = [one for one in _all_arms() if len(one.content.joints) == q.shape[1]]
        others = [one.name for one in alike if one.explained(q, p_M).holds]
        fits = f"; the points fit {' and '.join(others)}" if others else ""
        hint = f"check the arm, the order of the joints, their zero positions and the units{fits}"
    else:
        hint = f"with {better[0]} it leaves {1e3 * better[1].rms_m:.1f} mm: change the file so"
    return f"WARNING: {misfit}, which spread over {1e3 * now.spread_m:.0f} mm: {hint}"
