"""Share of a residual explained by columns in the complement of a model's parameters: R^2 and gain of the BIC.

With M as in ``estimation.design.information``, residual y (d,) and columns B (m, d),

    explained = (B M y)^T (B M B^T)^-1 (B M y),     R^2 = explained / y^T M y,
    BIC gain  = -f ln(1 - R^2) - k ln f,            k parameters (Schwarz, Ann. Stat. 6 (1978) 461),

f = d less the parameters of the model that the data determine. With d in place of f, a scatter estimated from few
readings would count as known better than it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.estimation.design.information import NuisanceProjector, visible_squares
from cellapp.robot.kinematics.transforms import Array

MOST_SHARE = 1.0 - 1e-12
"""Cap on R^2: an exact fit of noise-free data has a finite score."""


def bic_gain(share: float, coordinates: float, parameters: int) -> float:
    """Return the gain of the BIC (Bayesian information criterion) by ``parameters`` that explain a ``share``."""
    return -coordinates * math.log1p(-min(share, MOST_SHARE)) - parameters * math.log(coordinates)


@dataclass(frozen=True, eq=False)
class ProjectedResidual:
    """A whitened residual (d,) in the complement of a model's nuisance parameters."""

    projector: NuisanceProjector
    residual: Array

    def __len__(self) -> int:
        return len(self.residual)

    @cached_property
    def freedom(self) -> float:
        """Number of coordinates less the parameters that they determine, f; at least 1."""
        return self.projector.freedom

    @cached_property
    def projected(self) -> Array:
        """M y, (d,)."""
        return self.projector.project(self.residual)

    @cached_property
    def square(self) -> float:
        """y^T M y."""
        return float(self.residual @ self.projected)

    def explained(self, rows: Array) -> float:
        """Return the part of ``square`` that rows (m, d) explain."""
        gram = rows @ self.projector.project(rows).T
        return float(visible_squares(gram, np.linalg.norm(rows, axis=1), rows @ self.projected)[0])

    def explained_share(self, rows: Array) -> float:
        """Return R^2 of rows (m, d), at most ``MOST_SHARE``."""
        return min(self.explained(rows) / self.square, MOST_SHARE)

    def bic_gain(self, rows: Array) -> float:
        """Return the gain of the BIC by rows (m, d), all of them counted as parameters."""
        return bic_gain(self.explained_share(rows), self.freedom, len(rows))
