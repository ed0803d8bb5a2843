"""Name what changed: the alternative that explains the stops best, those confounded with it, and further changes.

A least-squares fit of an alternative lowers chi-squared; its gain is half of that minus (r / 2) log d for r parameters
and d coordinates (Schwarz, Ann. Stat. 6 (1978) 461). The best alternative is accepted and its parameters are unknown
from then on; the next one is searched until the rest is explained. Tracker and bases may have moved by centimetres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import LeastSquares
from cellapp.estimation.calibration.station_location import FEWEST_POINTS, small_motion
from cellapp.estimation.monitoring.belief import FALSE_ALARM, CheckBelief
from cellapp.estimation.monitoring.linear import Alternative, Changing, Moments, StopRows, centre_of, spanned, twists
from cellapp.estimation.prior.update import ALIKE, SURE
from cellapp.robot.kinematics.transforms import Array, apply, invert, register, rotation_vectors

# -- Statistics of the check: one test, after every stop and after the last one ---------------------------------------
#
# Something changed if the least p-value of all alternatives, and of chi-squared, which needs no alternative, is small
# enough. After the last planned stop its distribution without a change is simulated with the covariance of the belief:
# the tests are strongly correlated, so the correction is far milder than Bonferroni's. Before, Bonferroni's bound over
# all alternatives and stops is kept.
#
# Nothing visible changed if the likelihood of nothing is large enough against that of each direction by one step: if a
# direction did change by one step, the ratio is a martingale of mean 1, which ever exceeds 1 / b with a probability of
# at most b (Wald, Ann. Math. Stat. 16 (1945) 117; Ville).

SPENT_EARLY = 0.2
"""Share of the false alarms, and of the misses, that is spent before the last stop. The bounds after every stop are
loose; the share that they take costs the last test little power."""
_SAMPLES = 8000
"""Number of simulated checks without a change: the 1 % quantile is known to a tenth of itself."""
_TAIL = 0.02
"""Share of the simulated checks with the smallest p-values, below which the distribution is extrapolated."""


def log_valid(moments: Moments, alternatives: Sequence[Alternative], visible: NDArray[np.bool_]) -> float:
    """Compute the least log likelihood ratio of no change to one of the directions ``visible`` (C,) by one step.

    Equal mixtures of two parameters of one effect count, too: a wave of any phase changes both.
    """
    mixed = replace(moments, directions=_mixed(moments.directions, alternatives, visible))
    found = [0.5 * one.information - np.abs(one.moment) for one in (moments, mixed)]
    return float(np.concatenate([found[0][visible], found[1]]).min()) if np.any(visible) else 0.0


def _mixed(rows: Array, alternatives: Sequence[Alternative], visible: NDArray[np.bool_]) -> Array:
    """Compute rows (k, d) of equal mixtures of two parameters of one effect."""
    pairs = [
        pair
        for one in alternatives
        if one.kind == "effect"
        for pair in combinations([k for k in one.members if visible[k]], 2)
    ]
    first, second = (rows[[pair[place] for pair in pairs]] for place in (0, 1))
    return np.asarray(np.concatenate([first + second, first - second]) / math.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class MinPValueTest:
    """Test after some stops by the least p-value of all alternatives.

    ``bases`` are orthonormal rows (r, d) that span each alternative in whitened coordinates, in the order of the
    alternatives; ``fitted`` are those of directions that were fitted.
    """

    bases: tuple[Array, ...]
    fitted: Array

    @classmethod
    def of(cls, moments: Moments, alternatives: Sequence[Alternative]) -> MinPValueTest:
        """Build the test for the stops of ``moments``."""
        bases = tuple(spanned(moments.directions[list(one.members)]) for one in alternatives)
        return cls(bases, moments.fitted)

    def least(self, moments: Moments) -> float:
        """Return the least p-value of all alternatives and of chi-squared."""
        return float(self.p_values(moments.white[:, None]).min())

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
        generator = np.random.default_rng(0xC4EC)
        white = generator.standard_normal((self.fitted.shape[1], _SAMPLES))
        white -= self.fitted.T @ (self.fitted @ white)
        ranks = {len(basis) for basis in self.bases}
        least = _p(np.sum(white**2, axis=0), self._degrees)
        for rank in ranks:
            some = np.concatenate([basis for basis in self.bases if len(basis) == rank])
            squares = ((some @ white) ** 2).reshape(-1, rank, _SAMPLES).sum(axis=1) if rank else np.zeros((1, _SAMPLES))
            least = np.minimum(least, _p(squares.max(axis=0), rank))
        return np.sort(least)

    def corrected(self, p: float) -> float:
        """Compute the probability of a least p-value as small as ``p`` if nothing has changed.

        It is the share of simulated checks; in the tail, where these are too few, that of independent tests.
        """
        if p > self._null[int(_TAIL * _SAMPLES)]:
            return float(np.searchsorted(self._null, p, side="right") / _SAMPLES)
        return float(-math.expm1(self._tests * math.log1p(-p)))

    def significant(self, p: float, false_alarm: float) -> bool:
        """Return whether ``corrected(p)`` is at most ``false_alarm``."""
        if p > false_alarm or self.bound(p) <= false_alarm:
            return p <= false_alarm
        return self.corrected(p) <= false_alarm

    def bound(self, p: float) -> float:
        """Return Bonferroni's upper bound of ``corrected(p)``."""
        return p * (len(self.bases) + 1)

    def critical(self, false_alarm: float) -> float:
        """Return the critical value of the least p-value for a probability of false alarms in the tail."""
        return float(-math.expm1(math.log1p(-false_alarm) / self._tests))

    @cached_property
    def _tests(self) -> float:
        """Number of independent tests whose least p-value has the same distribution at the start of the tail."""
        return math.log1p(-_TAIL) / math.log1p(-float(self._null[int(_TAIL * _SAMPLES)]))


