"""What was measured of an arm as one list of vectors with covariances: positions, and orientations beside them.

A 6-D probe measures a position and an orientation at a stop. The estimation takes them as two readings of three numbers
each, which share the joint positions and all conditions of the stop: the position [m], and the rotation vector from the
measured to the computed orientation [rad], of which zero was measured. A model predicts either, with derivatives; what
is true of readings (whitening, robust weights, folds, residuals, effects) is true of both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.readings import Readings, stated_uncertainty
from cellapp.ground.errors import InputError
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, flange_poses
from cellapp.robot.kinematics.transforms import (
    Array,
    mean_rotation,
    quaternions_of,
    rotation_vectors,
    rotations_of,
    turned_rows,
)

NOT_STATED = 1e-8
"""Standard uncertainty [m, rad] of what states none, where the other kind does: all of its scatter is estimated."""
_ODD_RAD = 0.2
"""Median angle between orientations and the arm from which they are taken as those of another frame."""
_SUSPECT_RAD = 0.02
"""Median angle from which another frame is looked for: a published arm is off by some mrad."""
_BETTER = 0.2
"""Share of the median angle below which another frame is the one that was meant."""
_FEWEST = 4
"""Orientations from which their frame is judged."""


@dataclass(frozen=True, eq=False)
class Quantities:
    """Measured vectors of one arm: positions of all n readings, then the orientations that were measured.

    Attributes
    ----------
    reading : array, shape (m,)
        The reading of each vector.
    readings : Readings
        m rows; ``p_M`` is zero where an orientation was measured.
    conditions : MeasurementConditions
        Of m rows, with the measured orientations.
    stated : array, shape (m,) or (m, 3, 3), or None
        Uncertainty as stated, [m, m^2] or [rad, rad^2].
    """

    reading: NDArray[np.intp]
    readings: Readings
    conditions: MeasurementConditions
    stated: Array | None

    @property
    def R_M_S(self) -> Array | None:
        """Measured orientations (m, 3, 3), NaN at positions; None where none was measured."""
        return self.conditions.R_M_S

    @property
    def turned(self) -> NDArray[np.bool_] | None:
        """Which vectors (m,) are orientations; None where none is."""
        return self.conditions.turned

    def readings_with(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which of the n readings have one of the ``chosen`` (m,) vectors, or both."""
        n = len(self.reading) if self.turned is None else int(np.count_nonzero(~self.turned))
        return np.isin(np.arange(n), self.reading[chosen])


def measured_orientations(readings: Readings) -> tuple[NDArray[np.intp], Array]:
    """Rows (k,) at which orientation was measured, and the rotations (k, 3, 3) of the probe in the tracker frame."""
    if readings.quaternion_M is None:
        return np.zeros(0, dtype=np.intp), np.zeros((0, 3, 3))
    rows = np.flatnonzero(np.isfinite(readings.quaternion_M).all(axis=1)).astype(np.intp)
    return rows, rotations_of(readings.quaternion_M[rows])


def measured_quantities(readings: Readings, conditions: MeasurementConditions | None = None) -> Quantities:
    """All that was measured at some readings; with positions alone, the readings as they are."""
    conditions = MeasurementConditions() if conditions is None else conditions
    n, stated = len(readings), stated_uncertainty(readings)
    rows, rotations = measured_orientations(readings)
    every = np.arange(n, dtype=np.intp)
    if not len(rows):
        return Quantities(every, readings, conditions, stated)
    both = np.concatenate([every, rows])
    R_M_S: Array = np.full((len(both), 3, 3), np.nan)
    R_M_S[n:] = rotations
    p_M = readings.p_M[both].copy()
    p_M[n:] = 0.0
    whole = replace(readings.take(both), p_M=p_M)
    return Quantities(both, whole, replace(conditions.take(both), R_M_S=R_M_S), _stated(readings, stated, rows))


