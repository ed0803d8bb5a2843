"""Statistics of the check: evidence that may be looked at after every stop, and the test after the last one.

After each stop: the ratio of the likelihood of "something changed" to that of "nothing changed" is, while nothing has
changed, a martingale of mean 1; it ever exceeds 1 / a with a probability of at most a (Ville's inequality). "Something"
is a mixture of all alternatives, each with sizes drawn from a normal distribution. In the same way the ratio of
"nothing" to "this direction changed by one step" ever exceeds 1 / b with a probability of at most b if it did change so
(Wald, Ann. Math. Stat. 16 (1945) 117).

After the last planned stop: the least p-value of all alternatives and of chi-squared, which no change at all has to
explain. Its distribution while nothing has changed follows from simulation with the covariance of the belief: the tests
are strongly correlated, and the correction is far milder than Bonferroni's.
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
"""Share of the false alarms, and of the missed changes, that may happen before the last stop. The bounds of the tests
after every stop are loose; what is left for the last test costs its power little."""
_SIZE = 2.0
"""Standard deviation of a changed size in steps: changes that just have to be detected decide about the power."""
_DRAWS = 8000
"""Simulated checks without a change: the 1 % quantile is known to a tenth of itself."""
_TAIL = 0.02
"""Share of the simulated checks with the least p-values, where their distribution is continued."""


@dataclass(frozen=True, eq=False)
class Looks:
    """What the stops say after each of them, n stops: see ``SequentialState``."""

    log_evidence: Array
    log_valid: Array
    p_values: Array


def looks(moments: Moments, alternatives: Sequence[Alternative], visible: NDArray[np.bool_]) -> Looks:
    """Evidence after each stop; ``visible`` (C,) says which directions a valid calibration must not have changed."""
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
    """Rows (k, d) of equal mixtures of two numbers of one effect, which change together: a phase is no number alone."""
    pairs = [
        pair
        for one in alternatives
        if one.kind == "effect"
        for pair in combinations([k for k in one.members if visible[k]], 2)
    ]
    first, second = (rows[[pair[place] for pair in pairs]] for place in (0, 1))
    return np.asarray(np.concatenate([first + second, first - second]) / math.sqrt(2.0))


def _single_gains(information: Array, moment: Array) -> Array:
    """``_gains`` of single directions from their information and moments, both (n, A)."""
    inside = 1.0 + _SIZE**2 * information
    return np.asarray(0.5 * (_SIZE * moment) ** 2 / inside - 0.5 * np.log(inside))


def _gains(moments: Moments, one: Alternative) -> Array:
    """Log Bayes factor (n,) of an alternative whose sizes are normal with ``_SIZE``, after each stop."""
    rows = moments.directions[list(one.members)] * _SIZE
    products = np.einsum("id,jd->ijd", rows, rows)
    G = np.cumsum(products, axis=2)[:, :, moments.stop_ends - 1].transpose(2, 0, 1) + np.eye(len(rows))
    m = np.cumsum(rows * moments.white, axis=1)[:, moments.stop_ends - 1].T
    solved = np.linalg.solve(G, m[:, :, None])[:, :, 0]
    return np.asarray(0.5 * np.sum(m * solved, axis=1) - 0.5 * np.linalg.slogdet(G)[1])


@dataclass(frozen=True, eq=False)
class MinPValueTest:
    """The test after some stops: least p-value of all alternatives.

    ``bases`` are orthonormal rows (r, d) that span each alternative in whitened coordinates, in the order of the
    alternatives; ``fitted`` those of what was fitted already.
    """

    bases: tuple[Array, ...]
    fitted: Array
    seed: tuple[int, ...] = (0,)

    @classmethod
    def of(cls, moments: Moments, alternatives: Sequence[Alternative], seed: Sequence[int] = (0,)) -> MinPValueTest:
        """For the design of ``moments``."""
        bases = tuple(spanned(moments.directions[list(one.members)]) for one in alternatives)
        return cls(bases, moments.fitted, tuple(seed))

    def p_values(self, white: Array) -> Array:
        """Of each alternative, then of chi-squared, (A + 1, s) for whitened readings (d, s)."""
        found = [_p(np.sum((basis @ white) ** 2, axis=0), len(basis)) for basis in self.bases]
        return np.array([*found, _p(np.sum(white**2, axis=0), self._degrees)])

    @property
    def _degrees(self) -> int:
        """Of chi-squared."""
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
        """Chance that the least p-value is as small as ``p`` while nothing has changed.

        The share of the simulated checks; in the tail, which they do not reach, that of independent tests.
        """
        if p > self._null[int(_TAIL * _DRAWS)]:
            return float(np.searchsorted(self._null, p, side="right") / _DRAWS)
        return float(-math.expm1(self._tests * math.log1p(-p)))

    def significant(self, p: float, false_alarm: float) -> bool:
        """Whether ``corrected(p)`` is at most ``false_alarm``."""
        if p > false_alarm or p * (len(self.bases) + 1) <= false_alarm:  # one test, and Bonferroni's bound
            return p <= false_alarm
        return self.corrected(p) <= false_alarm

    def critical(self, false_alarm: float) -> float:
        """The least p-value below which something changed, for a chance of false alarms in the tail."""
        return float(-math.expm1(math.log1p(-false_alarm) / self._tests))

    @cached_property
    def _tests(self) -> float:
        """Number of independent tests with the same distribution of the least p-value where its tail begins."""
        return math.log1p(-_TAIL) / math.log1p(-float(self._null[int(_TAIL * _DRAWS)]))


def _p(squares: Array, degrees: int | NDArray[np.intp]) -> Array:
    """Probability of a larger chi-squared; 1 without degrees of freedom."""
    return np.where(np.asarray(degrees) > 0, scipy.special.chdtrc(np.maximum(degrees, 1), squares), 1.0)


def after(moments: Moments, nuisance: Sequence[int]) -> Moments:
    """The moments with some directions taken as unknown: they are projected out of readings and directions."""
    basis = spanned(moments.directions[list(nuisance)])
    white = moments.white - (moments.white @ basis.T) @ basis
    directions = moments.directions - (moments.directions @ basis.T) @ basis
    return Moments(white, directions, moments.stop_ends, spanned(np.concatenate([moments.fitted, basis])))


def solved(moments: Moments, members: Sequence[int]) -> tuple[Array, Array]:
    """Sizes in steps (r,) of directions that explain the stops, and their covariance (r, r)."""
    rows = moments.directions[list(members)]
    G = rows @ rows.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    factor = scipy.linalg.cho_factor(G * scale * scale[:, None] + 1e-10 * np.eye(len(G)), lower=True)
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(G))) * scale * scale[:, None]
    return np.asarray(covariance @ (rows @ moments.white)), np.asarray(covariance)
