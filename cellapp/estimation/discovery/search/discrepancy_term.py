"""Discrepancy terms of laws: the residual of a nearly right law stays with its effect.

The residual of a nearly right law often looks like a second effect. Each library effect may therefore have a
discrepancy term (``robot.effects.modulation``), small by prior: with fitted values v of a block's columns,

    coefficient of the function f_k of an input ~ N(0, (share |v| w_k)^2),   w_k proportional to k^-2,

scaled so that the modulation g has an rms of ``share``. Standard deviations that fall with k^-2 are the prior of a
function with a finite mean square of its second derivative (the spline prior: Wahba, Spline Models for Observational
Data, 1990), so smooth errors of a law are preferred. ``share`` maximises the evidence (marginal likelihood) of the
residual in the complement of the other parameters. With M the projector there, Z the rows of the discrepancy term
scaled by their standard deviations, noise variance s and f degrees of freedom,

    2 ln evidence = -f ln s - ln det(I + Z M Z^T / s) - (y^T M y - y^T M Z^T (s I + Z M Z^T)^-1 Z M y) / s.

In the scan for second names all discrepancy terms, kept or not, count as nuisance parameters at a cautious share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.arm_data import ArmData, LawScore, ModelTerm, ModelTerms, with_term
from cellapp.estimation.discovery.joint_fit import JointFit, NormalMatrix, ProjectedResidual
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchProblem, SearchState, SearchStep
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS, EffectColumn
from cellapp.robot.effects.data_driven import FIELD, FIELD_LENGTH, position_in_base
from cellapp.robot.effects.law import AMPLITUDE
from cellapp.robot.effects.modulation import HALF_CYCLES, HARMONICS, OWN_HALF_CYCLES, Modulation, closes, modulations
from cellapp.robot.effects.unknown import acted_directions
from cellapp.robot.kinematics.transforms import Array

SHARES = (0.03, 0.1, 0.3)
"""Shares of a law that its discrepancy term may have: a factor of 3 apart, as the evidence has a broad maximum. A
larger error of a law belongs to another effect."""
CAUTIOUS_SHARE = 0.1
"""Share of every law that counts as uncertain in the search for second names: laws hold to some 10 %."""
LEAST_EVIDENCE = SCORE_MARGIN / 2.0
"""Gain of 2 ln evidence at which a discrepancy term is kept: positive to strong evidence, less than a name needs."""
_MOST_COLUMNS = 160
"""Most columns of one term's discrepancy term: with more, as with many lines, only the lower orders are taken."""
_NOISE_SHARES = np.geomspace(0.02, 1.0, 40)
"""Shares of the residual's variance that may be noise, in steps of 10 %."""


@dataclass(frozen=True, eq=False)
class DiscrepancyTerm:
    """Possible columns of a term's discrepancy term for one input.

    ``rows`` (m, 3 n) are their whitened displacements, ``sd`` (m,) their prior standard deviations at a share of one.
    """

    modulations: tuple[Modulation, ...]
    rows: Array
    sd: Array


def possible_discrepancies(data: ArmData, fit: JointFit, number: int) -> list[DiscrepancyTerm]:
    """Return the possible discrepancy term of a term for each input of its effect; none for terms without a law."""
    term = fit.terms[number]
    effect = term.effect
    if effect is None:
        return []
    size = len(term.names)
    columns = [column for column in fit.term_columns(number)[:size] if not column.refines]
    sizes = _sizes(fit, number)
    columns = [column for column in columns if sizes[column.name] > 0.0]
    found = []
    for variable in effect.discrepancy_inputs:
        ones = _lowest_orders(modulations(variable, columns, data.context))
        if ones:
            found.append(_discrepancy_term(data, fit, columns, ones, sizes))
    return found