def _stated(readings: Readings, of_points: Array | None, rows: NDArray[np.intp]) -> Array:
    """Uncertainty of positions and orientations; ``NOT_STATED`` where none is."""
    of_turns = np.full(len(rows), NOT_STATED)
    if readings.sigma_rad is not None and np.isfinite(readings.sigma_rad[rows]).all():
        of_turns = readings.sigma_rad[rows]
    if readings.turning_covariance_M is not None:
        of_turns = readings.turning_covariance_M[rows]
    if of_points is None:
        of_points = np.full(len(readings), NOT_STATED)
    if of_points.ndim == of_turns.ndim:
        return np.concatenate([of_points, of_turns])
    return np.concatenate(
        [one if one.ndim == 3 else one[:, None, None] ** 2 * np.eye(3) for one in (of_points, of_turns)]
    )


def states_nothing(stated: Array) -> bool:
    """Whether an uncertainty, (n,) or (n, 3, 3), is that of a kind of quantity that states none."""
    return float(stated.max()) <= (NOT_STATED if stated.ndim == 1 else NOT_STATED**2)


def with_probe(geometry: Geometry, q: Array, R_M_S: Array | None) -> Geometry:
    """The arm with a probe as the orientations (m, 3, 3) at ``q`` (m, N) [rad] have it on the mean; NaN rows none.

    Without orientations, the arm without a probe.
    """
    if R_M_S is None:
        return replace(geometry, probe=None)
    turned = turned_rows(R_M_S)
    R_M_F, _ = flange_poses(geometry, q[turned])
    rotation = mean_rotation(R_M_F.swapaxes(1, 2) @ R_M_S[turned])
    return replace(geometry, probe=rotation_vectors(rotation[None])[0])


def refuse_odd_orientations(name: str, geometry: Geometry, readings: Readings) -> None:
    """Raise ``InputError`` where the orientations do not follow arm ``name`` with ``geometry``: in which frame they do.

    Nobody can tell how a probe is mounted, but its orientation relative to the flange is the same at all stops.
    """
    rows, rotations = measured_orientations(readings)
    q = readings.q[rows]
    if len(rows) < _FEWEST or (own := _scatter(geometry, q, rotations)) < _SUSPECT_RAD:
        return
    found = {words: _scatter(geometry, q, changed(rotations)) for words, changed in _FRAMES.items()}
    why = min(found, key=lambda words: found[words])
    if found[why] >= _BETTER * own:
        if own < _ODD_RAD:
            return
        why = "they fit in no usual convention: look for quaternions of other rows, another arm or another frame"
    raise InputError(
        f"arm '{name}': the orientations quat_w, ..., quat_z of most readings, the first of them configuration"
        f" {readings.configuration[rows[0]]}, do not turn with the flange; {why}"
    )


def _scatter(geometry: Geometry, q: Array, rotations: Array) -> float:
    """Median angle [rad] between orientations and the arm with the probe that fits them best."""
    R_F_S = flange_poses(geometry, q)[0].swapaxes(1, 2) @ rotations
    return float(np.median(np.linalg.norm(rotation_vectors(mean_rotation(R_F_S).T @ R_F_S), axis=1)))


def _of_quaternions(order: tuple[int, ...], signs: tuple[float, ...]) -> Callable[[Array], Array]:
    """Rotations whose quaternions (w, x, y, z) have their components taken in another order, and with signs."""
    return lambda rotations: rotations_of(quaternions_of(rotations)[:, order] * np.array(signs))


_FRAMES: dict[str, Callable[[Array], Array]] = {
    "they fit as those of the tracker in the probe's frame: give the inverse, quat_x, quat_y and quat_z with the"
    " opposite sign": lambda rotations: np.swapaxes(rotations, 1, 2),
    "they fit with the scalar last: the first column must be quat_w": _of_quaternions((3, 0, 1, 2), (1.0,) * 4),
    "they fit in a mirrored frame (x against y and z): the probe's or the tracker's frame is left-handed": (
        _of_quaternions((0, 1, 2, 3), (1.0, 1.0, -1.0, -1.0))
    ),
    "they fit in a mirrored frame (y against x and z): the probe's or the tracker's frame is left-handed": (
        _of_quaternions((0, 1, 2, 3), (1.0, -1.0, 1.0, -1.0))
    ),
    "they fit in a mirrored frame (z against x and y): the probe's or the tracker's frame is left-handed": (
        _of_quaternions((0, 1, 2, 3), (1.0, -1.0, -1.0, 1.0))
    ),
}
