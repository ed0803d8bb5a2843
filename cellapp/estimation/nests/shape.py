"""Rigid figure of the nests on a flange, from their positions at many stops alone.

Distances between nests do not depend on the arm's configuration: their medians give the figure up to a reflection
(multidimensional scaling; Torgerson, Psychometrika 17 (1952) 401). Then it is registered to every stop and averaged,
alternately (generalised Procrustes analysis; Gower, Psychometrika 40 (1975) 33), without stops that it does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.nests.stop_groups import StopGroups
from cellapp.ground.errors import NotConverged
from cellapp.robot.kinematics.transforms import Array

_ROUNDS = 200
"""Most rounds of registration and averaging; few are enough, as the start from medians is within the noise already."""
_SETTLED_M = 1e-8
"""Motion of a nest in the last round [m]."""
_FLAT = 1e-3
"""Ratio of the second to the first singular value of the figure below which the nests are on one line."""
_OUTLYING = 8.0
"""Multiple of the median misfit above which the figure does not fit a stop."""
_LEAST_M = 1e-6
"""Lower bound of the median misfit [m]."""


class UnseenPair(ValueError):
    """Error for two nests that were never measured at the same stop; ``pair`` has their names."""

    def __init__(self, pair: tuple[str, str]) -> None:
        super().__init__(f"nests {pair[0]} and {pair[1]} were never measured at the same stop")
        self.pair = pair


@dataclass(frozen=True, eq=False)
class NestShape:
    """Nests on one flange as a rigid figure.

    Attributes
    ----------
    names : tuple of K str
    points_S : array, shape (K, 3)
        Nests in the frame S, whose origin is the first nest [m].
    noise_m : float
        Standard deviation of a measured coordinate about the figure [m]; NaN without degrees of freedom.
    """

    names: tuple[str, ...]
    points_S: Array
    noise_m: float

    @property
    def spans(self) -> bool:
        """Whether the nests are not on one line, so that they fix an orientation."""
        singular = np.linalg.svd(self.points_S - self.points_S.mean(axis=0), compute_uv=False)
        return len(self.names) > 2 and bool(singular[1] > _FLAT * singular[0])

    def turned_like(self, offsets_F: Array) -> NestShape:
        """Rotate the figure to the flange's axes by offsets (K, 3) [m], NaN if unknown; no change with fewer than 3."""
        known = np.isfinite(offsets_F).all(axis=1)
        if known.sum() < 3:
            return self
        turn, _ = laid_on(self.points_S[known], offsets_F[known][None])
        return NestShape(self.names, self.points_S @ turn[0].T, self.noise_m)


def fit_shape(groups: StopGroups) -> tuple[NestShape, Array]:
    """Fit the figure of the nests; also return its misfit at each stop (S,) [m], NaN with fewer than three nests.

    Raise ``UnseenPair`` if two nests were never measured at the same stop, ``NotConverged`` if it does not settle.
    """
    points = _from_distances(groups)
    enough = groups.seen.sum(axis=1) >= 3
    p_M = groups.p_M[enough]
    if len(points) > 3 and _mirrored_fits_better(points, p_M):
        points = points * np.array([1.0, 1.0, -1.0])
    for _ in range(_ROUNDS if len(p_M) else 0):
        rotation, origin = laid_on(points, p_M)
        in_S = np.einsum("sba,skb->ska", rotation, p_M - origin[:, None])
        fits = ~outlying(_rms(in_S - points))
        before, points = points, np.nanmean(in_S[fits], axis=0)
        if np.abs(points - before).max() < _SETTLED_M:
            break
    else:
        if len(p_M):
            raise NotConverged.of("fit of the nests on a flange", f"{_ROUNDS} rounds were not enough")
    misfit = np.full(len(enough), np.nan)
    noise_m = float("nan")
    if len(p_M):
        left = in_S - points
        misfit[enough] = _rms(left)
        free = 3 * np.count_nonzero(np.isfinite(left[fits, :, 0])) - 6 * int(fits.sum()) - 3 * len(points) + 6
        noise_m = float(np.sqrt(np.nansum(left[fits] ** 2) / free)) if free > 0 else float("nan")
    return NestShape(groups.names, points - points[0], noise_m), misfit


def laid_on(points_S: Array, p_M: Array) -> tuple[Array, Array]:
    """Register a figure (K, 3) to measured points (S, K, 3), NaN where not measured; return rotations (S, 3, 3) and
    origins (S, 3).

    Source: Kabsch, Acta Cryst. A32 (1976) 922, for all stops at once; without reflections.
    """
    seen = np.isfinite(p_M[:, :, :1])
    count = np.maximum(seen.sum(axis=1), 1)
    p = np.where(seen, p_M, 0.0)
    mean_M, mean_S = p.sum(axis=1) / count, (seen * points_S).sum(axis=1) / count
    cross = np.einsum("ska,skb->sab", p - seen * mean_M[:, None], seen * (points_S - mean_S[:, None]))
    u, _, vt = np.linalg.svd(cross)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    return rotation, mean_M - np.einsum("sab,sb->sa", rotation, mean_S)


def better_names(shape: NestShape, p_M: Array) -> tuple[str, ...] | None:
    """Find an order of the names that explains one stop's points (K, 3) far better; None if there is none."""
    seen = np.flatnonzero(np.isfinite(p_M[:, 0]))
    own = _misfit(shape.points_S[seen], p_M[seen])
    best = min(
        (list(order) for order in permutations(seen.tolist()) if list(order) != seen.tolist()),
        key=lambda order: _misfit(shape.points_S[order], p_M[seen]),
    )
    if _misfit(shape.points_S[best], p_M[seen]) > 0.2 * own:
        return None
    return tuple(shape.names[place] for place in best)


def outlying(misfit: Array) -> NDArray[np.bool_]:
    """Return a mask (S,) of the stops that the figure does not fit; False for NaN."""
    usual = max(float(np.nanmedian(misfit)) if np.isfinite(misfit).any() else 0.0, _LEAST_M)
    return np.asarray(misfit > _OUTLYING * usual)


def _misfit(points_S: Array, p_M: Array) -> float:
    rotation, origin = laid_on(points_S, p_M[None])
    return float(_rms((p_M - origin[0] - points_S @ rotation[0].T)[None])[0])


def _rms(vectors: Array) -> Array:
    """Compute the rms length (S,) of those vectors (S, K, 3) that are not NaN."""
    return np.asarray(np.sqrt(np.nanmean(np.sum(vectors**2, axis=2), axis=1)))


def _from_distances(groups: StopGroups) -> Array:
    """Compute points (K, 3) with the median distances, in an arbitrary frame."""
    apart = np.linalg.norm(groups.p_M[:, :, None] - groups.p_M[:, None], axis=3)
    together = np.isfinite(apart).any(axis=0)
    if not together.all():
        a, b = np.argwhere(~together)[0].tolist()
        raise UnseenPair((groups.names[a], groups.names[b]))
    distances = np.nanmedian(apart, axis=0)
    count = len(distances)
    centring = np.eye(count) - 1.0 / count
    values, vectors = np.linalg.eigh(-0.5 * centring @ distances**2 @ centring)
    points = np.zeros((count, 3))
    kept = min(count, 3)
    points[:, :kept] = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :kept]
    return points


def _mirrored_fits_better(points: Array, p_M: Array) -> bool:
    own, mirrored = (
        float(np.median(_rms(p_M - origin[:, None] - np.einsum("sab,kb->ska", rotation, figure))))
        for figure in (points, points * np.array([1.0, 1.0, -1.0]))
        for rotation, origin in (laid_on(figure, p_M),)
    )
    return mirrored < own
