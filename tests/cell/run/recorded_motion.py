"""Recordings of a swinging arm as CSV files, for tests that read them; the numbers are no arm's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[np.float64]]


def joint_columns(seconds: float = 10.0, rate_hz: float = 125.0, joints: int = 2, began_s: float = 100.0) -> Columns:
    """Positions and speeds of joints that swing, with the stamps of a controller."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    columns = {"time_s": began_s + time_s}
    columns |= {f"q{j}": 0.5 * np.sin(0.7 * j * time_s + j) for j in range(1, joints + 1)}
    return columns | {f"qd{j}": 0.35 * j * np.cos(0.7 * j * time_s + j) for j in range(1, joints + 1)}


def point_columns(seconds: float = 10.0, rate_hz: float = 250.0, began_s: float = 3.0) -> Columns:
    """Points on a curve, with the stamps of a tracker."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    noise = np.random.default_rng(1).normal(0.0, 1e-5, (3, len(time_s)))
    curve = np.stack([2.0 + 0.3 * np.sin(time_s), 0.4 * np.cos(0.7 * time_s), 0.1 * time_s / seconds])
    return {"time_s": began_s + time_s, **dict(zip(("x_m", "y_m", "z_m"), curve + noise, strict=True))}


def write_columns(path: Path, columns: Mapping[str, Sequence[float | str] | NDArray[np.float64]]) -> Path:
    """Write a file whose numbers read back bit for bit; NaN is an empty cell."""
    cells = [[_cell(value) for value in list(its)] for its in columns.values()]
    rows = [",".join(row) for row in zip(*cells, strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n", "utf-8")
    return path


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else "" if np.isnan(value) else repr(float(value))