def _p(squares: Array, degrees: int | NDArray[np.intp]) -> Array:
    """Compute the probability of a larger chi-squared; 1 without degrees of freedom."""
    return np.where(np.asarray(degrees) > 0, scipy.special.chdtrc(np.maximum(degrees, 1), squares), 1.0)


def after(moments: Moments, nuisance: Sequence[int]) -> Moments:
    """Return the moments with some directions unknown: these are projected out of readings and directions."""
    basis = spanned(moments.directions[list(nuisance)])
    white = moments.white - (moments.white @ basis.T) @ basis
    directions = moments.directions - (moments.directions @ basis.T) @ basis
    return Moments(white, directions, spanned(np.concatenate([moments.fitted, basis])))


def solved(moments: Moments, members: Sequence[int]) -> tuple[Array, Array]:
    """Estimate the sizes in steps (r,) of directions that explain the stops, and their covariance (r, r)."""
    rows = moments.directions[list(members)]
    G = rows @ rows.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    factor = scipy.linalg.cho_factor(G * scale * scale[:, None] + 1e-10 * np.eye(len(G)), lower=True)
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(G))) * scale * scale[:, None]
    return np.asarray(covariance @ (rows @ moments.white)), np.asarray(covariance)


_MOST_CHANGES = 4
"""Most changes that are named: more at once mean a new arm, which twenty stops cannot describe."""
_INSEPARABLE = 0.05
"""Least share of a change's motion that an alternative must leave unexplained for more stops to distinguish them: with
a twentieth, a hundred times as many stops would be needed."""
_TIE = 0.01
"""Difference of gains that counts as rounding: tracker and base of a cell of one arm."""
NOT_EXPLAINED = 1e-3
"""Probability of chi-squared below which named changes do not explain the stops: one false alarm in 1000."""