def _sizes(fit: JointFit, number: int) -> dict[str, float]:
    """Return the size of each column of a term: rms value over its block's columns of the same unit, in that unit.

    The variance of the estimate is subtracted: an undetermined value gives no discrepancy term.
    """
    columns = fit.term_columns(number)
    errors = fit.identification.standard_errors[fit.layout.parameters(number)].tolist()
    squares = grouped(
        ((column.block, column.unit), max(value**2 - error**2, 0.0))
        for column, value, error in zip(columns, fit.term_values(number).tolist(), errors, strict=True)
    )
    return {column.name: math.sqrt(float(np.mean(squares[column.block, column.unit]))) for column in columns}


def _lowest_orders(ones: tuple[Modulation, ...]) -> tuple[Modulation, ...]:
    """Keep modulations up to the highest order that does not make them too many, at least the first."""
    for most in range(max((one.order for one in ones), default=0), 1, -1):
        kept = tuple(one for one in ones if one.order <= most)
        if len(kept) <= _MOST_COLUMNS:
            return kept
    return tuple(one for one in ones if one.order == 1)[:_MOST_COLUMNS]


def _discrepancy_term(
    data: ArmData, fit: JointFit, columns: Sequence[EffectColumn], ones: tuple[Modulation, ...], sizes: dict[str, float]
) -> DiscrepancyTerm:
    by_name = {column.name: column for column in columns}
    rows = fit.displacements([one.column(by_name[one.base], data.context) for one in ones])
    variables = {one.base: len({other.variable for other in ones if other.base == one.base}) for one in ones}
    weights = np.array([_weight(one) / math.sqrt(variables[one.base]) for one in ones])
    return DiscrepancyTerm(ones, rows, weights * np.array([sizes[one.base] for one in ones]))


def _weight(one: Modulation) -> float:
    """Return a coefficient's standard deviation for g of unit rms: k^-2, as a cosine has a mean square of 1/2."""
    harmonics = closes(one.variable)
    most = HARMONICS if harmonics else (OWN_HALF_CYCLES if one.variable is None else HALF_CYCLES)
    orders = np.arange(1, most + 1)
    square = float(np.sum(orders.astype(np.float64) ** -4)) * (1.0 if harmonics else 0.5)
    return float(one.order**-2 / math.sqrt(square))


# -- evidence --------------------------------------------------------------------------------------------------------


def evidence_gain(behind: NormalMatrix, sd: Array) -> float:
    """Return the gain of 2 ln evidence by columns with prior standard deviations (m,), each model at its best noise.

    ``behind`` are their normal equations in the complement of the other parameters.
    """
    square, freedom, used = behind.square, behind.coordinates, behind.take(sd > 0.0)
    scale = sd[sd > 0.0]
    values, vectors = np.linalg.eigh(used.gram * scale[:, None] * scale)
    values = np.maximum(values, 0.0)
    along = (vectors.T @ (scale * used.moment)) ** 2
    noise = square / freedom * _NOISE_SHARES[:, None]
    explained = np.sum(along / (noise + values), axis=1)
    determinant = np.sum(np.log1p(values / noise), axis=1)
    noise = noise[:, 0]
    evidence = -freedom * np.log(noise) - determinant - (square - explained) / noise
    return float(evidence.max()) + freedom * (math.log(square / freedom) + 1.0)


def with_discrepancies(problem: SearchProblem, state: SearchState) -> SearchState | None:
    """Add the discrepancy term of each effect's law if its evidence gains; None if none does.

    Discrepancy terms that the laws already have are replaced.
    """
    terms = without_discrepancies(state.fit.terms)
    had = any(term.modulations for term in state.fit.terms)
    if all(term.effect is None for term in terms):
        return None
    base = problem.state(terms, state) if had else state
    found = _free_terms(base)
    if not any(term.modulations for term in found):
        return base if had else None
    return problem.state(found, state)


def without_discrepancies(terms: ModelTerms) -> ModelTerms:
    """Return the terms without their discrepancy terms."""
    return tuple(replace(term, modulations=(), modulation_sd=()) for term in terms)


