"""One picture of a term: measured and computed values against the variable of the term, thinned and sorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.records import CurveRecord, Picture
from cellapp.robot.kinematics.transforms import Array

_MOST_POINTS = 600
"""Most points of one picture: as many as a figure of that width in pixels can show."""
_DIGITS = 5
"""Significant digits of its numbers: far finer than a figure, and a third of the size in JSON."""


@dataclass(frozen=True, eq=False)
class PictureData:
    """Values (n,) for a picture in the order of the readings, in SI units.

    ``rest`` is the residual, ``band`` the standard deviation of ``computed``, ``shown`` a mask of the readings.
    """

    x: Array
    rest: Array
    computed: Array
    band: Array
    shown: NDArray[np.bool_]


def make_picture(
    title: str, effect: str, x_label: str, y_label: str, data: PictureData, curve: CurveRecord | None = None
) -> Picture:
    """Sort by x, thin out, and convert to micrometres or microradians."""
    places = np.flatnonzero(data.shown & np.isfinite(data.x))
    places = places[np.argsort(data.x[places], kind="stable")]
    if len(places) > _MOST_POINTS:
        places = places[np.linspace(0, len(places) - 1, _MOST_POINTS).astype(np.intp)]
    x, rest, computed, band = data.x[places], data.rest[places], data.computed[places], data.band[places]
    return Picture(
        title=title,
        effect=effect,
        x_label=x_label,
        y_label=y_label,
        x=rounded(x),
        measured=rounded((rest + computed) * 1e6),
        computed=rounded(computed * 1e6),
        band=rounded(band * 1e6),
        curve=curve,
    )


def rounded(values: Array) -> tuple[float, ...]:
    """Round values to the digits that a picture needs."""
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