@dataclass(frozen=True, eq=False)
class Design:
    """What a check tests (C directions), and with which error probabilities.

    Attributes
    ----------
    belief : CheckBelief
    directions, alternatives : tuple
    motions : mapping
        Arm -> motion (C, n, 3) [m] of the SMR at the calibration's readings by one step of each direction, then that of
        its orientation [rad] if the check measures it.
    steps : array, shape (C,)
        Visible sizes, in units of the least changes that have to be detected.
    moved_m : array, shape (C,)
        Rms motion by one step beside a moved tracker [m], see ``visibility``.
    visible : array, shape (C,)
        Mask of the directions that have a visible size.
    false_alarm : float
        Probability of a false alarm.
    """

    belief: CheckBelief
    directions: tuple[Changing, ...]
    alternatives: tuple[Alternative, ...]
    motions: Mapping[str, Array]
    steps: Array
    moved_m: Array
    visible: NDArray[np.bool_]
    false_alarm: float = FALSE_ALARM

    @property
    def early_alarm(self) -> float:
        """Probability of a false alarm by the evaluations after every stop."""
        return SPENT_EARLY * self.false_alarm

    @property
    def last_alarm(self) -> float:
        """Probability of a false alarm by the test after the last stop."""
        return (1.0 - SPENT_EARLY) * self.false_alarm

    def name_of(self, one: Alternative) -> str:
        """Return the name of a change for people, with its arm if the cell has several."""
        if one.kind == "tracker":
            return "tracker"
        if one.kind in ("base", "smr"):
            return f"{one.what} of arm {one.arm}"
        return one.what if len(self.belief.arms) == 1 else f"{one.what}, arm {one.arm}"


@dataclass(frozen=True, eq=False)
class Cause:
    """An accepted change: its sizes (r,) in steps with their covariance, its motion (None unless rigid), its evidence.

    ``p_value`` is the probability of at least as much evidence for any change if nothing has changed. ``confounded``
    explain the stops about as well; ``undecided`` are not yet surely excluded, but more stops can do it.
    """

    alternative: Alternative
    sizes: Array
    covariance: Array
    motion: Array | None
    p_value: float
    confounded: tuple[str, ...]
    undecided: tuple[str, ...]


def explain(design: Design, stops: StopRows) -> tuple[tuple[Cause, ...], bool]:
    """Find what changed, given that something did: the most evident first, and whether that explains the stops."""
    causes: list[Cause] = []
    nuisance: list[int] = []
    while True:
        moments = Moments.of(stops)
        rest = after(moments, nuisance) if nuisance else moments
        others = [one for one in design.alternatives if one not in [cause.alternative for cause in causes]]
        test = MinPValueTest.of(rest, others)
        p_values = test.p_values(rest.white[:, None])[:, 0]
        if causes and not test.significant(float(p_values.min()), design.false_alarm):
            break
        if len(causes) == _MOST_CHANGES:
            break
        fits = [_fit(design, stops, one, nuisance, rest, basis) for one, basis in zip(others, test.bases, strict=True)]
        least = max(fit.gain for fit in fits) - _TIE
        best = next(k for k, fit in enumerate(fits) if fit.gain >= least)
        stops = fits[best].stops
        nuisance += others[best].members
        sizes, covariance = solved(Moments.of(stops), nuisance)
        own = slice(len(sizes) - len(others[best].members), len(sizes))
        confounded, undecided = _confounded(design, dict(zip(others, fits, strict=True)), others[best], sizes[own])
        causes.append(
            Cause(
                alternative=others[best],
                sizes=sizes[own],
                covariance=covariance[own, own],
                motion=fits[best].motion,
                p_value=test.corrected(float(p_values[best])),
                confounded=confounded,
                undecided=undecided,
            )
        )
    return tuple(causes), bool(causes) and float(p_values[-1]) >= NOT_EXPLAINED


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fitted alternative: the stops without the fitted motion, the remaining chi-squared, and the gain of the log
    likelihood less the penalty (BIC) of the parameters.

    ``motion`` is that of a tracker or base that moved.
    """

    stops: StopRows
    chi_squared: float
    gain: float
    motion: Array | None


def _confounded(
    design: Design, fits: Mapping[Alternative, _Fit], chosen: Alternative, sizes: Array
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name what explains the stops about as well as the ``chosen`` change, and what more stops would exclude."""
    fit = fits[chosen]
    behind = [
        (min(0.5 * (its.chi_squared - fit.chi_squared), fit.gain - its.gain), one)
        for one, its in fits.items()
        if one is not chosen
    ]
    return (
        tuple(design.name_of(one) for by, one in behind if by <= ALIKE),
        tuple(design.name_of(one) for by, one in behind if by <= SURE and _tells(design, chosen, sizes, one)),
    )


