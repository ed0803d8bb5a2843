"""Columns that write the orientation of a probe in another way than ``quat_w`` to ``quat_z``, told by their names.

Quaternions by other names, rotation vectors, roll, pitch and yaw with a unit, and matrices say what they are. Three
angles by any other names may be anything: they are not used, and a note says how to name them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.run.csv_text import NUMBER, CsvTable, short
from cellapp.ground.errors import InputError

Array = NDArray[np.float64]
QUATERNION = ("quat_w", "quat_x", "quat_y", "quat_z")
_UNITS = {"": 1.0, "rad": 1.0, "deg": float(np.pi / 180.0)}
_MOST_RAD = 4.0 * np.pi
"""Larger angles are taken as degrees."""
_OFF = 1e-3
"""By how much a matrix times its transpose may differ from one."""


@dataclass(frozen=True)
class Form:
    """A way to write an orientation: its columns, whose ``parts`` and units ``pattern`` finds in a name.

    ``rotations`` are those of their values (n, k) [rad], None where they are a quaternion; ``said`` in words.
    ``needs_unit``: the names must say degrees or radians.
    """

    pattern: re.Pattern[str]
    parts: tuple[str, ...]
    said: str
    rotations: Callable[[Array], scipy.spatial.transform.Rotation] | None
    needs_unit: bool = False


_FORMS = (
    Form(re.compile(r"(?:quaternion|quat|q|orientation|o)_?([wxyz])()"), ("w", "x", "y", "z"), "a quaternion", None),
    Form(
        re.compile(r"(?:rotvec|rot_vec|rotation_vector|rv)_?([xyz])(?:_(rad|deg))?"),
        ("x", "y", "z"),
        "a rotation vector",
        lambda vectors: scipy.spatial.transform.Rotation.from_rotvec(vectors),
    ),
    Form(
        re.compile(r"(roll|pitch|yaw)(?:_(rad|deg))?"),
        ("roll", "pitch", "yaw"),
        "rot_z(yaw) rot_y(pitch) rot_x(roll)",
        lambda rpy: scipy.spatial.transform.Rotation.from_euler("xyz", rpy),
        needs_unit=True,
    ),
    Form(
        re.compile(r"(?:r|rot|rotation|m)_?([123][123])()"),
        tuple(f"{row}{column}" for row in "123" for column in "123"),
        "a matrix, its rows one after another",
        lambda entries: scipy.spatial.transform.Rotation.from_matrix(entries.reshape(-1, 3, 3)),
    ),
)
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
    """The columns of an orientation as they stand in a file, in the order of their form, and the factor to radians."""

    form: Form
    columns: tuple[str, ...]
    factor: float

    @property
    def said(self) -> str:
        """How they are understood."""
        return f"taken as {self.form.said} of the probe's orientation in the tracker frame"

    def quaternions(self, cells: Mapping[str, Sequence[str]], place: Callable[[int], str]) -> list[tuple[str, ...]]:
        """Cells of ``QUATERNION``, a row each; empty rows stay empty.

        Raises ``InputError`` with the ``place`` of the first row that is no rotation.
        """
        texts = list(zip(*(cells[name] for name in self.columns), strict=True))
        if self.form.rotations is None:
            return texts
        values: dict[int, list[float]] = {}
        for row, one in enumerate(texts):
            if any(text.strip() for text in one):
                try:
                    values[row] = self._values(one)
                except ValueError as fault:
                    raise InputError(f"{place(row)}: {fault}") from None
        found: list[tuple[str, ...]] = [("",) * 4] * len(texts)
        if values:
            turns = self.form.rotations(np.array([*values.values()]) * self.factor)
            for row, turn in zip(values, turns.as_quat(canonical=True, scalar_first=True).tolist(), strict=True):
                found[row] = tuple(map(repr, turn))
        return found

    def _values(self, texts: Sequence[str]) -> list[float]:
        """The numbers of a row. Raises ``ValueError`` with column and fault if they are no rotation."""
        values = []
        for name, text in zip(self.columns, map(str.strip, texts), strict=True):
            if not text:
                raise ValueError(f"{name}: the value is missing; give all {len(texts)} of the orientation or none")
            values.append(float(text) if NUMBER.fullmatch(text) else math.nan)
            if not math.isfinite(values[-1]):
                raise ValueError(f"{name}: expected a finite number such as 0.25, got '{short(text)}'")
        if (fault := self._no_rotation(np.array(values))) is not None:
            raise ValueError(f"{self.columns[0]}: {fault}")
        return values

    def _no_rotation(self, values: Array) -> str | None:
        """Why values (k,) are no rotation; None if they are one."""
        if len(values) < 9:
            largest = float(np.abs(values).max()) * self.factor
            return None if largest <= _MOST_RAD else f"{largest:.4g} rad; are these angles in degrees?"
        matrix = values.reshape(3, 3)
        off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        if off > _OFF:
            return f"rows {self.columns[0]} to {self.columns[-1]} are off unit length and right angles by {off:.2g}"
        return None if np.linalg.det(matrix) > 0.0 else "the matrix is a reflection: a frame is left-handed"


def written_orientation(names: Sequence[str]) -> tuple[Written | None, list[str]]:
    """What the columns of a header say of an orientation, and notes on those that say too little.

    None where they are ``QUATERNION`` already, or none are there.
    """
    if any(name in QUATERNION for name in names):
        return None, []
    plain = {_plain(name): name for name in names}
    for form in _FORMS:
        matches = ((form.pattern.fullmatch(key), name) for key, name in plain.items())
        found = [(match[1], match[2] or "", name) for match, name in matches if match]
        own, units = {part: name for part, _, name in found}, {unit for _, unit, _ in found}
        lacking = [part for part in form.parts if part not in own]
        if len(lacking) == 1:
            missing = f"not used as an orientation: a column for {lacking[0]} is missing"
            return None, [f"{', '.join(own.values())}: {missing}"]
        if lacking or len(found) != len(form.parts) or len(units) != 1:
            continue
        (unit,) = units
        columns = tuple(own[part] for part in form.parts)
        if form.needs_unit and not unit:
            return None, [f"{', '.join(columns)}: no orientation, as no unit is in the names: write _deg or _rad"]
        return Written(form, columns, _UNITS[unit]), []
    notes = []
    for pattern in _AMBIGUOUS:
        angles = {match[1]: name for key, name in plain.items() if (match := pattern.fullmatch(key))}
        if len(angles) == 3:
            notes.append(f"{', '.join(angles.values())}: not used as an orientation: {_WHAT_TO_DO}")
    return None, notes


def names_with_quaternion(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the columns that ``with_quaternions`` gives."""
    written, _ = written_orientation(names)
    return tuple(names) if written is None else (*(name for name in names if name not in written.columns), *QUATERNION)


def with_quaternions(table: CsvTable) -> tuple[CsvTable, list[str]]:
    """The table with the orientation of a probe as a quaternion, and notes. Raises ``InputError`` by row."""
    written, notes = written_orientation(table.names)
    if written is None:
        return table, notes
    rows = written.quaternions(table.cells, lambda row: table.place(table.lines[row]))
    cells = {name: own for name, own in table.cells.items() if name not in written.columns}
    cells |= dict(zip(QUATERNION, zip(*rows, strict=True) if rows else [()] * 4, strict=True))
    return replace(table, names=tuple(cells), cells=cells), [f"{', '.join(written.columns)}: {written.said}"]


def _plain(name: str) -> str:
    """A column's name in small letters, its unit behind an underscore: ``Roll [deg]`` is ``roll_deg``."""
    return re.sub(r"[^0-9a-z]+", "_", name.strip().lower()).strip("_")
