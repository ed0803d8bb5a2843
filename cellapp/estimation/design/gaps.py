"""Phase coverage: close gaps without stops in a joint's range that exceed a limit, at the least loss of information.

An error with many periods a turn shows only if stops fall on all of its phases. Gaps measure this coverage; the
information matrix does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.block_choice import Candidates
from cellapp.estimation.design.block_design import BlockDesign, Criterion, Rows
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

GAP_OF_EVEN_STOPS = 4.0
"""Default limit of a gap, in units of the gap of evenly spread stops. With random stops the largest gap is about the
natural logarithm of their number: 4.6 for 100, 6 for 400."""
_EMPTY_SHARE = 0.02
"""Share of a joint's range above which a part without any candidate counts as unreachable."""
_EMPTY_SPACINGS = 10.0
"""The same limit for few candidates, in mean distances between them: longer gaps do not occur by chance."""
_IMMOVABLE = 1e-12
"""Replacement of a zero limit, for a joint that does not move [rad]."""
_MOST_LOOKED_AT = 100
"""Most candidates examined for one gap: more of them differ little."""
_FOLLOWED = 200
"""Number of stops whose losses are tracked, those of least loss first."""
_COMPARED = 8
"""Number of the best of these that are compared in double precision."""


def largest_gaps(q: Array) -> Array:
    """Return the largest gap between stops of each joint (N,), for configurations ``q`` (n, N) [rad]."""
    return np.asarray(np.diff(np.sort(q, axis=0), axis=0).max(axis=0, initial=0.0))


def without_turns(q: Array, candidates: Array) -> Array:
    """Subtract from ``q`` (n, N) [rad] the whole turns between it and the middle of the ``candidates`` (m, N).

    A plan may reach a candidate with joints turned once more: the phase of an error with a period of one turn or less
    is the same.
    """
    middle = 0.5 * (candidates.min(axis=0) + candidates.max(axis=0))
    turn = 2.0 * np.pi
    return np.asarray(q - turn * np.round((q - middle) / turn))


def gap_limits(q: Array, count: int, asked: float | None) -> Array:
    """Return the limit of each joint's gaps (N,) [rad]: ``asked``, else from ``count`` stops and ``q`` (m, N)."""
    if asked is not None:
        return np.full(q.shape[1], asked)
    steps = np.diff(np.sort(q, axis=0), axis=0)
    empty = max(_EMPTY_SHARE, _EMPTY_SPACINGS / len(q)) * steps.sum(axis=0)
    reached = np.where(steps <= empty, steps, 0.0).sum(axis=0)
    return np.asarray(GAP_OF_EVEN_STOPS * reached / max(count, 1))


def close_gaps(
    candidates: Candidates,
    q: Array,
    chosen: Rows,
    criterion: Criterion,
    limits: Array,
    kept: Array,
    rng: np.random.Generator,
    cancel: CancelToken,
) -> Rows:
    """Exchange stops until no candidate can close another gap.

    Parameters
    ----------
    candidates : Candidates
    q : array, shape (m, N)
        Their joint positions [rad].
    chosen : array, shape (n,)
    criterion : Criterion
        The candidate with the largest gain among those that close a gap is added; the stop with the least loss among
        those not needed for any gap is removed.
    limits : array, shape (N,)
        [rad]
    kept : array, shape (k, N)
        Further stops of the plan [rad].
    """
    design = BlockDesign(candidates.information(chosen), criterion.weights(candidates.covariance(chosen)))
    design.track(candidates.rows[chosen])
    easy = np.argsort(design.losses(), kind="stable")  # losses change slowly: only the first ones are tracked
    easy, later = easy[:_FOLLOWED], easy[_FOLLOWED:]
    design.track(candidates.rows[chosen[easy]])
    staying, added = np.ones(len(chosen), dtype=bool), list[int]()
    hopeless = set[tuple[int, float]]()
    ends = np.stack([q.min(axis=0), q.max(axis=0)])
    for _ in range(len(chosen)):
        cancel.check()
        stops = np.concatenate([q[chosen[staying]], q[added], kept])
        inside = _closing(q, np.concatenate([stops, ends]), limits, hopeless)
        if inside is None:
            break
        inside = rng.permutation(np.setdiff1d(inside, chosen[staying]))[:_MOST_LOOKED_AT]
        inside = inside[design.largest(candidates.rows[inside], _COMPARED)]
        best = int(inside[np.argmax(design.gains_of(candidates.rows[inside]))])
        free = staying & _dispensable(np.concatenate([stops, q[[best]]]), limits, staying)
        while not free[easy].any() and len(later):
            easy, later = later[:_FOLLOWED], later[_FOLLOWED:]
            design.track(candidates.rows[chosen[easy]])
        if not free[easy].any():
            break
        leaving = int(easy[np.argmin(np.where(free[easy], design.losses(), np.inf))])
        design.add(candidates.rows[best])
        design.remove(candidates.rows[chosen[leaving]])
        staying[leaving] = False
        added.append(best)
    return np.concatenate([chosen[staying], np.array(added, dtype=np.intp)])


def _closing(q: Array, stops: Array, limits: Array, hopeless: set[tuple[int, float]]) -> Rows | None:
    """Return the candidates that close the longest gap of ``stops`` (ends included), or a good part of it; None if none
    can.

    ``hopeless`` gaps (joint, beginning) have no candidate; those found are added.
    """
    ends = np.sort(stops, axis=0)
    ratio = np.diff(ends, axis=0) / np.maximum(limits, _IMMOVABLE)
    rows, joints = np.nonzero(ratio > 1.0)
    longest = np.argsort(-ratio[rows, joints], kind="stable")
    for row, joint in zip(rows[longest].tolist(), joints[longest].tolist(), strict=True):
        low, high, limit = ends[row, joint], ends[row + 1, joint], limits[joint]
        if (joint, float(low)) in hopeless:
            continue
        margin = limit / 2.0 if high - low >= 2.0 * limit else high - low - limit
        inside = np.flatnonzero((q[:, joint] >= low + margin) & (q[:, joint] <= high - margin))
        if len(inside):
            return inside
        hopeless.add((joint, float(low)))
    return None


def _dispensable(stops: Array, limits: Array, staying: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the first stops (those ``staying``) whose removal opens no gap beyond any limit."""
    order = np.argsort(stops, axis=0)
    ordered = np.take_along_axis(stops, order, axis=0)
    without = np.zeros_like(ordered, dtype=bool)
    without[1:-1] = ordered[2:] - ordered[:-2] <= limits[None]
    spare = np.empty_like(without)
    np.put_along_axis(spare, order, without, axis=0)
    found = np.zeros(len(staying), dtype=bool)
    found[staying] = np.logical_and.reduce(spare, axis=1)[: int(staying.sum())]
    return found
