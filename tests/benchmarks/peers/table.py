"""What the solvers reached, as a Markdown table."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

OURS, OURS_PLAIN = "cellapp", "cellapp-dh"
"""cellapp with its defaults, and without Hayati's angles."""
_MISSED = 5.0
"""A fit has missed where its mean error is this many times that of the best solver on the same readings."""
_HEAD = (
    "| solver | parameters | time | cellapp's times | mean error, lowest .. highest [µm] | largest [µm] | failures |\n"
    "| --- | --- | --- | --- | --- | --- | --- |"
)


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


def case_text(case: str, configurations: int, rows: Sequence[Row]) -> str:
    """Heading, table and ratios of a case."""
    ours = next(row for row in rows if row.solver == OURS)
    best = {fit.seed: min(f.mean_um for row in rows for f in row.fits if f.seed == fit.seed) for fit in ours.fits}
    parts = [f"### Case {case}, {configurations} configurations\n", _HEAD]
    for row in rows:
        parts.append(_line(row, ours.seconds if ours.fits else None, best))
        floors = [] if row is not ours else [fit.floor_s for fit in row.fits if fit.floor_s is not None]
        if floors:
            size = f"{3 * configurations} x {row.fits[0].parameters}"
            floor = statistics.median(floors)
            parts.append(f"| numpy lstsq, {size} | | {_time(floor)} | {_times(floor / row.seconds)} | | | |")
    if ours.fits:
        parts.append("\n" + _ratios(ours, [row for row in rows if row.solver not in (OURS, OURS_PLAIN) and row.fits]))
    return "\n".join(parts) + "\n"


def _line(row: Row, ours_s: float | None, best: dict[int, float]) -> str:
    reasons = [f"{len(row.failed)} failed: {row.failed[0]}"] if row.failed else []
    if not row.fits:
        return f"| {row.solver} | | | | | | failed: {row.failed[0]} |"
    missed = [fit for fit in row.fits if fit.mean_um > _MISSED * best.get(fit.seed, fit.mean_um)]
    if missed:
        worst = max(missed, key=lambda fit: fit.mean_um)
        reasons.append(f"{len(missed)} of {len(row.fits)} missed; the worst says: {worst.said}")
    means = [fit.mean_um for fit in row.fits]
    cells = [
        f"{row.solver} {row.fits[0].version}",
        str(row.fits[0].parameters),
        _time(row.seconds),
        "" if ours_s is None else _times(row.seconds / ours_s),
        f"{row.mean_um:.2f}, {min(means):.2f} .. {max(means):.2f}",
        f"{max(fit.largest_um for fit in row.fits):.1f}",
        "; ".join(reasons) or "none",
    ]
    return "| " + " | ".join(cells).replace("\n", " ") + " |"


def _ratios(ours: Row, peers: Sequence[Row]) -> str:
    floors = [fit.seconds / fit.floor_s for fit in ours.fits if fit.floor_s is not None]
    parts = [f"cellapp / lstsq {statistics.median(floors):.2f}"]
    if peers:
        fastest, best = min(peers, key=lambda row: row.seconds), min(peers, key=lambda row: row.mean_um)
        parts.append(f"fastest peer ({fastest.solver}) / cellapp {fastest.seconds / ours.seconds:.0f}")
        parts.append(f"mean error of cellapp / best peer ({best.solver}) {ours.mean_um / best.mean_um:.3f}")
    return "; ".join(parts) + "."


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def _times(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.2g}"
