"""Columns that hold the orientation of a probe in other forms than ``quat_w`` to ``quat_z``, recognised by their names.

Names of other quaternions, rotation vectors, matrices, and of roll, pitch and yaw with a unit are unambiguous. Three
angles by any other names are ambiguous: they are not used, and a note says how to name them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import CsvTable, Problems
from cellapp.cell.run.table_spec import ArmCells
from cellapp.estimation.readings.columns import Fault
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_ORIENTATION_UNITS = {"": 1.0, "rad": 1.0, "deg": float(np.pi / 180.0)}
_MOST_RAD = 4.0 * np.pi
"""Largest plausible angle [rad]: larger ones are refused as probably degrees."""
_OFF = 1e-3
"""Largest deviation of a matrix times its transpose from the identity."""


@dataclass(frozen=True)
class Form:
    """A form of an orientation: its columns, whose ``parts`` and units ``pattern`` finds in a name.

    ``rotations`` converts their values (n, k) [rad], None for a quaternion; ``said`` describes the form.
    ``needs_unit``: the names must say degrees or radians.
    """

    pattern: re.Pattern[str]
    parts: tuple[str, ...]
    said: str
    rotations: Callable[[Array], scipy.spatial.transform.Rotation] | None
    needs_unit: bool = False


_OF = r"(?P<of>(?:.*_)?)"
_NUMBERED = Form(
    re.compile(_OF + r"(?:quaternion|quat|q|orientation|rotation|o)_?(?P<part>[0-3])(?P<unit>)"),
    ("0", "1", "2", "3"),
    "a quaternion",
    None,
)
_FORMS = (
    Form(
        re.compile(_OF + r"(?:quaternion|quat|q|orientation|rotation|o)_?(?P<part>[wxyz])(?P<unit>)"),
        ("w", "x", "y", "z"),
        "a quaternion",
        None,
    ),
    _NUMBERED,
    Form(
        re.compile(_OF + r"(?:rotvec|rot_vec|rotation_vector|rv)_?(?P<part>[xyz])(?:_(?P<unit>rad|deg))?"),
        ("x", "y", "z"),
        "a rotation vector",
        lambda vectors: scipy.spatial.transform.Rotation.from_rotvec(vectors),
    ),
    Form(
        re.compile(_OF + r"(?P<part>roll|pitch|yaw)(?:_(?P<unit>rad|deg))?"),
        ("roll", "pitch", "yaw"),
        "rot_z(yaw) rot_y(pitch) rot_x(roll)",
        lambda rpy: scipy.spatial.transform.Rotation.from_euler("xyz", rpy),
        needs_unit=True,
    ),
    *(
        Form(
            re.compile(_OF + r"(?:r|rot|rotation|m|t|matrix)_?(?P<part>[0-4]_?[0-4])(?P<unit>)"),
            tuple(f"{row}{column}" for row in axes for column in axes),
            f"a matrix, its rows one after another, counted from {axes[0]}",
            lambda entries: scipy.spatial.transform.Rotation.from_matrix(entries.reshape(-1, 3, 3)),
        )
        for axes in ("012", "123")
    ),
)
_OF_FIFTH_JOINT = re.compile(r"(?:.*_)?q_?[45]")
"""Beside such a column q0 to q3 are joints, not a quaternion."""
_OTHERS = {"tcp", "robot", "flange", "tool", "target", "commanded", "command", "desired"}
"""Orientations of these belong to the controller, not to the tracker."""
_AMBIGUOUS = tuple(
    re.compile(rf"({'|'.join(names)})(?:_(?:rad|deg))?")
    for names in (("rx", "ry", "rz"), ("a", "b", "c"), ("alpha", "beta", "gamma"), ("phi", "theta", "psi"))
)
_WHAT_TO_DO = (
    "they may be a rotation vector or Euler angles in any order; to use them, name them rotvec_x, rotvec_y, rotvec_z"
    " for a rotation vector [rad], roll_deg, pitch_deg, yaw_deg for rot_z(yaw) rot_y(pitch) rot_x(roll), or give"
    " quat_w, quat_x, quat_y, quat_z"
)


@dataclass(frozen=True)
class Written:
    """The columns of an orientation in a file, in the order of their form, and the factor to radians."""

    form: Form
    columns: tuple[str, ...]
    factor: float
    position: tuple[str, ...] = ()
    """The last column of a matrix of four: a point."""

    @property
    def said(self) -> str:
        """Description of how they are interpreted."""
        return f"{', '.join(self.columns)}: taken as {self.form.said} of the probe's orientation in the tracker frame"

    def quaternions(self, values: Array) -> tuple[Array, Fault | None]:
        """Convert values (n, k) of these columns to quaternions (n, 4), scalar first; return also the first fault. Rows
        without values, which are NaN, stay NaN."""
        if self.form.rotations is None:
            return values, None
        found = np.full((len(values), 4), np.nan)
        blank = np.isnan(values).all(axis=1)
        if values.shape[1] == 9:
            blank |= (values == 0.0).all(axis=1)  # programs write zeros where nothing was measured
        given = np.flatnonzero(~blank)
        if (fault := self._fault(values, given)) is None and len(given):
            rotations = self.form.rotations(values[given] * self.factor)
            found[given] = rotations.as_quat(canonical=True, scalar_first=True)
        return found, fault

    def _fault(self, values: Array, given: NDArray[np.intp]) -> Fault | None:
        """Return the fault of the first of the ``given`` rows that is not a rotation; None if all are."""
        own, columns = values[given], len(self.columns)
        if (part := np.isnan(own)).any():
            row, place = map(int, np.argwhere(part)[0])
            return Fault(int(given[row]), place, f"the value is missing; give all {columns} of the orientation or none")
        if columns < 9:
            largest = np.abs(own).max(axis=1, initial=0.0) * self.factor
            off, text = largest - _MOST_RAD, "{:.4g} rad; are these angles in degrees?"
        else:
            matrices = own.reshape(-1, 3, 3)
            largest = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
            off = largest - _OFF
            text = f"rows {self.columns[0]} to {self.columns[-1]} are off unit length and right angles by {{:.2g}}"
            if not (off > 0.0).any() and (mirrored := np.flatnonzero(np.linalg.det(matrices) < 0.0)).size:
                return Fault(int(given[mirrored[0]]), 0, "the matrix is a reflection: a frame is left-handed")
        wrong = np.flatnonzero(off > 0.0)
        return Fault(int(given[wrong[0]]), 0, text.format(largest[wrong[0]])) if len(wrong) else None


def written_orientation(names: Sequence[str]) -> tuple[Written | None, list[str]]:
    """Find the columns of an orientation in a header; return also notes on ambiguous ones.

    None if they are ``QUATERNION`` already, or there are none.
    """
    if any(name in QUATERNION for name in names):
        return None, []
    plain = {_plain(name): name for name in names}
    if any(map(_OF_FIFTH_JOINT.fullmatch, plain)):
        plain = {key: name for key, name in plain.items() if not _NUMBERED.pattern.fullmatch(key)}
    for form in _FORMS:
        sets: dict[str, dict[str, tuple[str, str]]] = {}
        for key, name in plain.items():
            if match := form.pattern.fullmatch(key):
                sets.setdefault(match["of"], {})[match["part"].replace("_", "")] = (name, match["unit"] or "")
        sets = {of: own for of, own in sets.items() if not _OTHERS & set(of.split("_"))}
        whole = [own for own in sets.values() if own.keys() >= {*form.parts}]
        if len(whole) == 1 and len({unit for _, unit in whole[0].values()}) == 1:
            columns, units = zip(*(whole[0][part] for part in form.parts), strict=True)
            if again := next((name for name in columns if f"{name} (2)" in names), ""):
                raise InputError(f"{again}: the column is there twice; keep one")
            if form.needs_unit and not units[0]:
                return None, [f"{', '.join(columns)}: no orientation, as no unit is in the names: write _deg or _rad"]
            beside = [f"{row[0]}{int(row[1]) + 1}" for row in form.parts[2::3]] if len(form.parts) == 9 else []
            position = tuple(whole[0][part][0] for part in beside if part in whole[0])
            position = position if len(position) == 3 else ()
            return Written(form, columns, _ORIENTATION_UNITS[units[0]], position), []
        own = sets.get("", {})
        lacking, *more = [part for part in form.parts if part not in own] or [""]
        if not whole and lacking and not more and form is not _NUMBERED:
            missing = f"not used as an orientation: a column for {lacking} is missing"
            return None, [f"{', '.join(name for name, _ in own.values())}: {missing}"]
    notes = []
    for pattern in _AMBIGUOUS:
        angles = {match[1]: name for key, name in plain.items() if (match := pattern.fullmatch(key))}
        if len(angles) == 3:
            notes.append(f"{', '.join(angles.values())}: not used as an orientation: {_WHAT_TO_DO}")
    return None, notes


def names_with_quaternion(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that ``with_quaternions`` gives."""
    written, _ = written_orientation(names)
    return tuple(names) if written is None else (*(name for name in names if name not in written.columns), *QUATERNION)


