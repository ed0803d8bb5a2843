"""Lines of many cycles beside the free curves of the joints: selection of cycle counts and joints by evidence.

The joints of an arm have gears and encoders of one make: a count that shows at one joint is likely at the others. A
line is therefore one cycle count with the joints that have it. With G and b the information and moments of its columns
in the complement of all fitted parameters, noise 1, and the prior N(0, a^2) of every cosine and sine,

    2 ln E = b^T (G + I / a^2)^-1 b - ln det(I + a^2 G)

(Rasmussen, Williams, Gaussian Processes for Machine Learning, 2006, section 2.1), less 2 ln T for a choice among T.
Noise makes a chosen line look larger than it is; the prior shrinks it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.discovery.candidates import CandidateLaw
from cellapp.estimation.discovery.projected_residual import ProjectedResidual
from cellapp.robot.kinematics.transforms import Array

_AMPLITUDES = (1e-5, 1.5e-5, 2e-5, 3e-5, 4e-5, 6e-5)
"""Standard deviations of the prior [rad] to try: gears and encoders of arms have lines of 10 to 80 µrad."""
_PERIODS = (128, 256)
"""Cycle counts that share half of the prior probability: absolute encoders have a power of two of periods a turn, and
their interpolation error repeats in each period."""
_MOST_LINES = 24
"""Most lines: more would be a spectrum without gaps, which is a rougher curve."""


@dataclass(frozen=True)
class ChosenLines:
    """The chosen lines.

    Attributes
    ----------
    value : float
        Twice the log evidence less the price of choosing.
    amplitude : float
        Standard deviation of the prior [rad].
    tried : int
        Number of alternatives that the choice was made from.
    columns : tuple of int
        Indices of their columns.
    """

    value: float
    amplitude: float
    tried: int
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Bands:
    """Cosines and sines of J joints at c cycle counts; ``places`` (c, J, 2) are their indices in ``rows`` (m, d).

    ``own`` (c, J, 2, 2) is the information of each pair. ``alternatives`` (c,) is T of each count: expected counts
    share half of the probability, all others the other half.
    """

    rows: Array
    residual: ProjectedResidual
    moments: Array
    places: NDArray[np.intp]
    own: Array
    alternatives: NDArray[np.intp]

    @classmethod
    def of(cls, candidate: CandidateLaw, residual: ProjectedResidual, by_joint: Array) -> _Bands:
        counts = sorted({column.cycles or 0 for column in candidate.columns})
        joints = sorted({column.joint or 0 for column in candidate.columns})
        at = {(one.cycles, one.joint): k for k, one in reversed([*enumerate(candidate.columns)])}  # cosine, then sine
        places = np.array([[[at[n, joint], at[n, joint] + 1] for joint in joints] for n in counts], dtype=np.intp)
        rows = candidate.rows
        offsets = np.array([one.offset for one in candidate.columns])
        own = np.empty((*places.shape, 2))
        for place, joint in enumerate(joints):
            waves = offsets[places[:, place]]
            own[:, place] = (waves @ residual.projector.kernel(by_joint[:, joint])) @ waves.swapaxes(1, 2)
        expected = np.isin(counts, _PERIODS)
        alternatives = 2 * np.where(expected, expected.sum(), (~expected).sum())
        return cls(rows, residual, rows @ residual.projected, places, own, alternatives)

    def beside(self, taken: Sequence[int], amplitude: float) -> tuple[Array, Array]:
        """Return information (c, J, 2, 2) and moments (c, J, 2) of each pair beside the columns ``taken``."""
        kept = list(taken)
        cross = self.rows @ self.residual.projector.project(self.rows[kept]).T
        inverse = np.linalg.inv(cross[kept] + np.eye(len(kept)) / amplitude**2)
        moments = self.moments - cross @ (inverse @ self.moments[kept])
        known = cross[self.places]
        return self.own - np.einsum("cjka,ab,cjlb->cjkl", known, inverse, known), moments[self.places]


def shared_lines(candidate: CandidateLaw, residual: ProjectedResidual, by_joint: Array) -> ChosenLines | None:
    """Choose the lines that a residual needs; None if it needs none.

    The candidate's columns are waves of joints; ``by_joint`` (3, N, n) is the whitened SMR motion per radian.
    """
    bands = _Bands.of(candidate, residual, by_joint)
    best = max((_chosen(bands, amplitude) for amplitude in _AMPLITUDES), key=lambda one: one.value)
    return best if best.columns else None


def _chosen(bands: _Bands, amplitude: float) -> ChosenLines:
    """Add lines one by one, the one with the largest gain first, while the gain exceeds its price."""
    joints = bands.places.shape[1]
    which = np.array([joints * math.comb(joints, number) for number in range(1, joints + 1)])
    prices = 2.0 * np.log(bands.alternatives[:, None] * which)
    found = ChosenLines(-2.0 * math.log(len(_AMPLITUDES)), amplitude, len(_AMPLITUDES), ())
    for _ in range(_MOST_LINES):
        gains = _evidence(*bands.beside(found.columns, amplitude), amplitude)
        gains[np.isin(bands.places[:, :, 0], found.columns)] = -math.inf
        order = np.argsort(-gains, axis=1)
        totals = np.cumsum(np.take_along_axis(gains, order, axis=1), axis=1) - prices
        count, number = np.unravel_index(int(np.argmax(totals)), totals.shape)
        if not totals[count, number] > 0.0:
            break
        line = bands.places[count, np.sort(order[count, : number + 1])].ravel()
        tried = found.tried * int(bands.alternatives[count]) * int(which[number])
        value = found.value + float(totals[count, number])
        found = ChosenLines(value, amplitude, tried, (*found.columns, *line.tolist()))
    return found


def _evidence(information: Array, moments: Array, amplitude: float) -> Array:
    """Return twice the log evidence (c, J) of pairs of columns with information (c, J, 2, 2) and moments (c, J, 2)."""
    precision = information + np.eye(2) / amplitude**2
    explained = np.einsum("cjk,cjk->cj", moments, np.linalg.solve(precision, moments[..., None])[..., 0])
    return np.asarray(explained - np.linalg.slogdet(amplitude**2 * precision)[1])
