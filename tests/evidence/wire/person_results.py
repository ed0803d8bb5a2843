"""Results of the program presses: what a person meets at the cell, and the bars it must keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from cellapp.ground.results import Record, Result


class PersonRow(Record):
    """One row: ``median`` and ``worst`` in ``unit``, None where it never came; a ``median_bar`` None is not judged."""

    what: str
    before: str
    unit: Literal["ms", ""]
    n: int
    median: float | None
    worst: float | None
    median_bar: float | None
    worst_bar: float

    @classmethod
    def of(
        cls,
        what: str,
        before: str,
        values: Sequence[float],
        worst_bar: float,
        median_bar: float | None = None,
        unit: Literal["ms", ""] = "ms",
    ) -> PersonRow:
        """Statistics of values, at least one."""
        return cls(
            what=what, before=before, unit=unit, n=len(values), median=_finite(float(np.median(values))),
            worst=_finite(float(max(values))), median_bar=median_bar, worst_bar=worst_bar,
        )  # fmt: skip

    @property
    def kept(self) -> bool:
        """Whether the bars were kept."""
        if self.worst is None or self.median is None:
            return False
        return self.worst <= self.worst_bar and (self.median_bar is None or self.median <= self.median_bar)


class PersonResult(Result, schema="cellapp-trials-person"):
    """the program presses: the rows, beside ``busy`` processes that compute; which parts failed, and how."""

    busy: int
    rows: tuple[PersonRow, ...]
    not_measured: tuple[str, ...] = ()

    def missed(self) -> tuple[str, ...]:
        """What did not keep its bars, and what was not measured."""
        return (*(row.what for row in self.rows if not row.kept), *self.not_measured)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
