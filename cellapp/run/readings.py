"""What was measured: one reading, and one arm's readings as arrays. No I/O here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

SPLITS = ("identify", "train", "validate")

_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """One arm at one stop.

    Attributes
    ----------
    q : array, shape (N,)
        Joint positions read from the controller [rad].
    p_M : array, shape (3,)
        Measured SMR centre in the tracker frame [m].
    time_s : float
        Seconds since the run began; NaN if nobody knows.
    approach : array, shape (N,), or None
        Sign of each joint's last motion before the stop: -1, 0 (unknown), +1; None is unknown for all.
    payload_kg, temperature_c, sigma_m : float or None
        Payload [kg]; arm or ambient temperature [degC]; isotropic standard uncertainty of ``p_M`` [m].
    joint_temperature_c : array, shape (N,), or None
        Joint temperatures [degC].
    step : array, shape (N,), or None
        Each joint's last motion before the stop, with its sign [rad].
    dwell_s : float or None
        From rest to the measurement [s].
    covariance_M : array, shape (3, 3), or None
        Covariance of ``p_M`` [m^2]; of a matrix that is not quite symmetric the upper half is kept.
    split : str or None
        identify, train, validate, or not yet drawn.
    extras : dict
        Columns of a foreign file that this program does not know, as text.
    """

    q: _Floats
    p_M: _Floats
    time_s: float = float("nan")
    approach: NDArray[np.int8] | None = None
    payload_kg: float | None = None
    temperature_c: float | None = None
    joint_temperature_c: _Floats | None = None
    step: _Floats | None = None
    dwell_s: float | None = None
    covariance_M: _Floats | None = None
    sigma_m: float | None = None
    split: str | None = None
    extras: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """The readings of one arm, n of them, N joints.

    An optional quantity is None where no row has it; where only some rows have it, NaN stands in the others.

    Attributes
    ----------
    configuration : array, shape (n,), int64
        Number of the stop; rows of both arms with the same number were measured at the same stop.
    time_s : array, shape (n,)
        Seconds since the run began; NaN if nobody knows.
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
        From rest to the measurement [s].
    covariance_M : array, shape (n, 3, 3), or None
        Covariance of ``p_M`` [m^2].
    sigma_m : array, shape (n,), or None
        Isotropic standard uncertainty of ``p_M`` [m].
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
    payload_kg: _Floats | None = None
    temperature_c: _Floats | None = None
    joint_temperature_c: _Floats | None = None
    step: _Floats | None = None
    dwell_s: _Floats | None = None
    covariance_M: _Floats | None = None
    sigma_m: _Floats | None = None
    split: tuple[str | None, ...] | None = None
    extras: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.configuration)
        for entry in fields(self):
            value = getattr(self, entry.name)
            columns = value.values() if entry.name == "extras" else () if value is None else (value,)
            for column in columns:
                if len(column) != n:
                    raise ValueError(f"{entry.name} has {len(column)} rows, configuration has {n}")
        if self.q.ndim != 2 or self.approach.shape != self.q.shape or self.p_M.shape != (n, 3):
            raise ValueError(
                f"expected q (n, N), approach (n, N) and p_M (n, 3),"
                f" got {self.q.shape}, {self.approach.shape} and {self.p_M.shape}"
            )
        for name, value in (("joint_temperature_c", self.joint_temperature_c), ("step", self.step)):
            if value is not None and value.shape != self.q.shape:
                raise ValueError(f"expected {name} {self.q.shape}, got {value.shape}")
        if self.covariance_M is not None and self.covariance_M.shape != (n, 3, 3):
            raise ValueError(f"expected covariance_M ({n}, 3, 3), got {self.covariance_M.shape}")

    def __len__(self) -> int:
        return len(self.configuration)

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])

    def take(self, indices: Sequence[int] | NDArray[np.integer] | NDArray[np.bool_]) -> Readings:
        """The rows at ``indices`` (positions, or a mask of n booleans), in that order."""
        chosen = np.arange(len(self))[np.asarray(indices, dtype=None if len(indices) else np.intp)]
        arrays = {
            entry.name: getattr(self, entry.name)[chosen]
            for entry in fields(self)
            if isinstance(getattr(self, entry.name), np.ndarray)
        }
        split = self.split
        return replace(
            self,
            **arrays,
            split=None if split is None else tuple(split[index] for index in chosen),
            extras={name: tuple(texts[index] for index in chosen) for name, texts in self.extras.items()},
        )

    def in_split(self, name: str) -> NDArray[np.intp]:
        """Positions of the rows of one split; empty where no splits are stored."""
        split = self.split or ()
        return np.array([index for index, word in enumerate(split) if word == name], dtype=np.intp)
