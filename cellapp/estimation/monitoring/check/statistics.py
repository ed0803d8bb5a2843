"""Statistics of the check: evidence that may be evaluated after every stop, and the test after the last one.

After each stop: if nothing has changed, the likelihood ratio of "something changed" to "nothing changed" is a
martingale of mean 1; it ever exceeds 1 / a with a probability of at most a (Ville's inequality). "Something" is a
mixture of all alternatives, each with normally distributed sizes. Likewise, if a direction did change by one step, the
ratio of "nothing" to "this direction changed by one step" ever exceeds 1 / b with a probability of at most b
(Wald, Ann. Math. Stat. 16 (1945) 117).

After the last planned stop: the least p-value of all alternatives and of chi-squared, which needs no alternative. Its
distribution without a change is simulated with the covariance of the belief: the tests are strongly correlated, so the
correction is far milder than Bonferroni's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check.alternatives import Alternative
from cellapp.estimation.monitoring.check.linear import Moments, spanned
from cellapp.robot.kinematics.transforms import Array

SPENT_EARLY = 0.2
"""Share of the false alarms, and of the misses, that is spent before the last stop. The bounds after every stop are
loose; the share that they take costs the last test little power."""
_SIZE = 2.0
"""Prior standard deviation of a change in steps: changes that just have to be detected determine the power."""
_DRAWS = 8000
"""Number of simulated checks without a change: the 1 % quantile is known to a tenth of itself."""
_TAIL = 0.02
"""Share of the simulated checks with the smallest p-values, below which the distribution is extrapolated."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Evidence after each of n stops: see ``SequentialState``."""

    log_evidence: Array
    log_valid: Array
    p_values: Array


def looks(moments: Moments, alternatives: Sequence[Alternative], visible: NDArray[np.bool_]) -> Looks:
    """Compute the evidence after each stop; ``visible`` (C,) masks directions that must be unchanged to be valid."""
    information, moment = moments.information, np.abs(moments.moment)
    single = [one.members[0] for one in alternatives if len(one.members) == 1]
    several = [_gains(moments, one) for one in alternatives if len(one.members) > 1]
    gains = np.column_stack([_single_gains(information[:, single], moment[:, single]), *several])
    valid = np.where(visible, 0.5 * information - moment, np.inf)
    mixed = replace(moments, directions=_mixed(moments.directions, alternatives, visible))
    valid = np.column_stack([valid, 0.5 * mixed.information - np.abs(mixed.moment)])
    return Looks(
        log_evidence=np.asarray(scipy.special.logsumexp(gains, axis=1) - math.log(len(alternatives))),
        log_valid=np.asarray(valid.min(axis=1)) if np.any(visible) else np.zeros(len(information)),
        p_values=_p(moments.chi_squared, moments.degrees),
    )


def _mixed(rows: Array, alternatives: Sequence[Alternative], visible: NDArray[np.bool_]) -> Array:
    """Compute rows (k, d) of equal mixtures of two parameters of one effect: a wave of any phase changes both."""
    pairs = [
        pair
        for one in alternatives
        if one.kind == "effect"
        for pair in combinations([k for k in one.members if visible[k]], 2)
    ]
    first, second = (rows[[pair[place] for pair in pairs]] for place in (0, 1))
    return np.asarray(np.concatenate([first + second, first - second]) / math.sqrt(2.0))


def _single_gains(information: Array, moment: Array) -> Array:
    """Compute ``_gains`` of single directions from their information and moments, both (n, A)."""
    inside = 1.0 + _SIZE**2 * information
    return np.asarray(0.5 * (_SIZE * moment) ** 2 / inside - 0.5 * np.log(inside))


def _gains(moments: Moments, one: Alternative) -> Array:
    """Compute the log Bayes factor (n,) of an alternative with normal sizes (``_SIZE``) after each stop."""
    rows = moments.directions[list(one.members)] * _SIZE
    products = np.einsum("id,jd->ijd", rows, rows)
    G = np.cumsum(products, axis=2)[:, :, moments.stop_ends - 1].transpose(2, 0, 1) + np.eye(len(rows))
    m = np.cumsum(rows * moments.white, axis=1)[:, moments.stop_ends - 1].T
    solved = np.linalg.solve(G, m[:, :, None])[:, :, 0]
    return np.asarray(0.5 * np.sum(m * solved, axis=1) - 0.5 * np.linalg.slogdet(G)[1])


