"""The gate for a path that one arm follows while the others rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cellapp.cell.safety.gate import CellBodies, Gate, refuse_motion
from cellapp.robot.kinematics.transforms import Array

_CHORD_RAD = 0.05
"""Largest joint motion between two samples that the gate checks as one straight motion in joint space."""


def refuse_path(
    cell: CellBodies, name: str, q: Array, others: Mapping[str, Array], s: Array, gate: Gate = refuse_motion
) -> str:
    """Why arm ``name`` must not follow ``q`` (m, N) [rad] while the ``others`` rest; empty if it may.

    The gate checks straight motions in joint space between samples of the path; what the path is beside them is added
    to the clearance. ``s`` (m,) are arc lengths [m], for the words.
    """
    if not np.isfinite(q).all():
        return "a joint position of the path is not a finite number"
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))])
    rows = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + _CHORD_RAD, _CHORD_RAD))
    rows = np.unique(np.append(rows[rows < len(q)], len(q) - 1))
    beside = _beside_chords(q, rows, travelled)
    wider = replace(cell, clearance=cell.clearance + float(beside @ cell.arms[name].levers))
    for first, last in pairwise(rows):
        refusal = gate(wider, {**others, name: q[first]}, {**others, name: q[last]})
        if refusal:
            return f"at {s[first] * 1e3:.0f} mm: {refusal}"
    return ""


def _beside_chords(q: Array, rows: np.ndarray, travelled: Array) -> Array:
    """Largest distance of each joint (N,) [rad] from the straight motions between ``rows`` of ``q`` (m, N)."""
    chords = np.column_stack([np.interp(travelled, travelled[rows], column) for column in q[rows].T])
    return np.asarray(np.abs(q - chords).max(axis=0))
