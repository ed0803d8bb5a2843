"""Drift over a run: mean residuals of successive blocks of stops, with bands."""

from __future__ import annotations

import math

import numpy as np

from cellapp.commands.view.charts import Axis, Chart, Limit, mm, series
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array

_BLOCK, _MOST_BLOCKS, _FEWEST = 20, 24, 3
"""Least stops of a block: enough for its scatter; most blocks; least blocks for a drift to show."""
_TWO_SIDED = 2.09
"""Half width of the 95 % band of a mean of 20 in standard errors: Student's t with 19 degrees of freedom."""
_EXPECTED = 0.05
"""Share of 95 % bands that exclude zero by chance."""
_RARE = 0.01
"""More bands than chance that exclude zero are a drift if their probability is below this."""
_HOUR = 3600.0


def residual_drift_chart(name: str, time_s: Array, residuals_M: Array) -> Chart:
    """Show the mean residuals (n, 3) [m] along x, y, z of blocks of stops over the time (n,) [s] of a run.

    Without times they are shown over the order of the readings.
    """
    title, y = f"Arm {name}: residuals over the run", Axis("mean residual", "mm")
    known = np.isfinite(residuals_M).all(axis=1)  # NaN if an effect needs a value not recorded at the stop
    time_s, residuals_M = time_s[known], residuals_M[known]
    timed = bool(np.isfinite(time_s).all()) and float(np.ptp(time_s)) > 0.0
    x = Axis("time since the run began", "h") if timed else Axis("reading")
    at = time_s / _HOUR if timed else np.arange(1.0, len(time_s) + 1.0)
    count = min(len(at) // _BLOCK, _MOST_BLOCKS)
    if count < _FEWEST:
        return Chart(title, x, y, (), f"Arm {name} has too few readings ({len(at)}) to tell a drift from noise.")
    blocks = np.array_split(np.argsort(at, kind="stable"), count)
    middle = np.array([at[rows].mean() for rows in blocks])
    mean = np.array([residuals_M[rows].mean(axis=0) for rows in blocks]) * 1e3
    sizes = np.array([len(rows) for rows in blocks])
    scatter = np.array([residuals_M[rows].std(axis=0, ddof=1) for rows in blocks]) * 1e3
    band = _TWO_SIDED * scatter / np.sqrt(sizes)[:, None]
    hints = [counted(size, "stop") for size in sizes.tolist()]
    drawn = tuple(
        series(f"along {axis}", middle, mean[:, k], band=band[:, k], style=k, hints=hints)
        for k, axis in enumerate("xyz")
    )
    return Chart(title, x, y, drawn, _message(name, mean, band), (Limit("no residual", 0.0),))


def _message(name: str, mean: Array, band: Array) -> str:
    """Say whether more bands exclude zero than by chance."""
    outside, total = int(np.count_nonzero(np.abs(mean) > band)), mean.size
    drifts = _chance_of_at_least(outside, total) < _RARE
    verdict = "drift" if drifts else "do not drift"
    return (
        f"Residuals of arm {name} {verdict}: means of {len(mean)} successive blocks of stops stay within"
        f" {mm(float(np.abs(mean).max()))}, and {outside} of {counted(total, 'band')} (95 %) leave zero out, where"
        f" chance alone makes about {_EXPECTED * total:.0f}."
    )


def _chance_of_at_least(outside: int, total: int) -> float:
    """Return the probability that chance alone excludes that many zeros (binomial distribution)."""
    p = _EXPECTED
    return 1.0 - sum(math.comb(total, k) * p**k * (1.0 - p) ** (total - k) for k in range(outside))
