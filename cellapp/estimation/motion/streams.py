"""Recordings of motion: samples of the joints and points of the tracker, each with the timestamps of its own device.

Timestamps are kept as the device gave them: irregular, repeated, with gaps and with steps of the clock.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointStream:
    """n samples of one arm with N joints, in the order in which the controller gave them.

    Attributes
    ----------
    time_s : array, shape (n,)
        Timestamps of the controller's clock [s].
    q : array, shape (n, N)
        Joint positions [rad].
    qd : array, shape (n, N), or None
        Joint speeds [rad/s].
    tau, current : array, shape (n, N), or None
        Joint torques [Nm]; motor currents [A].
    joint_temperature : array, shape (n, N), or None
        Joint temperatures [degC].
    other_q : array, shape (n, K), or None
        Joint positions of the other arm of the cell, if it moved meanwhile [rad].
    triggers_s : array, shape (k,)
        Timestamps of samples in which a pulse to the tracker began [s].

    Raises
    ------
    ValueError
        If a shape is wrong, a stamp or a joint position is not finite, or there are fewer than two samples.
    """

    time_s: _Floats = field(repr=False)
    q: _Floats = field(repr=False)
    qd: _Floats | None = field(default=None, repr=False)
    joint_temperature: _Floats | None = field(default=None, repr=False)
    other_q: _Floats | None = field(default=None, repr=False)
    triggers_s: _Floats = field(default_factory=lambda: np.empty(0), repr=False)

    def __post_init__(self) -> None:
        n = _stamps("joint samples", self.time_s)
        if self.q.ndim != 2 or self.q.shape[0] != n or self.q.shape[1] == 0:
            raise ValueError(f"expected q of shape ({n}, joints), got {self.q.shape}")
        for name in ("q", "qd", "joint_temperature"):
            _check(name, getattr(self, name), self.q.shape)
        if self.other_q is not None:
            _check("other_q", self.other_q, (n, self.other_q.shape[-1]))
        if not np.isfinite(self.q).all():
            raise ValueError("joint positions must be finite numbers")

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"JointStream({len(self)} samples of {self.joints} joints)"

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return int(self.q.shape[1])


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PointStream:
    """m points of the tracker, in the order in which they were measured.

    Attributes
    ----------
    time_s : array, shape (m,)
        Timestamps of the tracker's clock [s].
    p_M : array, shape (m, 3)
        SMR centre in the tracker frame [m].
    sigma_m : array, shape (m,), or None
        Isotropic standard uncertainty of each point [m].
    quaternion : array, shape (m, 4), or None
        Orientation of the probe's frame S in M, scalar first.
    held_out : array of bool, shape (m,), or None
        Mask of points that no fit may use (`split` validate); None if the file does not state it.
    triggers_s : array, shape (k,)
        Timestamps of pulses at the tracker's trigger input [s].

    Raises
    ------
    ValueError
        If a shape is wrong, a stamp or a coordinate is not finite, or there are fewer than two points.
    """

    time_s: _Floats = field(repr=False)
    p_M: _Floats = field(repr=False)
    sigma_m: _Floats | None = field(default=None, repr=False)
    quaternion: _Floats | None = field(default=None, repr=False)
    held_out: NDArray[np.bool_] | None = field(default=None, repr=False)
    triggers_s: _Floats = field(default_factory=lambda: np.empty(0), repr=False)

    def __post_init__(self) -> None:
        m = _stamps("points", self.time_s)
        for name, shape in (("p_M", (m, 3)), ("sigma_m", (m,)), ("quaternion", (m, 4)), ("held_out", (m,))):
            _check(name, getattr(self, name), shape)
        if not np.isfinite(self.p_M).all():
            raise ValueError("points must be finite numbers; leave out the stamps without a point")

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"PointStream({len(self)} points)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Data of one arm's controller and of the tracker during one motion."""

    name: str
    arm: str
    joints: JointStream
    points: PointStream


def _stamps(what: str, time_s: _Floats) -> int:
    if time_s.ndim != 1 or len(time_s) < 2:
        raise ValueError(f"expected time_s of at least two {what}, got shape {time_s.shape}")
    if not np.isfinite(time_s).all():
        raise ValueError(f"time_s of {what} must be finite numbers")
    return len(time_s)


def _check(name: str, value: NDArray[np.generic] | None, shape: tuple[int, ...]) -> None:
    if value is not None and value.shape != shape:
        raise ValueError(f"expected {name} of shape {shape}, got {value.shape}")
