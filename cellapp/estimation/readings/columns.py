"""Table of the columns of a reading: names, units, shapes, checks.

The SQL schema, the rows of the run file, CSV import and export, and single readings are derived from ``COLUMNS``. A new
quantity needs one entry here and one attribute of ``Readings``.

In addition, a row has the name of its arm and ``extras``: unknown columns of an imported file, kept as text.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.model.arguments import first_in_degrees

Shape = Literal["scalar", "joints", "point", "symmetric", "quaternion"]
Values: TypeAlias = NDArray[Any] | tuple[str | None, ...]
"""One column of n readings: an array of n rows, or n texts."""

SPLITS = ("identify", "train", "validate")

_UPPER = np.triu_indices(3)
_VARIANCES = [0, 3, 5]
"""Indices of the variances among the six numbers of an upper triangle."""
_FURTHEST_M = 100.0
"""Largest plausible coordinate: no laser tracker measures beyond 80 m (Leica AT960); a larger one is not in metres."""
_LEAST_SIGMA_M, _LARGEST_SIGMA_M = 1e-10, 0.01
"""Range of standard uncertainties that instruments state for points [m]; beyond it their squares lose all meaning."""
_UNIT_LENGTH, _ROUNDED = 1e-3, 1e-12
"""Tolerances of a quaternion's length about one: above the first (four digits) refused, above the second normalised."""
_LEAST_SIGMA_RAD, _LARGEST_SIGMA_RAD = 1e-9, 0.1
"""Range of standard uncertainties that instruments state for orientations [rad]; a larger one is in degrees or mrad."""
_REVOLUTION = 2.0 * math.pi
_LONGEST_S = 1e11
"""Largest plausible time in seconds; clocks that count from 1970 are below 1e10."""
_SINGULAR = 1e-14
"""Eigenvalue of a correlation matrix above which it counts as positive: some ten times the rounding of its entries."""


@dataclass(frozen=True)
class Fault:
    """An implausible value: its row, its index in the column's CSV names (None: all), and what was expected."""

    row: int
    place: int | None
    text: str