def may_stand_for_confounded(state: SearchState, step: SearchStep) -> bool:
    """Return whether the discrepancy term of a confounded effect in the model explains about as much as the new name of
    a step.

    The residual of a law looks most like what it is confounded with.
    """
    fit = state.fit
    if step.slug in state.slugs:
        return False
    of_confounded = (
        possible_discrepancies(state.data, fit, number)
        for number, term in enumerate(fit.terms)
        if term.effect is not None and not term.modulations and are_confounded(step.slug, term.effect.slug)
    )
    needed = step.score - SCORE_MARGIN
    return any(parts and _best_shares(fit, fit.projector, parts)[1] > needed for parts in of_confounded)


def are_confounded(first: str, second: str) -> bool:
    """Return whether one of two effects is declared as confounded with the other."""
    return first in EFFECTS[second].confounded or second in EFFECTS[first].confounded


def _free_terms(state: SearchState) -> tuple[ModelTerm, ...]:
    """Return the terms with the discrepancy terms that gain evidence; those of the largest effects are chosen first."""
    fit, terms = state.fit, state.fit.terms
    nuisance, precision, projector = fit.rows, fit.precision, fit.projector
    order = sorted(range(len(terms)), key=lambda number: -float(np.sum(fit.signal(number) ** 2)))
    for number in order:
        parts = possible_discrepancies(state.data, fit, number)
        chosen, _ = _best_shares(fit, projector, parts)
        if not chosen:
            continue
        sd = np.concatenate([share * part.sd for part, share in chosen])
        nuisance = np.concatenate([nuisance, *(part.rows for part, _ in chosen)])
        precision = np.concatenate([precision, 1.0 / sd**2])
        projector = NuisanceProjector.of(nuisance, precision)
        term = replace(
            terms[number],
            modulations=tuple(one for part, _ in chosen for one in part.modulations),
            modulation_sd=tuple(sd.tolist()),
        )
        terms = with_term(terms, number, term)
    return terms


def _best_shares(
    fit: JointFit, projector: NuisanceProjector, parts: Sequence[DiscrepancyTerm]
) -> tuple[list[tuple[DiscrepancyTerm, float]], float]:
    """Choose inputs of a discrepancy term and their shares beside other parameters; return also the gain of 2 ln
    evidence.

    The best input joins while the evidence gains enough.
    """
    if not parts:
        return [], 0.0
    rows, residual = np.concatenate([part.rows for part in parts]), projector.project(fit.target)
    freedom, square = len(residual) - projector.effective_parameters, float(fit.target @ residual)
    if freedom < 1.0 or square <= 0.0:  # the parameters leave no degrees of freedom
        return [], 0.0
    behind = NormalMatrix(rows @ projector.project(rows).T, rows @ residual, square, freedom)
    chosen: dict[int, float] = {}
    best = 0.0
    while len(chosen) < len(parts):
        trials = []
        for place in range(len(parts)):
            for share in SHARES:
                shares = {**chosen, place: share}
                if place in chosen or math.hypot(*shares.values()) > SHARES[-1] * (1.0 + 1e-9):
                    continue
                trials.append((evidence_gain(behind, _scaled(parts, shares)), place, share))
        if not trials or max(trials)[0] <= best + LEAST_EVIDENCE:
            break
        best, place, share = max(trials)
        chosen[place] = share
    return [(parts[place], share) for place, share in sorted(chosen.items())], best


def _scaled(parts: Sequence[DiscrepancyTerm], shares: dict[int, float]) -> Array:
    """Return the standard deviations of all columns of some parts, zero for parts that are not chosen."""
    return np.concatenate([shares.get(place, 0.0) * part.sd for place, part in enumerate(parts)])


# -- names beside laws that may be off -------------------------------------------------------------------------------


