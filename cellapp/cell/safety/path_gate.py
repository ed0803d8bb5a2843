"""The gate for paths that one arm follows, or several simultaneously, while the others rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cellapp.cell.safety.gate import CellBodies, Gate, refuse_motion
from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.transforms import Array

_CHORD_RAD = 0.05
"""Largest joint motion between two samples that the gate checks as one straight motion in joint space."""


def refuse_path(
    cell: CellBodies, name: str, q: Array, others: Mapping[str, Array], s: Array, gate: Gate = refuse_motion
) -> str:
    """Return why arm ``name`` must not follow ``q`` (m, N) [rad] while the ``others`` rest; empty if it may.

    As ``refuse_paths``; ``s`` (m,) are arc lengths [m], for the message.
    """
    row, refusal = refuse_paths(cell, {name: q}, others, gate)
    return f"at {s[row] * 1e3:.0f} mm: {refusal}" if refusal else ""


def refuse_paths(
    cell: CellBodies,
    paths: Mapping[str, Array],
    others: Mapping[str, Array],
    gate: Gate = refuse_motion,
    apart_m: float = 0.0,
) -> tuple[int, str]:
    """Return the first row at which arms must not follow ``paths``, arm -> (m, N) [rad], all at the same row at the
    same time while the ``others`` rest, and why; an empty reason if they may.

    The gate checks straight motions in joint space between samples of the paths, each arm at any relative speed; the
    deviation of the paths from these motions is added to the clearance. ``apart_m`` is added to the distance between
    arms: so far they may deviate from all being at one row [m].
    """
    if not all(np.isfinite(q).all() for q in paths.values()):
        return 0, "a joint position of the path is not a finite number"
    steps = [np.abs(np.diff(q, axis=0)).max(axis=1) for q in paths.values()]
    travelled = np.concatenate([[0.0], np.cumsum(np.max(steps, axis=0))])
    rows = np.searchsorted(travelled, np.arange(0.0, travelled[-1] + _CHORD_RAD, _CHORD_RAD))
    rows = np.unique(np.append(rows[rows < len(travelled)], len(travelled) - 1))
    beside = sum(float(_beside_chords(q, rows, travelled) @ cell.arms[name].levers) for name, q in paths.items())
    wider = replace(cell, clearance=cell.clearance + beside, apart=cell.apart + apart_m)
    for first, last in pairwise(rows.tolist()):
        ends = ({**others, **{name: q[row] for name, q in paths.items()}} for row in (first, last))
        refusal = gate(wider, *ends)
        if refusal:
            return first, refusal
    return 0, ""


def _beside_chords(q: Array, rows: np.ndarray, travelled: Array) -> Array:
    """Compute each joint's largest deviation (N,) [rad] from straight motions between ``rows`` of ``q`` (m, N)."""
    chords = rows_at(travelled, travelled[rows], q[rows])
    return np.asarray(np.abs(q - chords).max(axis=0))