@dataclass(frozen=True)
class Column:
    """One quantity of a reading, or of a row of another table that a ``TableSpec`` describes.

    Attributes
    ----------
    name : str
        Attribute of ``Readings``; of targets, the key in YAML.
    unit : str
        SI unit, or "" for a number or word without one.
    csv : tuple of str
        Names in a CSV file; for a quantity per joint the stem, to which the joint's number is appended.
    shape : str
        Shape of one reading's value: ``scalar`` (), ``joints`` (N,), ``point`` (3,), ``quaternion`` (4,), ``symmetric``
        (3, 3).
    dtype : type
        np.float64, np.int64, np.int8 or str.
    sql : str
        Name in the run file.
    required : bool
        Whether every reading has it.
    fill : float, optional
        Value of missing entries in a column that is always there. If None, the column is None if no reading has a
        value; else readings without a value hold NaN.
    allowed : tuple, optional
        The only accepted values (besides a missing one).
    expected : str
        These values in words.
    check : function, optional
        Function that finds the first implausible value in a CSV file, given the values as a matrix (n, w), w numbers
        per reading.
    since : int
        Schema of the run file that introduced the column.
    units : tuple of str
        Units one of which follows each name in ``csv`` after an underscore; "" if the name is whole.
    """

    name: str
    unit: str
    csv: tuple[str, ...]
    shape: Shape = "scalar"
    dtype: type = np.float64
    sql: str = ""
    required: bool = False
    fill: float | None = None
    allowed: tuple[float | str, ...] = ()
    expected: str = ""
    check: Callable[[NDArray[Any]], Fault | None] | None = None
    since: int = 1
    units: tuple[str, ...] = ("",)

    @property
    def sql_name(self) -> str:
        """Name in the run file."""
        return self.sql or self.name

    @property
    def sql_declaration(self) -> str:
        """Name and type for CREATE TABLE and ALTER TABLE.

        Scalar floats have no declared type: SQLite would store some of them as integers. Several numbers are stored as
        JSON text, whose shortest decimals restore the same float64 and stay legible in any SQLite tool.
        """
        kind = " INTEGER" if self.dtype is np.int64 else " TEXT" if self.dtype is str or self.shape != "scalar" else ""
        always = self.required or (self.fill is not None and not math.isnan(self.fill))
        return f"{self.sql_name}{kind}{' NOT NULL' if always else ''}"

    def csv_names(self, joints: int) -> tuple[str, ...]:
        """Return the names in a CSV file for an arm with this number of joints, in the order of ``matrix``."""
        if self.shape == "joints":
            return tuple(f"{self.csv[0]}{joint}" for joint in range(1, joints + 1))
        return self.csv

    def array_shape(self, n: int, joints: int) -> tuple[int, ...]:
        """Return the shape of the column of n readings."""
        shapes = {"scalar": (), "joints": (joints,), "point": (3,), "quaternion": (4,), "symmetric": (3, 3)}
        return (n, *shapes[self.shape])

    def missing(self, n: int, joints: int) -> NDArray[Any] | None:
        """Return the column of n readings without any value."""
        if self.fill is None:
            return None
        return np.full(self.array_shape(n, joints), self.fill, dtype=self.dtype)

    def matrix(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a column as a matrix (n, w); for symmetric matrices the upper triangles, row by row."""
        if self.shape == "symmetric":
            return values[:, _UPPER[0], _UPPER[1]]
        return values[:, np.newaxis] if self.shape == "scalar" else values

    def from_matrix(self, matrix: NDArray[Any]) -> NDArray[Any]:
        """Return the column from its ``matrix`` (n, w), the reverse of the method ``matrix``. NaN becomes ``fill``
        unless that is None; rounded quaternions are normalised."""
        if self.fill is not None:
            matrix = np.where(np.isnan(matrix), self.fill, matrix)
        matrix = matrix.astype(self.dtype)
        if self.shape == "quaternion":
            length = np.linalg.norm(matrix, axis=1, keepdims=True)
            return np.where(np.abs(length - 1.0) > _ROUNDED, matrix / length, matrix)
        if self.shape == "symmetric":
            return _symmetric(matrix)
        return matrix[:, 0] if self.shape == "scalar" else matrix

    def is_given(self, values: Values | None) -> bool:
        """Return whether any reading has a value other than the one for missing entries."""
        if values is None or self.fill is None or isinstance(values, tuple):
            return values is not None
        return bool(np.any(~np.isnan(values) if math.isnan(self.fill) else values != self.fill))


def _symmetric(triangles: NDArray[Any]) -> NDArray[Any]:
    """Return the matrices (n, 3, 3) of upper triangles (n, 6), row by row."""
    matrices: NDArray[Any] = np.empty((len(triangles), 3, 3), dtype=triangles.dtype)
    matrices[:, _UPPER[0], _UPPER[1]] = matrices[:, _UPPER[1], _UPPER[0]] = triangles
    return matrices


def _in_reach(points: NDArray[Any]) -> Fault | None:
    far = np.argwhere(np.abs(points) > _FURTHEST_M)
    if not len(far):
        return None
    row, axis = far[0].tolist()
    return Fault(row, axis, f"expected metres, got {points[row, axis]:g}; no tracker reaches {_FURTHEST_M:g} m")


def _within(low: float, high: float, unit: str, guess: str = "") -> Callable[[NDArray[Any]], Fault | None]:
    """Return a check that finds values outside the range of this kind of measurement; missing values pass. ``guess``
    says what a larger one may be."""

    def check(values: NDArray[Any]) -> Fault | None:
        wrong = np.argwhere((values < low) | (values > high))
        if not len(wrong):
            return None
        row, place = wrong[0].tolist()
        meant = guess if values[row, place] > high else ""
        return Fault(row, place, f"expected {low:g} to {high:g} {unit}, got {values[row, place]:g}{meant}")

    return check


def beyond_limits(q: NDArray[Any], limits: NDArray[Any], guess: str = "degrees?") -> list[Fault]:
    """Return the first joint position of each joint that exceeds its limits by more than a revolution.

    Parameters
    ----------
    q : array, shape (n, N) [rad]
    limits : array, shape (N, 2) [rad]
        Lower and upper limits. A controller may count a revolution that the limits of the cell do not include.
    guess : str
        Message for a value that would be within the limits in degrees.
    """
    faults = []
    for joint, (low, high) in enumerate(limits.tolist()):
        values = q[:, joint]
        wrong = np.flatnonzero((values < low - _REVOLUTION) | (values > high + _REVOLUTION))
        if not len(wrong):
            continue
        value = float(values[wrong[0]])
        meant = f"; {guess}" if low <= math.radians(value) <= high else ""
        limited = f"expected {low:.4g} to {high:.4g} rad (limits of the joint) or one revolution more"
        faults.append(Fault(int(wrong[0]), joint, f"{limited}, got {value:g}{meant}"))
    return faults


def _in_radians(q: NDArray[Any]) -> Fault | None:
    place = first_in_degrees(q)
    if place is None:
        return None
    return Fault(*place, f"expected radians, got {q[place]:g}, and most rows are beyond two turns; are these degrees?")


def _positive(sigma: NDArray[Any]) -> Fault | None:
    wrong = np.flatnonzero(sigma[:, 0] <= 0.0)
    if not len(wrong):
        return _within(_LEAST_SIGMA_M, _LARGEST_SIGMA_M, "m")(sigma)
    return Fault(int(wrong[0]), 0, f"expected an uncertainty above 0 m, got {sigma[wrong[0], 0]:g}")


def _incomplete(values: NDArray[Any], what: str) -> Fault | None:
    """Find a row that has some of its values, and not all."""
    missing = np.isnan(values)
    rows = np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))
    if not len(rows):
        return None
    return Fault(int(rows[0]), int(np.argmax(missing[rows[0]])), f"the value is missing; give all {what} or none")


def _of_unit_length(quaternions: NDArray[Any]) -> Fault | None:
    """Check quaternions (n, 4), scalar first."""
    if (incomplete := _incomplete(quaternions, "four of the quaternion")) is not None:
        return incomplete
    length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _UNIT_LENGTH)
    if not len(wrong):
        return None
    row = int(wrong[0])
    guess = "; are these angles in degrees?" if np.abs(quaternions[row]).max() > 1.0 + _UNIT_LENGTH else ""
    text = f"expected a unit quaternion, scalar first, got one of length {length[row]:.4g}{guess}"
    return Fault(row, None, text)


def _positive_definite(triangles: NDArray[Any], low: float, high: float, unit: str) -> Fault | None:
    """Check upper triangles (n, 6) by their correlations: 1e-12 m^2 is a usual variance, not a sign of singularity.

    ``low`` and ``high`` are the least and largest standard uncertainty, ``unit`` is that of their squares.
    """
    if (incomplete := _incomplete(triangles, "six of the covariance")) is not None:
        return incomplete
    least, largest = low**2, high**2
    variances = triangles[:, _VARIANCES]
    absurd = np.argwhere((variances > largest) | ((variances > 0.0) & (variances < least)))
    if len(absurd):
        row, place = absurd[0].tolist()
        text = f"expected a variance of {least:g} to {largest:g} {unit}, got {variances[row, place]:g}"
        return Fault(row, _VARIANCES[place], text)
    given = np.flatnonzero(~np.isnan(triangles).any(axis=1))
    if not len(given):
        return None
    matrices = _symmetric(triangles[given])
    variance = np.einsum("nii->ni", matrices)
    positive = np.all(variance > 0.0, axis=1)
    scale = np.sqrt(np.where(positive[:, np.newaxis], variance, 1.0))
    with np.errstate(over="ignore"):
        correlation = matrices / scale[:, :, np.newaxis] / scale[:, np.newaxis, :]
    # A correlation beyond 2 needs no eigenvalues, which could overflow.
    usable = positive & np.all(np.abs(correlation) < 2.0, axis=(1, 2))
    smallest = np.linalg.eigvalsh(np.where(usable[:, np.newaxis, np.newaxis], correlation, -np.eye(3)))[:, 0]
    wrong = given[smallest <= _SINGULAR]
    return Fault(int(wrong[0]), None, f"expected a positive definite covariance in {unit}") if len(wrong) else None


def _places(sequence: NDArray[Any]) -> Fault | None:
    absurd = _within(-1e15, 1e15, "as its place")(sequence)
    if absurd is not None:
        return absurd
    missing = np.isnan(sequence[:, 0])
    if missing.all():
        return None
    if missing.any():
        return Fault(int(np.argmax(missing)), 0, "the value is missing; give every row of the arm its place, or none")
    _, first = np.unique(sequence[:, 0], return_index=True)
    again = np.setdiff1d(np.arange(len(sequence)), first)
    if not len(again):
        return None
    return Fault(int(again[0]), 0, f"{sequence[again[0], 0]:g} is the place of another row of the arm already")


_SIGMA_RAD = _within(_LEAST_SIGMA_RAD, _LARGEST_SIGMA_RAD, "rad", "; degrees or mrad?")
_DEGREES_C = _within(-100.0, 200.0, "degC, not kelvin or Fahrenheit")

CONFIGURATION = Column("configuration", "", ("configuration",), dtype=np.int64, required=True)
"""Number of the stop; with the arm it is the key of a reading."""

OF_SOCKETS = "point"
"""Column of readings of a ball in sockets, which earlier versions stored: kept for export, refused by an import."""
OF_SEVERAL = "smr"
"""Column that names the SMR that was measured; earlier versions stored several of a stop."""

COLUMNS: tuple[Column, ...] = (
    CONFIGURATION,
    Column("time_s", "s", ("time_s",), fill=math.nan, check=_within(-_LONGEST_S, _LONGEST_S, "s")),
    Column("sequence", "", ("sequence",), check=_places, since=5),
    Column("q", "rad", ("q",), "joints", required=True, check=_in_radians),
    Column("q_spread", "rad", ("q_spread_rad",), check=_within(0.0, 1.0, "rad"), since=11),
    Column(
        "approach", "", ("approach",), "joints", np.int8, fill=0, allowed=(-1, 0, 1), expected="-1, 0 (unknown) or 1"
    ),
    Column("payload_kg", "kg", ("payload_kg",), check=_within(0.0, 1e4, "kg")),
    Column(
        "payload_center_F",
        "m",
        ("payload_cx_m", "payload_cy_m", "payload_cz_m"),
        "point",
        sql="payload_center_f",
        check=_within(-10.0, 10.0, "m"),
        since=8,
    ),
    Column("temperature_c", "degC", ("temperature_c",), check=_DEGREES_C),
    Column("joint_temperature_c", "degC", ("joint_temperature",), "joints", check=_DEGREES_C),
    Column("step", "rad", ("step",), "joints", check=_within(-1e3, 1e3, "rad"), since=2),
    Column("dwell_s", "s", ("dwell_s",), check=_within(0.0, _LONGEST_S, "s"), since=2),
    Column("p_M", "m", ("x_m", "y_m", "z_m"), "point", sql="p_m", required=True, check=_in_reach),
    Column("sigma_m", "m", ("sigma_m",), check=_positive),
    Column(
        "covariance_M",
        "m^2",
        ("sxx", "sxy", "sxz", "syy", "syz", "szz"),
        "symmetric",
        sql="covariance_m2",
        check=partial(_positive_definite, low=_LEAST_SIGMA_M, high=_LARGEST_SIGMA_M, unit="m^2"),
    ),
    Column("quaternion_M", "", ("quat_w", "quat_x", "quat_y", "quat_z"), "quaternion", check=_of_unit_length, since=8),
    Column("sigma_rad", "rad", ("sigma_rad",), check=_SIGMA_RAD, since=8),
    Column(
        "rotation_covariance_M",
        "rad^2",
        ("rot_xx", "rot_xy", "rot_xz", "rot_yy", "rot_yz", "rot_zz"),
        "symmetric",
        sql="turning_covariance_rad2",
        check=partial(_positive_definite, low=_LEAST_SIGMA_RAD, high=_LARGEST_SIGMA_RAD, unit="rad^2"),
        since=10,
    ),
    Column("smr", "", ("smr",), dtype=str, since=8),
    Column("station", "", ("station",), dtype=str, since=8),
    Column("point", "", ("point",), dtype=str, since=7),
    Column("split", "", ("split",), dtype=str, allowed=SPLITS, expected="identify, train, validate or nothing"),
)
"""All columns, in the order of an exported CSV file."""
