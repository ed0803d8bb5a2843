"""Measured data: one reading, and all readings of one arm as arrays. No I/O here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings.columns import COLUMNS, CONFIGURATION, Values

FIRST_SAMPLE = 1_000_000_000
"""Configuration numbers from here on belong to samples of recordings: no plan has as many stops."""
_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """Reading of one arm with N joints at one stop.

    Attributes
    ----------
    q : array, shape (N,)
        Joint positions read from the controller [rad].
    p_M : array, shape (3,)
        Measured SMR centre in the tracker frame [m].
    time_s : float
        Seconds since the run began; NaN if unknown.
    sequence : float or None
        Place in the order in which the arm's readings were measured.
    approach : array, shape (N,), or None
        Sign of each joint's last motion before the stop: -1, 0 (unknown), +1; None if unknown for all joints.
    payload_kg, temperature_c, sigma_m : float or None
        Payload [kg]; arm or ambient temperature [degC]; isotropic standard uncertainty of ``p_M`` [m].
    joint_temperature_c : array, shape (N,), or None
        Joint temperatures [degC].
    step : array, shape (N,), or None
        Each joint's last motion before the stop, with its sign [rad].
    dwell_s : float or None
        Time from standstill to the measurement [s].
    payload_center_F : array, shape (3,), or None
        Centre of mass of the payload in F [m].
    covariance_M : array, shape (3, 3), or None
        Covariance of ``p_M`` [m^2]; the run file stores its upper triangle.
    quaternion_M : array, shape (4,), or None
        Orientation of the probe's frame S in M, unit quaternion, scalar first.
    sigma_rad : float or None
        Standard uncertainty of the orientation about each axis [rad].
    turning_covariance_M : array, shape (3, 3), or None
        Covariance of a rotation about the axes of M [rad^2]; it takes precedence over ``sigma_rad``.
    tau_nm, current_a : array, shape (N,), or None
        Measured joint torques [Nm] and motor currents [A].
    smr : str or None
        Name of the SMR on the flange that was measured; None for the only one.
    station : str or None
        Name of the tracker station, in whose frame the measurement is; None for the only one.
    point : str or None
        Name of the socket that a ball rested in; only earlier versions stored such readings.
    split : str or None
        identify, train or validate; None if not assigned.
    extras : dict
        Unknown columns of an imported file, as text.
    """

    q: _Floats
    p_M: _Floats
    time_s: float = float("nan")
    sequence: float | None = None
    approach: NDArray[np.int8] | None = None
    payload_kg: float | None = None
    temperature_c: float | None = None
    joint_temperature_c: _Floats | None = None
    step: _Floats | None = None
    dwell_s: float | None = None
    covariance_M: _Floats | None = None
    sigma_m: float | None = None
    payload_center_F: _Floats | None = None
    quaternion_M: _Floats | None = None
    sigma_rad: float | None = None
    turning_covariance_M: _Floats | None = None
    tau_nm: _Floats | None = None
    current_a: _Floats | None = None
    smr: str | None = None
    station: str | None = None
    point: str | None = None
    split: str | None = None
    extras: dict[str, str] = field(default_factory=dict)

    def as_readings(self, configuration: int) -> Readings:
        """Return this reading as the only row of ``Readings``, at the given stop.

        Raises
        ------
        ValueError
            If an array has the wrong shape.
        """
        values: dict[str, Values | None] = {CONFIGURATION.name: np.array([configuration], dtype=CONFIGURATION.dtype)}
        for column in COLUMNS:
            if column is CONFIGURATION:
                continue
            value = getattr(self, column.name)
            if value is None:
                values[column.name] = column.missing(1, len(self.q))
            elif column.dtype is str:
                values[column.name] = (value,)
            else:
                values[column.name] = np.asarray(value, dtype=column.dtype)[np.newaxis]
        return readings_from_columns(values, {name: (text,) for name, text in self.extras.items()})


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Readings:
    """The n readings of one arm with N joints.

    An optional quantity is None if no reading has it; if only some have it, the others hold NaN.

    Attributes
    ----------
    configuration : array, shape (n,), int64
        Number of the stop; rows of both arms with the same number were measured at the same stop.
    time_s : array, shape (n,)
        Seconds since the run began; NaN if unknown.
    sequence : array, shape (n,), or None
        Place in the order in which the arm's readings were measured, of an imported file.
    q : array, shape (n, N)
        Joint positions read from the controller [rad].
    approach : array, shape (n, N), int8
        Sign of each joint's last motion before the stop: -1, 0 (unknown), +1.
    p_M : array, shape (n, 3)
        Measured SMR centre in the tracker frame [m].
    payload_kg, temperature_c : array, shape (n,), or None
        Payload [kg]; arm or ambient temperature [degC].
    joint_temperature_c : array, shape (n, N), or None
        Joint temperatures [degC].
    step : array, shape (n, N), or None
        Each joint's last motion before the stop, with its sign [rad].
    dwell_s : array, shape (n,), or None
        Time from standstill to the measurement [s].
    covariance_M : array, shape (n, 3, 3), or None
        Covariance of ``p_M`` [m^2].
    sigma_m : array, shape (n,), or None
        Isotropic standard uncertainty of ``p_M`` [m].
    payload_center_F : array, shape (n, 3), or None
        Centre of mass of the payload in F [m].
    quaternion_M : array, shape (n, 4), or None
        Orientation of the probe's frame S in M, unit quaternion, scalar first; NaN in rows where it was not measured.
    sigma_rad : array, shape (n,), or None
        Standard uncertainty of the orientation about each axis [rad].
    turning_covariance_M : array, shape (n, 3, 3), or None
        Covariance of a rotation about the axes of M [rad^2]; it takes precedence over ``sigma_rad``.
    tau_nm, current_a : array, shape (n, N), or None
        Measured joint torques [Nm] and motor currents [A].
    smr : tuple of n (str or None), or None
        Names of the SMRs on the flange that were measured.
    station : tuple of n (str or None), or None
        Names of the tracker stations, in whose frames the measurements are.
    point : tuple of n str, or None
        Names of the sockets that a ball rested in, in place of ``p_M``, which is NaN; only earlier versions stored such
        readings, and nothing is estimated from them.
    other_q : array, shape (n, K), or None
        Joint positions of the other arm if that has no reading of its own at the stop, as in samples of recordings
        [rad]; NaN if unknown. Not a column: it comes from recordings.
    split : tuple of n (str or None), or None
        identify, train or validate.
    extras : dict
        Unknown columns of an imported file: name -> n texts, in the file's order.
    """

    configuration: NDArray[np.int64]
    time_s: _Floats
    q: _Floats
    approach: NDArray[np.int8]
    p_M: _Floats
    sequence: _Floats | None = None
    payload_kg: _Floats | None = None
    temperature_c: _Floats | None = None
    joint_temperature_c: _Floats | None = None
    step: _Floats | None = None
    dwell_s: _Floats | None = None
    covariance_M: _Floats | None = None
    sigma_m: _Floats | None = None
    payload_center_F: _Floats | None = None
    quaternion_M: _Floats | None = None
    sigma_rad: _Floats | None = None
    turning_covariance_M: _Floats | None = None
    tau_nm: _Floats | None = None
    current_a: _Floats | None = None
    smr: tuple[str | None, ...] | None = None
    station: tuple[str | None, ...] | None = None
    point: tuple[str | None, ...] | None = None
    other_q: _Floats | None = None
    split: tuple[str | None, ...] | None = None
    extras: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, joints = len(self.configuration), self.q.shape[-1] if self.q.ndim else 0
        for column in COLUMNS:
            value = getattr(self, column.name)
            if value is None:
                continue
            expected = column.array_shape(n, joints)
            shape = (len(value),) if column.dtype is str else value.shape
            if shape != expected:
                raise ValueError(f"expected {column.name} of shape {expected}, got {shape}")
        for name, texts in self.extras.items():
            if len(texts) != n:
                raise ValueError(f"expected {n} texts in the extra column '{name}', got {len(texts)}")

    def __len__(self) -> int:
        return len(self.configuration)

    def __repr__(self) -> str:
        return f"Readings({len(self)} of {self.joints} joints)"

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])

    def take(self, indices: Sequence[int] | NDArray[np.integer] | NDArray[np.bool_]) -> Readings:
        """Return the rows at ``indices`` (integers, or a mask of n booleans), in that order."""
        chosen = np.arange(len(self))[np.asarray(indices, dtype=None if len(indices) else np.intp)]
        arrays = {
            entry.name: getattr(self, entry.name)[chosen]
            for entry in fields(self)
            if isinstance(getattr(self, entry.name), np.ndarray)
        }
        words: dict[str, Any] = {
            column.name: tuple(getattr(self, column.name)[index] for index in chosen)
            for column in COLUMNS
            if column.dtype is str and getattr(self, column.name) is not None
        }
        return replace(
            self,
            **arrays,
            **words,
            extras={name: tuple(texts[index] for index in chosen) for name, texts in self.extras.items()},
        )

    def in_split(self, name: str) -> NDArray[np.intp]:
        """Return the indices of the rows of one split; empty if no splits are assigned."""
        split = self.split or ()
        return np.array([index for index, word in enumerate(split) if word == name], dtype=np.intp)


def readings_from_columns(values: Mapping[str, Values | None], extras: dict[str, tuple[str, ...]]) -> Readings:
    """Build readings from the values of every column of ``COLUMNS`` by name."""
    attributes: dict[str, Any] = dict(values)
    return Readings(**attributes, extras=extras)


def joined(parts: Sequence[Readings]) -> Readings:
    """Concatenate readings of one arm, without unknown columns of imported files.

    Raises
    ------
    ValueError
        If they have different numbers of joints.
    """
    values: dict[str, Any] = {}
    for column in COLUMNS:
        own = [getattr(part, column.name) for part in parts]
        if column.dtype is not str:
            values[column.name] = _stacked(own, [column.array_shape(len(part), part.joints) for part in parts])
        elif any(words is not None for words in own):
            values[column.name] = tuple(
                word
                for part, words in zip(parts, own, strict=True)
                for word in ((None,) * len(part) if words is None else words)
            )
    beside = [part.other_q for part in parts]
    others = max((0 if q is None else q.shape[1] for q in beside), default=0)
    return Readings(**values, other_q=_stacked(beside, [(len(part), others) for part in parts]))


def _stacked(arrays: Sequence[NDArray[Any] | None], shapes: Sequence[tuple[int, ...]]) -> NDArray[Any] | None:
    """Concatenate arrays, with NaN in place of missing ones; None if all are missing."""
    if all(array is None for array in arrays):
        return None
    return np.concatenate(
        [np.full(shape, np.nan) if array is None else array for array, shape in zip(arrays, shapes, strict=True)]
    )


def stated_uncertainty(readings: Readings) -> _Floats | None:
    """Return the uncertainty that the readings state for their points, if all of them do.

    Return covariances (n, 3, 3) [m^2] if every reading has one, else standard uncertainties (n,) [m], else None.
    """
    for stated in (readings.covariance_M, readings.sigma_m):
        if stated is not None and not np.isnan(stated).any():
            return stated
    return None


def coordinate_uncertainty(readings: Readings) -> _Floats | None:
    """Return the standard uncertainty (n,) [m] of a coordinate by ``stated_uncertainty``; rms of a covariance's three.

    None where that is None.
    """
    stated = stated_uncertainty(readings)
    if stated is None or stated.ndim == 1:
        return stated
    return np.asarray(np.sqrt(np.trace(stated, axis1=1, axis2=2) / 3.0))