def gain_beside_discrepancies(state: SearchState) -> Callable[[LawScore], float] | None:
    """Return a function for the BIC gain of a new law beside the model and its possible law errors; None without any.

    Laws have discrepancy terms at the cautious share. A field over the workspace has all its waves; there the price of
    choosing the new law counts too, as many of the laws tried depend on the position.
    """
    fit = state.fit
    beside = BesideField.of(state.data, fit)
    if beside is not None:
        return lambda score: beside.gain(score.rows) - fit.projected_residual.bic_gain(score.rows) + score.value
    rows, precision = [], []
    for number in range(len(fit.terms)):
        parts = possible_discrepancies(state.data, fit, number)
        share = CAUTIOUS_SHARE / math.sqrt(max(len(parts), 1))
        rows += [part.rows for part in parts]
        precision += [1.0 / (share * part.sd) ** 2 for part in parts]
    if not rows:
        return None
    projector = NuisanceProjector.of(np.concatenate([fit.rows, *rows]), np.concatenate([fit.precision, *precision]))
    behind = ProjectedResidual(projector, fit.target)
    return lambda score: behind.bic_gain(score.rows)


def explains_beside_discrepancies(problem: SearchProblem, state: SearchState, score: LawScore) -> bool:
    """Return whether a new law passes the threshold even if the laws in the model are slightly off."""
    gain = gain_beside_discrepancies(state)
    return gain is None or gain(score) > problem.threshold


# -- Judgement of terms beside a field over the workspace, with all waves of the field, also those without columns ----
#
# A term for a field has only the slow waves. If the field changes within a few decimetres, the rest of it depends on
# the position, and so on the joint angles and the tracker's angles. With all waves the field is a Gaussian process,
# given by a covariance of the readings instead of columns,
#
#     y = X b + e,   e ~ N(0, s I + a^2 K_l + Z V Z^T),
#
# where X are the columns without priors (geometry, named laws), Z those of other smooth terms with prior variances V,
# and K_l the Matern-5/2 covariance of the shift along each axis. Amplitude, length scale and noise maximise the
# evidence with b integrated out (restricted likelihood: Harville, J. Am. Stat. Ass. 72 (1977) 320).


_EVALUATIONS = 30
"""Most evaluations of the evidence: three hyperparameters from a start nearby."""
_SPREAD = 0.4
"""First step in the logarithm of each hyperparameter."""
_IMPOSSIBLE = 1e300


