"""Charts as data: what is drawn, in which units, with what message. No medium, no I/O.

Modules ``charts_*`` build charts from typed results; ``cellapp.interfaces.tui.plots`` draws them in a terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellapp.ground.results import STAGES

Array = NDArray[np.float64]  # not imported from kinematics: that loads scipy, and screens must open fast
Kind = Literal["line", "points"]
Key = TypeVar("Key", bound=str)
"""Name of a stage or a method."""

STAGE_STYLES: Mapping[str, int] = {stage: number for number, stage in enumerate(STAGES)}
"""Style of each stage, the same in all charts."""
SMALLEST_MM = 1e-6
"""Value of a logarithmic axis for an error of zero [mm]."""
LEAST = 1e-100
"""Values below this, in any unit, are drawn as zero: differences of denormal numbers are not exact."""


@dataclass(frozen=True)
class Axis:
    """Label of an axis and its unit (empty: a plain number)."""

    label: str
    unit: str = ""
    logarithmic: bool = False

    @property
    def words(self) -> str:
        """Label and unit, as ``held-out rms [mm]``."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


@dataclass(frozen=True, eq=False)
class Series:
    """Values y (n,) over x (n,), in the units of the axes; NaN is a gap.

    Attributes
    ----------
    kind : str
        ``line`` joins the points.
    band : array, shape (n,), or None
        Half width of a band about y.
    style : int
        Number of its colour and mark. An arm or stage has the same number in all charts.
    mark : str
        A character drawn at every point instead of the mark of the style.
    """

    name: str
    x: Array
    y: Array
    kind: Kind = "line"
    band: Array | None = None
    style: int = 0
    mark: str = ""

    def __post_init__(self) -> None:
        for what, values in (("y", self.y), ("band", self.band)):
            if values is not None and values.shape != self.x.shape:
                raise ValueError(f"series {self.name}: {what} of shape {values.shape} for x of shape {self.x.shape}")

    @property
    def edges(self) -> list[Array]:
        """Lower and upper edge of the band, (n,) each; y if there is no band."""
        return [self.y] if self.band is None else [self.y - self.band, self.y + self.band]


@dataclass(frozen=True)
class Limit:
    """A level line across the chart, as a noise floor or a tolerance."""

    name: str
    value: float


@dataclass(frozen=True, eq=False)
class Chart:
    """One chart.

    Attributes
    ----------
    message : str
        The chart in one or two sentences, for those who cannot see it; of an empty chart, why it is empty.
    equal : bool
        Whether one unit has the same length along both axes, as in a map.
    by_stage : bool
        Whether the styles are those of stages (``STAGE_STYLES``), not of arms: the page has other colours for them.
    y_range : tuple of float, or None
        The drawn part of the y axis, if a few far points would flatten all others; None for all values.
    """

    title: str
    x: Axis
    y: Axis
    series: tuple[Series, ...]
    message: str
    limits: tuple[Limit, ...] = ()
    equal: bool = False
    y_range: tuple[float, float] | None = None
    by_stage: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is no finite value to draw."""
        return not any(np.any(np.isfinite(one.x) & np.isfinite(one.y)) for one in self.series)


def series(
    name: str,
    x: ArrayLike,
    y: ArrayLike,
    kind: Kind = "line",
    *,
    band: ArrayLike | None = None,
    style: int = 0,
    mark: str = "",
) -> Series:
    """Build a series from anything that numpy accepts as an array."""
    as_array = np.asarray(x, dtype=np.float64)
    width = None if band is None else np.asarray(band, dtype=np.float64)
    return Series(name, as_array, np.asarray(y, dtype=np.float64), kind, width, style, mark)


def noise_limit(floor_mm: float | None, name: str = "noise floor") -> tuple[Limit, ...]:
    """Return the limit at a noise floor [mm]; none if it is unknown."""
    return () if floor_mm is None else (Limit(name, floor_mm),)


def drawable_mm(errors_mm: ArrayLike) -> Array:
    """Return errors [mm] of at least ``SMALLEST_MM``, for a logarithmic axis."""
    return np.maximum(np.asarray(errors_mm, dtype=np.float64), SMALLEST_MM)


def enumerated(parts: Iterable[str]) -> str:
    """Join words: ``a``, ``a and b``, ``a, b and c``."""
    words = list(parts)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def evenly_spread(n: int, most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of n row indices, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))