@dataclass(frozen=True, eq=False)
class MinPValueTest:
    """Test after some stops by the least p-value of all alternatives.

    ``bases`` are orthonormal rows (r, d) that span each alternative in whitened coordinates, in the order of the
    alternatives; ``fitted`` are those of directions that were fitted.
    """

    bases: tuple[Array, ...]
    fitted: Array
    seed: tuple[int, ...] = (0,)

    @classmethod
    def of(cls, moments: Moments, alternatives: Sequence[Alternative], seed: Sequence[int] = (0,)) -> MinPValueTest:
        """Build the test for the stops of ``moments``."""
        bases = tuple(spanned(moments.directions[list(one.members)]) for one in alternatives)
        return cls(bases, moments.fitted, tuple(seed))

    def p_values(self, white: Array) -> Array:
        """Compute p-values (A + 1, s) of each alternative, then of chi-squared, for whitened readings (d, s)."""
        found = [_p(np.sum((basis @ white) ** 2, axis=0), len(basis)) for basis in self.bases]
        return np.array([*found, _p(np.sum(white**2, axis=0), self._degrees)])

    @property
    def _degrees(self) -> int:
        """Degrees of freedom of chi-squared."""
        return int(self.fitted.shape[1] - len(self.fitted))

    @cached_property
    def _null(self) -> Array:
        """Least p-values of simulated checks without a change, ascending."""
        generator = np.random.default_rng([*self.seed, 0xC4EC])
        white = generator.standard_normal((self.fitted.shape[1], _DRAWS))
        white -= self.fitted.T @ (self.fitted @ white)
        ranks = {len(basis) for basis in self.bases}
        least = _p(np.sum(white**2, axis=0), self._degrees)
        for rank in ranks:
            some = np.concatenate([basis for basis in self.bases if len(basis) == rank])
            squares = ((some @ white) ** 2).reshape(-1, rank, _DRAWS).sum(axis=1) if rank else np.zeros((1, _DRAWS))
            least = np.minimum(least, _p(squares.max(axis=0), rank))
        return np.sort(least)

    def corrected(self, p: float) -> float:
        """Compute the probability of a least p-value as small as ``p`` if nothing has changed.

        It is the share of simulated checks; in the tail, where these are too few, that of independent tests.
        """
        if p > self._null[int(_TAIL * _DRAWS)]:
            return float(np.searchsorted(self._null, p, side="right") / _DRAWS)
        return float(-math.expm1(self._tests * math.log1p(-p)))

    def significant(self, p: float, false_alarm: float) -> bool:
        """Return whether ``corrected(p)`` is at most ``false_alarm``."""
        if p > false_alarm or p * (len(self.bases) + 1) <= false_alarm:  # one test, and Bonferroni's bound
            return p <= false_alarm
        return self.corrected(p) <= false_alarm

    def critical(self, false_alarm: float) -> float:
        """Return the critical value of the least p-value for a probability of false alarms in the tail."""
        return float(-math.expm1(math.log1p(-false_alarm) / self._tests))

    @cached_property
    def _tests(self) -> float:
        """Number of independent tests whose least p-value has the same distribution at the start of the tail."""
        return math.log1p(-_TAIL) / math.log1p(-float(self._null[int(_TAIL * _DRAWS)]))


def _p(squares: Array, degrees: int | NDArray[np.intp]) -> Array:
    """Compute the probability of a larger chi-squared; 1 without degrees of freedom."""
    return np.where(np.asarray(degrees) > 0, scipy.special.chdtrc(np.maximum(degrees, 1), squares), 1.0)


def after(moments: Moments, nuisance: Sequence[int]) -> Moments:
    """Return the moments with some directions unknown: these are projected out of readings and directions."""
    basis = spanned(moments.directions[list(nuisance)])
    white = moments.white - (moments.white @ basis.T) @ basis
    directions = moments.directions - (moments.directions @ basis.T) @ basis
    return Moments(white, directions, moments.stop_ends, spanned(np.concatenate([moments.fitted, basis])))


def solved(moments: Moments, members: Sequence[int]) -> tuple[Array, Array]:
    """Estimate the sizes in steps (r,) of directions that explain the stops, and their covariance (r, r)."""
    rows = moments.directions[list(members)]
    G = rows @ rows.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    factor = scipy.linalg.cho_factor(G * scale * scale[:, None] + 1e-10 * np.eye(len(G)), lower=True)
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(G))) * scale * scale[:, None]
    return np.asarray(covariance @ (rows @ moments.white)), np.asarray(covariance)