@dataclass(frozen=True, eq=False)
class BesideField:
    """Linear model of a fit with the field as a covariance of the readings.

    Attributes
    ----------
    fit : JointFit
    field : int
        Index of the field among the terms.
    unit : array, shape (3, 3 n)
        Whitened displacement by a unit shift along each axis.
    distance : array, shape (n, n)
        Distances between the SMR positions [m].
    """

    fit: JointFit
    field: int
    unit: Array
    distance: Array

    @classmethod
    def of(cls, data: ArmData, fit: JointFit) -> BesideField | None:
        """Build the model once for a fit and cache it; None if the fit has no field."""
        fields = [number for number, term in enumerate(fit.terms) if term.smooth is not None and term.law.form == FIELD]
        if not fields:
            return None
        if cls not in fit.derived:
            unit = [
                np.einsum("acn,nc->an", fit.white, moved).ravel()
                for moved in acted_directions(data.context, FIELD.acts_on)
            ]
            position = position_in_base(data.context)
            fit.derived[cls] = cls(fit, fields[0], np.stack(unit), scipy.spatial.distance.cdist(position, position))
        found = fit.derived[cls]
        assert isinstance(found, cls)
        return found

    def gain(self, rows: Array) -> float:
        """Return the gain of the BIC by new rows (m, 3 n) beside model and field, all counted as parameters."""
        return self._projected.bic_gain(self._whitened(rows))

    def gain_of(self, number: int) -> float:
        """Return the gain of the score by a term other than the field: by its law, or by evidence if it is smooth."""
        fit, term = self.fit, self.fit.terms[number]
        if term.smooth is not None:
            without = self._log_evidence(self._best(self._values, number), number)
            price = term.smooth.hyperparameters * math.log(len(fit.residual))
            return 2.0 * (self._log_evidence(self._values, None) - without) - price
        rows = fit.law_rows(number)
        target = fit.target + fit.term_values(number)[: len(rows)] @ rows
        return self._behind(number, target).bic_gain(self._whitened(rows))

    @cached_property
    def _projected(self) -> ProjectedResidual:
        """The residual in the complement of the whole model, cached as many columns are tried beside it."""
        return self._behind(None, self.fit.target)

    def _behind(self, without: int | None, target: Array) -> ProjectedResidual:
        rows, precision = self._parameters(without)
        return ProjectedResidual(NuisanceProjector.of(self._whitened(rows), precision), self._whitened(target))

    def _whitened(self, rows: Array) -> Array:
        """Whiten rows (..., 3 n) by the covariance of field and noise."""
        return np.asarray(scipy.linalg.solve_triangular(self._root, rows.T, lower=True, check_finite=False).T)

    @cached_property
    def _values(self) -> Array:
        constants = self.fit.terms[self.field].law.constants
        start = np.log([constants[AMPLITUDE.name], constants[FIELD_LENGTH.name], 0.7])
        return self._best(start, None)

    @cached_property
    def _root(self) -> Array:
        """Lower Cholesky factor of ``s I + a^2 K``."""
        factor = self._factor(self._values, np.zeros((0, self.unit.shape[1])), np.zeros(0))
        assert factor is not None
        return factor

    def _parameters(self, without: int | None) -> tuple[Array, Array]:
        """Return the rows and prior precisions of all parameters except those of the field and of term ``without``."""
        kept = self.fit.layout.all_but(self.field)
        if without is not None:
            kept &= self.fit.layout.all_but(without)
        return self.fit.rows[kept], self.fit.precision[kept]

    def _factor(self, values: Array, smooth: Array, variance: Array) -> Array | None:
        amplitude, length, noise = np.exp(values)
        r = math.sqrt(5.0) / length * self.distance
        kernel = amplitude**2 * (1.0 + r + r**2 / 3.0) * np.exp(-r)
        covariance = (self.unit.T @ self.unit) * np.tile(kernel, (3, 3))
        covariance += (smooth.T * variance) @ smooth
        covariance.flat[:: len(covariance) + 1] += noise
        factor, failed = scipy.linalg.lapack.dpotrf(covariance, lower=1, overwrite_a=1)
        return None if failed else np.asarray(factor)

    def _log_evidence(self, values: Array, without: int | None) -> float:
        rows, precision = self._parameters(without)
        smooth = precision > 0.0
        smooth[: self.fit.layout.geometric] = False
        factor = self._factor(values, rows[smooth], 1.0 / precision[smooth])
        if factor is None:
            return -_IMPOSSIBLE
        both = np.concatenate([rows[~smooth], self.fit.target[None]])
        white = scipy.linalg.solve_triangular(factor, both.T, lower=True, check_finite=False).T
        gram = white[:-1] @ white[:-1].T
        projected = NuisanceProjector.of(white[:-1], precision[~smooth], gram).project(white[-1])
        scale = np.linalg.norm(rows[~smooth], axis=1)
        gram = (gram + np.diag(precision[~smooth])) / scale / scale[:, None]
        log_determinant = 2.0 * float(np.log(factor.diagonal()).sum()) + float(np.linalg.slogdet(gram)[1])
        return -0.5 * (log_determinant + float(white[-1] @ projected))

    def _best(self, start: Array, without: int | None) -> Array:
        """Maximise the evidence near ``start``; return the logarithms of amplitude, length scale and noise."""
        simplex = np.concatenate([start[None], start + _SPREAD * np.eye(len(start))])
        found = scipy.optimize.minimize(
            lambda values: -self._log_evidence(values, without),
            start,
            method="Nelder-Mead",
            options={"maxfev": _EVALUATIONS, "initial_simplex": simplex},
        )
        return np.asarray(found.x)
