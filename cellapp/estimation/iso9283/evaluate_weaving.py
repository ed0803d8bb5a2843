"""Compute the weaving deviations WS and WF (11) from points measured along a weaving path."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellapp.estimation.iso9283.characteristics import FEWEST_CYCLES, coverage_of_mean
from cellapp.estimation.iso9283.evaluate_paths import PathTrack
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import WeavingCharacteristics
from cellapp.robot.kinematics.transforms import Array

_FEWEST_TURNS = 3


@dataclass(frozen=True, eq=False)
class WeavingRuns:
    """Line with weaving that was driven several times.

    Attributes
    ----------
    arm, commands : str
    speed : float
        Commanded speed along the zigzag [m/s].
    commanded_M : array, shape (m, 3)
        Closely spaced points of the commanded path in the tracker frame [m].
    along_M, across_M : array, shape (3,)
        Unit vectors of the line and of the weaving.
    turns : array, shape (k,)
        Distance of each turn of the zigzag along the line from the first point of the path [m].
    tracker : array, shape (3, 3)
        Covariance of a point [m^2].
    tracks : list of PathTrack
        One for each cycle.
    wanted : int
        Requested number of cycles.
    slowed : str
        As in ``PathRuns``.
    problems : list of str
        Why fewer cycles were driven.
    """

    arm: str
    commands: IsoCommands
    speed: float
    commanded_M: Array
    along_M: Array
    across_M: Array
    turns: Array
    tracker: Array
    wanted: int
    slowed: str = ""
    tracks: list[PathTrack] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def weaving_characteristics(runs: WeavingRuns) -> WeavingCharacteristics | None:
    """Compute WS and WF over all cycles that passed every turn; None with fewer than two.

    The same formulas serve the commanded and the attained path. A stroke is the distance across the line between
    successive turns. The frequency is one over twice the time between successive turns. A turn is the outermost point
    within a quarter of a wave from its commanded position.
    """
    commanded = _turns(runs, runs.commanded_M)
    if commanded is None:
        return None
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(runs.commanded_M, axis=0), axis=1))])
    stroke, half_s = _stroke(runs, runs.commanded_M[commanded]), np.diff(way[commanded]).mean() / runs.speed
    strokes, halves = [], []
    for track in runs.tracks:
        rows = _turns(runs, track.p_M)
        if rows is not None:
            strokes.append(_stroke(runs, track.p_M[rows]))
            halves.append(float(np.diff(track.time_s[rows]).mean()))
    n = len(strokes)
    if n < FEWEST_CYCLES:
        return None
    # Noise moves the outermost of many points outwards, by two standard deviations at most.
    sigma = float(np.sqrt(runs.across_M @ runs.tracker @ runs.across_M))
    wide, often = np.array(strokes) / stroke - 1.0, half_s / np.array(halves) - 1.0
    factor = coverage_of_mean(n)
    return WeavingCharacteristics(
        stroke_mm=1e3 * stroke,
        frequency_hz=0.5 / half_s,
        speed_mm_s=1e3 * runs.speed,
        waves=(len(runs.turns) - 1) // 2,
        stroke_percent=1e2 * float(wide.mean()),
        stroke_expanded_percent=1e2 * float(np.hypot(factor * wide.std(ddof=1), 4.0 * sigma / stroke)),
        frequency_percent=1e2 * float(often.mean()),
        frequency_expanded_percent=1e2 * factor * float(often.std(ddof=1)),
        n=n,
        slowed=runs.slowed,
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _turns(runs: WeavingRuns, p_M: Array) -> Array | None:
    """Find the rows (k,) of the turns among points (m, 3); None if a turn has no point near it."""
    if len(runs.turns) < _FEWEST_TURNS or not len(p_M):
        return None
    start = runs.commanded_M[0]
    along, across = (p_M - start) @ runs.along_M, (p_M - start) @ runs.across_M
    quarter = 0.5 * float(np.diff(runs.turns).mean())
    found = []
    for number, turn in enumerate(runs.turns.tolist()):
        near = np.flatnonzero(np.abs(along - turn) <= quarter)
        if not len(near):
            return None
        found.append(near[np.argmax(across[near] * (1.0 if number % 2 == 0 else -1.0))])
    return np.array(found)


def _stroke(runs: WeavingRuns, turns_M: Array) -> float:
    """Compute the mean distance [m] across the line between successive turns."""
    return float(np.abs(np.diff(turns_M @ runs.across_M)).mean())