def with_quaternions(table: CsvTable) -> tuple[CsvTable, list[str]]:
    """Convert the orientation of a probe to a quaternion; return also notes. Raise ``InputError`` by row."""
    written, notes = written_orientation(table.names)
    if written is None:
        return table, notes
    own = [table.cells[name] for name in written.columns]
    if written.form.rotations is not None:
        cells = ArmCells(table, range(len(table.lines)), Problems(table.place))
        values = np.column_stack([cells.numbers(name, required=False) for name in written.columns])
        cells.problems.check()
        found, fault = written.quaternions(values)
        if fault is not None:
            where = f"{table.place(table.lines[fault.row])}: {written.columns[fault.place or 0]}"
            raise InputError(f"{where}: {fault.text}")
        own = [tuple("" if math.isnan(value) else repr(value) for value in column) for column in found.T.tolist()]
    columns = {name: its for name, its in table.cells.items() if name not in written.columns}
    columns |= dict(zip(QUATERNION, own, strict=True))
    return replace(table, cells=columns), [written.said]


def _plain(name: str) -> str:
    """Return a column's name in lower case, its unit after an underscore: ``Roll [deg]`` is ``roll_deg``."""
    return re.sub(r"[^0-9a-z]+", "_", name.strip().lower()).strip("_")
