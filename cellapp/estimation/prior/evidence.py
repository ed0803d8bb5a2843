"""Validity of a belief about an arm for new readings, judged by their marginal likelihood.

With X the derivatives of the readings by all parameters, y the residuals of the belief's mean, S the belief's
covariance, D the variances of changes since, and R the readings' own covariance:

    y ~ N(F b, K),    K = X (S + D) X^T + R,    b free (base and tool).

The likelihood is that of the components of y in the complement of F (Patterson, Thompson, Biometrika 58 (1971) 545).
Changes are of two kinds: a drift of all parameters of a part, with one size each, and jumps of a few parameters with
separate causes. The drifts and the scatter of the readings maximise the likelihood; a jump is accepted if it gains more
than chance explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.records import SignaturePart
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import Array

_NO_DRIFT = 1e-7
"""Least drift: of geometry [m, rad]; of effects and curves relative to their size, below all real effects."""
_MOST_DRIFT: Mapping[SignaturePart, float] = {"geometry": 5e-3, "effects": 0.1, "curves": 3.0}
"""Largest drift in the same units. At it, nothing of geometry and curves is believed. A stiffness or a play that
changes by more than a tenth has a separate cause: a jump, which names it; a drift of so few values would hide it."""
_FIRST_DRIFT: Mapping[SignaturePart, float] = {"geometry": 1e-5, "effects": 0.02, "curves": 0.02}
"""Start values of the drifts: metals of an arm grow by some 10 um with a degree."""
_SCATTER_M = (1e-7, 1e-2)
"""Least and largest scatter of a coordinate beyond the stated one [m, rad]."""
_FIRST_SCATTER = (2e-5, 1e-4)
"""Start values of the scatter, of a coordinate [m] and of a component of an orientation [rad]."""
_EVALUATIONS = 1000
"""Most evaluations of the likelihood for two to four hyperparameters; it settles after some 80, rarely after 200."""
_DEPENDENT = 1e-9
"""Share of the largest pivot below which a column of base and tool counts as dependent on the others."""
_TOLERANCE = 0.01
"""Change of the log likelihood, and of the log of a drift, at which the search ends."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Parameters that may have jumped together, with a standard deviation each; ``what`` is the name of the group."""

    what: str
    places: NDArray[np.intp]
    sd: Array


