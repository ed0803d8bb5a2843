"""What the solvers reached, as lines of a table."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

OURS, OURS_PLAIN = "cellapp", "cellapp-dh"
"""cellapp with its defaults, and without Hayati's angles."""
_MISSED = 5.0
"""A fit has missed where its mean error is this many times that of the best solver on the same readings."""
COLUMNS = (*("solver", "time", "cellapp's times", "mean error, lowest .. highest [µm]", "largest [µm]"), "failures")


@dataclass(frozen=True)
class Fit:
    """One identification: its time, and the distances from the true test positions.

    ``floor_s`` is the time of one ``lstsq`` of the same size in the same process, where it was measured.
    """

    seed: int
    version: str
    parameters: int
    seconds: float
    mean_um: float
    largest_um: float
    said: str
    floor_s: float | None = None


@dataclass(frozen=True)
class Row:
    """One solver on all seeds of a case: its fits, and the reasons of those without an answer."""

    solver: str
    fits: tuple[Fit, ...]
    failed: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Median time of a fit."""
        return statistics.median(fit.seconds for fit in self.fits)

    @property
    def mean_um(self) -> float:
        """Mean error, averaged over the seeds."""
        return statistics.fmean(fit.mean_um for fit in self.fits)


def lines_of(rows: Sequence[Row], configurations: int) -> list[list[str]]:
    """A line for each solver of a case, and one for ``lstsq`` of the same size."""
    ours = next((row for row in rows if row.solver == OURS and row.fits), None)
    seeds = {fit.seed for row in rows for fit in row.fits}
    best = {seed: min(fit.mean_um for row in rows for fit in row.fits if fit.seed == seed) for seed in seeds}
    found = []
    for row in rows:
        found.append(_line(row, None if ours is None else ours.seconds, best))
        floors = [] if row is not ours else [fit.floor_s for fit in row.fits if fit.floor_s is not None]
        if floors:
            size, floor = f"{3 * configurations} x {row.fits[0].parameters}", statistics.median(floors)
            found.append([f"numpy lstsq, {size}", _time(floor), _times(floor / row.seconds), "", "", ""])
    return found


def _line(row: Row, ours_s: float | None, best: dict[int, float]) -> list[str]:
    reasons = [f"{len(row.failed)} failed: {row.failed[0]}"] if row.failed else []
    if not row.fits:
        return [row.solver, "", "", "", "", f"failed: {row.failed[0]}"]
    missed = [fit for fit in row.fits if fit.mean_um > _MISSED * best.get(fit.seed, fit.mean_um)]
    if missed:
        reasons.append(f"{len(missed)} of {len(row.fits)} missed")
    means = [fit.mean_um for fit in row.fits]
    return [
        f"{row.solver} {row.fits[0].version}",
        _time(row.seconds),
        "" if ours_s is None else _times(row.seconds / ours_s),
        f"{row.mean_um:.2f}, {min(means):.2f} .. {max(means):.2f}",
        f"{max(fit.largest_um for fit in row.fits):.1f}",
        "; ".join(reasons).replace("\n", " ") or "none",
    ]


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def _times(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.2g}"
