"""Displacement of the SMR by each joint or frame of an effect: it orders the parameters and pictures for the reader."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.records import PlaceMovement
from cellapp.robot.kinematics.transforms import Array


def term_movements(fit: JointFit, number: int) -> tuple[PlaceMovement, ...]:
    """Return the rms displacement of the SMR at the readings by each joint or frame that a term acts on, largest first.

    Parameters are those of the term's law. Its free part also moves the SMR, but has no named parameters.
    """
    columns, named = fit.term_columns(number), len(fit.terms[number].names)
    signals = fit.term_values(number)[:, None] * fit.term_rows(number)
    found = []
    for where in dict.fromkeys(column.where for column in columns):
        here = [k for k, column in enumerate(columns) if column.where == where]
        names = tuple(columns[k].name for k in here if k < named)
        found.append(
            PlaceMovement(where=where, parameters=names, moves_mm=1e3 * rms_length(fit, signals[here].sum(axis=0)))
        )
    return tuple(sorted(found, key=lambda place: -place.moves_mm))


def rms_length(fit: JointFit, whitened: Array) -> float:
    """Return the rms length [m] of whitened displacements (3 n,) over those readings of a fit that are positions."""
    here = fit.positions
    moved = np.linalg.solve(fit.white.transpose(2, 0, 1)[here], whitened.reshape(3, -1).T[here, :, None])[..., 0]
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