@dataclass(frozen=True, eq=False)
class Drifts:
    """Drift of all parameters of each part, scatter of the readings [m], and the log likelihood there.

    ``scatter_rad`` is that of a component of an orientation [rad], None if none was measured.
    """

    of_parts: Mapping[SignaturePart, float]
    scatter_m: float
    log_likelihood: float
    scatter_rad: float | None = None

    @property
    def scatters(self) -> tuple[float, ...]:
        """Scatter of positions, and of orientations if they were measured."""
        return (self.scatter_m,) if self.scatter_rad is None else (self.scatter_m, self.scatter_rad)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated change (r,) of a candidate's parameters, its covariance, and the gain of the log likelihood."""

    values: Array
    covariance: Array
    gain: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """Linear model of new readings in the complement of base and tool.

    Attributes
    ----------
    left : array, shape (d,)
        Residuals of the readings for the mean of the belief.
    rows : array, shape (p, d)
        Derivatives by the arm's own parameters.
    believed : array, shape (d, d)
        ``X S X^T``.
    stated : array, shape (d, d)
        Stated covariance of the readings [m^2], zero if none is stated.
    drift : mapping
        Part -> ``X U X^T`` (d, d), with U the squared drift units of the parameters.
    of_turns : array, shape (d, d), or None
        Covariance of a scatter of 1 rad in each component of the orientations alone.
    """

    left: Array
    rows: Array
    believed: Array
    stated: Array
    drift: Mapping[SignaturePart, Array]
    of_turns: Array | None = None

    def jumped(self, candidate: Candidate) -> Evidence:
        """Return the model that allows for a jump of some parameters."""
        rows = self.rows[candidate.places] * candidate.sd[:, None]
        return replace(self, believed=self.believed + rows.T @ rows)

    def covariance(self, drifts: Mapping[SignaturePart, float], scatters: Sequence[float]) -> Array:
        """Return K (d, d) [m^2, m rad, rad^2]; ``scatters`` as in ``Drifts``."""
        K = self.believed + self.stated
        for part, size in drifts.items():
            K = K + size**2 * self.drift[part]
        K.flat[:: len(K) + 1] += scatters[0] ** 2
        if self.of_turns is not None:
            K += (scatters[1] ** 2 - scatters[0] ** 2) * self.of_turns
        return K

    def log_likelihood(self, drifts: Mapping[SignaturePart, float], scatters: Sequence[float]) -> float:
        """Return the log marginal likelihood, without the constants."""
        factor, lower = scipy.linalg.cho_factor(self.covariance(drifts, scatters), lower=True, check_finite=False)
        solved = scipy.linalg.cho_solve((factor, lower), self.left, check_finite=False)
        return float(-0.5 * self.left @ solved - np.sum(np.log(np.diag(factor))))

    def drifts(self, start: Drifts | None = None) -> Drifts:
        """Return the drifts and the scatter that maximise the likelihood, searched from ``start``; never a worse point.

        Raise ``NotConverged`` if the search does not end.
        """
        parts, kinds = list(self.drift), 1 if self.of_turns is None else 2
        bounds = [
            *((math.log(_NO_DRIFT), math.log(_MOST_DRIFT[part])) for part in parts),
            *((math.log(_SCATTER_M[0]), math.log(_SCATTER_M[1])),) * kinds,
        ]

        def loss(x: Array) -> float:
            inside = np.clip(x, [low for low, _ in bounds], [high for _, high in bounds])
            sizes = np.exp(inside).tolist()
            return -self.log_likelihood(dict(zip(parts, sizes[:-kinds], strict=True)), sizes[-kinds:])

        first = [_FIRST_DRIFT[part] for part in parts] if start is None else [start.of_parts[part] for part in parts]
        x0 = np.log(np.array([*first, *(_FIRST_SCATTER[:kinds] if start is None else start.scatters)]))
        simplex = np.vstack([x0, x0 + 1.5 * np.eye(len(x0))])
        options = {"maxfev": _EVALUATIONS, "xatol": _TOLERANCE, "fatol": _TOLERANCE, "initial_simplex": simplex}
        found = scipy.optimize.minimize(loss, x0, method="Nelder-Mead", bounds=bounds, options=options)
        if not found.success:
            raise NotConverged.of("search of the drifts since an earlier calibration", found.message)
        sizes = np.exp(found.x).tolist()
        of_parts = dict(zip(parts, sizes[:-kinds], strict=True))
        return Drifts(of_parts, sizes[-kinds], -float(found.fun), sizes[-1] if kinds == 2 else None)

    def estimates(self, drifts: Drifts, candidates: list[Candidate]) -> list[Estimate]:
        """Return the estimated jump of each candidate, and its gain of the log likelihood."""
        K = self.covariance(drifts.of_parts, drifts.scatters)
        factor = scipy.linalg.cho_factor(K, lower=True, check_finite=False)
        solved = scipy.linalg.cho_solve(factor, self.rows.T, check_finite=False)
        moment = solved.T @ self.left
        found = []
        for one in candidates:
            S = self.rows[one.places] @ solved[:, one.places]
            scaled = S * one.sd * one.sd[:, None]
            b = moment[one.places] * one.sd
            inner = np.eye(len(b)) + scaled
            values = np.linalg.solve(inner, b)
            gain = 0.5 * float(b @ values) - 0.5 * float(np.linalg.slogdet(inner)[1])
            covariance = np.linalg.inv(inner) * one.sd * one.sd[:, None]
            found.append(Estimate(values * one.sd, covariance, gain))
        return found


def evidence(
    free: Array,
    own: Array,
    left: Array,
    covariance: Array,
    stated: Array,
    units: Mapping[SignaturePart, Array],
    turned: NDArray[np.bool_] | None = None,
) -> Evidence:
    """Build the linear model in the complement of the free parameters.

    Parameters
    ----------
    free : array, shape (f, 3 n)
        Derivatives with respect to base and tool.
    own : array, shape (p, 3 n)
        Derivatives with respect to the arm's own parameters.
    left : array, shape (3 n,)
        Residuals of the readings for the mean of the belief [m], at any base and tool.
    covariance : array, shape (p, p)
        Covariance of the belief.
    stated : array, shape (3 n, 3 n)
        Stated covariance of the readings [m^2].
    units : mapping
        Part -> unit of drift (p,) of each parameter, zero outside the part.
    turned : array, shape (3 n,), optional
        Mask of the components of orientations.
    """
    scale = 1.0 / np.maximum(np.linalg.norm(free, axis=1), 1e-300)
    Q, R, _ = scipy.linalg.qr((free * scale[:, None]).T, pivoting=True)
    pivots = np.abs(np.diag(R))
    Z = Q[:, int(np.sum(pivots > _DEPENDENT * pivots[0])) :]
    rows = own @ Z
    return Evidence(
        left=Z.T @ left,
        rows=rows,
        believed=rows.T @ covariance @ rows,
        stated=Z.T @ stated @ Z,
        drift={part: (rows * unit[:, None] ** 2).T @ rows for part, unit in units.items()},
        of_turns=None if turned is None else Z[turned].T @ Z[turned],
    )