def _fit(design: Design, stops: StopRows, one: Alternative, nuisance: list[int], rest: Moments, basis: Array) -> _Fit:
    """Fit the parameters of one alternative by least squares, together with those already known to have changed.

    ``rest`` are the stops with the latter projected out, ``basis`` (r, d) the alternative's directions there.
    """
    belief, before = design.belief, float(rest.white @ rest.white)
    penalty = 0.5 * len(basis) * math.log(len(rest.white))
    moved = np.array([one.kind == "tracker" or list(belief.arms)[arm] == one.arm for arm in stops.arm_of])
    if one.kind not in ("tracker", "base") or np.sum(moved & stops.points) < FEWEST_POINTS:
        explained = float(np.sum((basis @ rest.white) ** 2))
        return _Fit(stops, before - explained, 0.5 * explained - penalty, None)
    whole = [*nuisance, *one.members]
    linear = [k for k in whole if design.directions[k].kind not in ("tracker", "base")]
    motion, here = solve_motion(stops, centre_of(belief), moved, linear)
    chi_squared = float(np.sum(after(Moments.of(here), whole).white ** 2))
    return _Fit(here, chi_squared, 0.5 * (before - chi_squared) - penalty, motion)


def _tells(design: Design, cause: Alternative, sizes: Array, other: Alternative) -> bool:
    """Return whether the calibration's configurations distinguish a change from an alternative."""
    whole = np.concatenate([moved.reshape(len(moved), -1) for moved in design.motions.values()], axis=1)
    moved = sizes @ whole[list(cause.members)]
    basis = np.linalg.qr(whole[list(other.members)].T)[0]
    unexplained = moved - basis @ (basis.T @ moved)
    return float(np.linalg.norm(unexplained)) > _INSEPARABLE * float(np.linalg.norm(moved))


# -- Rigid motion of the tracker or a base, solved for from the registration of the points ----------------------------
#
# A measured point p that was moved by T lies at T p'; p' is where the calibration expects it, up to changes of
# parameters, which enter linearly. An orientation turns with it.

LARGE_M = 5e-4
"""Errors above this are registered first: a rotation of that size leaves second-order errors below a micrometre."""
_STEPS = 9
"""Steps at most; two to four are usual."""
_SMALL = 1e-9
"""Length of the last step [m, rad]."""


def solve_motion(
    stops: StopRows, centre: Array, moved: NDArray[np.bool_], linear: Sequence[int] = ()
) -> tuple[Array, StopRows]:
    """Find the motion (4, 4) that explains the stops best, and the stops without it.

    Parameters
    ----------
    stops : StopRows
    centre : array, shape (3,)
        About which steps turn [m].
    moved : array, shape (m,)
        Mask of the points that moved.
    linear : sequence of int
        Directions that changed besides.

    Raises
    ------
    NotConverged
    """
    twist = (twists(stops.expected - centre, ~stops.points) * moved[:, None, None]).reshape(-1, 6)
    A, own, start = np.column_stack([twist, stops.rows[list(linear)].T]), moved & stops.points, np.eye(4)
    if float(np.abs(stops.residuals).max()) > LARGE_M and np.sum(own) >= FEWEST_POINTS:
        start = register(stops.measured[own], stops.expected[own])
    problem = LeastSquares[tuple[Array, Array]](
        lambda one: (_without(stops, one[0], moved).residuals.ravel() - A[:, 6:] @ one[1], A),
        lambda one, step: (one[0] @ small_motion(step[:6], centre), one[1] + step[6:]),
        stops.factor,
    )
    first = (start, np.zeros(len(linear)))
    best = problem.best("fit of a motion to the stops", first, tolerance=_SMALL, max_iterations=_STEPS)
    T = best.point.state[0]
    return T, _without(stops, T, moved)


def _without(stops: StopRows, T: Array, moved: NDArray[np.bool_]) -> StopRows:
    """Return the stops without a motion of some points."""
    measured = np.where(moved[:, None], apply(invert(T), stops.measured), stops.measured)
    rows = ~stops.points & moved
    if rows.any():
        R = scipy.spatial.transform.Rotation.from_rotvec(stops.measured[rows]).as_matrix()
        measured[rows] = rotation_vectors(T[:3, :3].T @ R)
    return replace(stops, measured=measured)
