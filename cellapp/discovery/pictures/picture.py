"""One picture of a term: measured and computed values against what the term depends on, thinned and sorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array

_MOST_POINTS = 600
"""Points of one picture: as many as a figure of that width in pixels can show."""
_DIGITS = 5
"""Significant digits of its numbers: far finer than a figure, and a third of the size in JSON."""


@dataclass(frozen=True)
class PeriodicCurve:
    """A periodic curve over a turn or a cycle of it: joint angle [deg], offset and its standard deviation [urad]."""

    x: tuple[float, ...]
    value: tuple[float, ...]
    band: tuple[float, ...]


@dataclass(frozen=True)
class Picture:
    """Measured and computed values of one term in one place that it acts on, sorted by x.

    Attributes
    ----------
    title, effect, x_label, y_label : str
        ``effect`` is the slug.
    x : tuple of float
        What the term depends on; of what is periodic in the joint angle folded into one turn, or one cycle of it.
    measured, computed : tuple of float
        Partial residual (the readings less everything else in the model) and the term itself, in the unit of
        ``y_label``.
    band : tuple of float
        Standard deviation of ``computed``, with the uncertainty of the geometry.
    curve : PeriodicCurve, optional
        Of what is periodic in the joint angle.
    """

    title: str
    effect: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    measured: tuple[float, ...]
    computed: tuple[float, ...]
    band: tuple[float, ...] = ()
    curve: PeriodicCurve | None = None


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
    title: str, effect: str, x_label: str, y_label: str, data: PictureData, curve: PeriodicCurve | None = None
) -> Picture:
    """Sort by x, thin out, and convert to micrometres or microradians."""
    places = np.flatnonzero(data.shown & np.isfinite(data.x))
    places = places[np.argsort(data.x[places], kind="stable")]
    if len(places) > _MOST_POINTS:
        places = places[np.linspace(0, len(places) - 1, _MOST_POINTS).astype(np.intp)]
    x, rest, computed, band = data.x[places], data.rest[places], data.computed[places], data.band[places]
    return Picture(
        title,
        effect,
        x_label,
        y_label,
        rounded(x),
        rounded((rest + computed) * 1e6),
        rounded(computed * 1e6),
        rounded(band * 1e6),
        curve,
    )


def rounded(values: Array) -> tuple[float, ...]:
    """Values with the digits that a picture needs."""
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
