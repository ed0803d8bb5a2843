"""Joint fit of geometry and effect terms, and its linearisation.

With W the whitening, the rows of the design are W [J, A]: derivatives of the SMR position with respect to the geometric
parameters and to those of the terms. The residual y and these rows are the linear model for scan, review and proposals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import Identification, excess_of, identify
from cellapp.estimation.calibration.least_squares import (
    PIVOT,
    cholesky,
    inverse_psd,
    mean_variance,
    readings_noise,
    solver_psd,
    with_excess,
)
from cellapp.estimation.calibration.normal_equations import EffectColumns
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.design.information import SMALLEST, NuisanceProjector, visible_squares
from cellapp.estimation.discovery.arm_data import (
    LEAST_SCATTER_M,
    TOLERANCE,
    ArmData,
    CandidateLaw,
    Excess,
    ModelTerms,
    Smoothness,
    TermLayout,
    blocks_beyond_bounds,
    smoothness_of,
    whitened_displacements,
    whitening,
)
from cellapp.estimation.readings.readings import covariances_of, folds_of
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm, Law
from cellapp.robot.kinematics.chain import Geometry, JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import PosteriorSamples, ReadingsNoise

# -- Normal equations of a linear model with priors: accumulated over readings, solved, and partly eliminated ---------
#
#     (X^T X + P) b = X^T y
#
# X are whitened columns, P prior precisions. Used by fits to all readings, the evidence of free functions and the
# folds of the cross-validation.

_SMALLEST = 1e-300
"""Guards divisions by a norm of zero."""


@dataclass(frozen=True, eq=False)
class NormalMatrix:
    """X^T X (p, p), X^T y (p,) and y^T y of whitened columns; y is the residual plus the present prediction.

    ``coordinates`` are independent: those of y, less the parameters eliminated.
    """

    gram: Array
    moment: Array
    square: float
    coordinates: float

    @classmethod
    def of(cls, rows: Array, target: Array) -> NormalMatrix:
        """Compute the products from columns as rows X^T (p, d) and y (d,)."""
        return cls(rows @ rows.T, rows @ target, float(target @ target), float(len(target)))

    def __add__(self, other: NormalMatrix) -> NormalMatrix:
        """Add further readings."""
        return NormalMatrix(
            self.gram + other.gram,
            self.moment + other.moment,
            self.square + other.square,
            self.coordinates + other.coordinates,
        )

    def __sub__(self, other: NormalMatrix) -> NormalMatrix:
        """Remove some of the readings."""
        return self + NormalMatrix(-other.gram, -other.moment, -other.square, -other.coordinates)

    def take(self, places: NDArray[np.intp] | NDArray[np.bool_]) -> NormalMatrix:
        """Return the equations of some of the columns."""
        return replace(self, gram=self.gram[places][:, places], moment=self.moment[places])

    def log_occam(self, variance: Array) -> float:
        """Return ``ln det(I + V^1/2 X^T X V^1/2)`` for prior variances V (p,): the Occam factor of the columns."""
        root = np.sqrt(variance)
        gram = self.gram * (root[:, None] * root)
        gram.flat[:: len(gram) + 1] += 1.0
        try:
            return 2.0 * float(np.sum(np.log(np.diag(np.linalg.cholesky(gram)))))
        except np.linalg.LinAlgError:  # without noise, rounding exceeds the share of the priors
            return float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(gram), 1.0))))

    @property
    def scale(self) -> Array:
        """Scale (p,) of each parameter that gives its column unit norm."""
        return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(self.gram), _SMALLEST)))

    def covariance(self, precision: Array) -> Array:
        """Return the inverse of X^T X + P for prior precisions (p,)."""
        scale = self.scale
        return inverse_psd(self._scaled(precision, scale)) * (scale[:, None] * scale)

    def solver(self, precision: Array, scale: Array | None = None) -> Callable[[Array], Array]:
        """Return ``(X^T X + P)^-1`` for prior precisions (p,), as a function of (p,) or (p, r); X^T X is not kept.

        For a subset of the readings pass the ``scale`` of all: what it does not determine is then zero up to rounding.
        """
        unit = self.scale if scale is None else scale
        solve_scaled = solver_psd(self._scaled(precision, unit))

        def solve(rhs: Array) -> Array:
            own = unit if rhs.ndim == 1 else unit[:, None]
            return np.asarray(own * solve_scaled(own * rhs))

        return solve

    def _scaled(self, precision: Array, scale: Array) -> Array:
        """Return X^T X + P with each parameter in its scale (p,), which makes them comparable."""
        A = self.gram * (scale[:, None] * scale)
        A.flat[:: len(A) + 1] += precision * scale**2
        return A

    def determined(self, precision: Array) -> float:
        """Return the effective number of parameters that the readings determine beside prior precisions (p,)."""
        return len(precision) - float(np.sum(precision * np.diag(self.covariance(precision))))

    def behind(self, flat: int, precision: Array) -> NormalMatrix:
        """Eliminate the first ``flat`` columns, with prior precisions (flat,); return the equations of the others.

        The coordinates become fewer by the effective number of parameters that the readings determine.
        """
        inverse = self.take(np.arange(flat)).covariance(precision)
        cross, moment = self.gram[:flat, flat:], self.moment[:flat]
        explained = inverse @ cross
        return NormalMatrix(
            self.gram[flat:, flat:] - cross.T @ explained,
            self.moment[flat:] - explained.T @ moment,
            self.square - float(moment @ inverse @ moment),
            self.coordinates - (flat - float(np.sum(precision * np.diag(inverse)))),
        )


# -- Share of a residual explained by columns in the complement of a model's parameters: R^2 and gain of the BIC ------
#
# With M as in ``estimation.design.information``, residual y (d,) and columns B (m, d),
#
#     explained = (B M y)^T (B M B^T)^-1 (B M y),     R^2 = explained / y^T M y,
#     BIC gain  = -f ln(1 - R^2) - k ln f,            k parameters (Schwarz, Ann. Stat. 6 (1978) 461),
#
# f = d less the parameters of the model that the data determine. With d in place of f, a scatter estimated from few
# readings would count as known better than it is.

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


_WEIGHING_ROUNDS = 3
"""Most rounds of fitting and estimating the excess variance: the fit depends on its root only, and weakly."""
_EXCESS_CHANGE = 0.02
"""Relative change of the excess variance at which its estimate has converged: weights then change by 1 %."""
_SAME_COLUMNS = 1e-3
"""Step of a fit [m at arm's length] up to which the effects' columns are kept. They change relatively by about as much:
an effect of 0.3 mm by 0.3 µm."""
_SMOOTH_TOLERANCE = 1e-5
"""Step [m at arm's length] at which a fit with smooth terms ends: what is left is along directions that the readings
hardly determine, and moves no prediction by a micrometre."""
_LEAST_STEPS = 200
"""Steps that a fit may take at least: without a term that moves the SMR by a millimetre it follows a curved valley."""
_SAMPLE_SEED = 0xD4A7
"""Combined with the profile's seed, so that the samples of parameters are independent of all other samples."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Whitened derivatives of the SMR positions of n readings, linearised at one geometry.

    Attributes
    ----------
    by_joint : array, shape (3, N, n)
        With respect to the joint angles.
    rows : array, shape (p, 3 n)
        With respect to the geometric parameters, then to those of effect columns.
    """

    by_joint: Array
    rows: Array

    @classmethod
    def of(
        cls,
        geometry: Geometry,
        q: Array,
        white: Array,
        parameters: ParameterSet,
        effects: Sequence[EffectColumn] = (),
        R_M_S: Array | None = None,
    ) -> LinearModel:
        """Linearise at configurations ``q`` (n, N) [rad], whitened by ``white`` (3, 3, n), for some geometric
        parameters and columns of effects; where ``R_M_S`` (n, 3, 3) was measured, for the orientation."""
        angles = JointAngles.of(q, R_M_S)
        _, J = parameters.jacobian(geometry, angles)
        _, by_joint = joint_jacobian(geometry, angles)
        by_joint = np.einsum("acn,cjn->ajn", white, by_joint)
        geometric = np.einsum("acn,ckn->kan", white, J).reshape(len(parameters.columns), -1)
        rows = np.concatenate([geometric, whitened_displacements(effects, by_joint, white)]) if effects else geometric
        return cls(by_joint, rows)


@dataclass(frozen=True, eq=False)
class JointFit:
    """Effect terms fitted together with the geometry.

    Attributes
    ----------
    terms : ModelTerms
    layout : TermLayout
        Indices of the parameters of each term.
    identification : Identification
        Geometric parameters first, then those of the terms in order.
    columns : tuple of EffectColumn
        Columns of all terms, in order.
    model : ArmModel
        The fitted arm.
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    by_joint : array, shape (3, N, n)
        Whitened derivatives of the SMR position with respect to the joint angles.
    rows : array, shape (p, 3 n)
        Whitened derivatives with respect to all fitted parameters.
    precision : array, shape (p,)
        Prior precisions; zero where there is no prior.
    residual : array, shape (3 n,)
        Whitened.
    derived : dict
        Cache of what others derive from this fit: folds of the cross-validation, the whole of a field, a scan.
    """

    terms: ModelTerms
    layout: TermLayout
    identification: Identification
    columns: tuple[EffectColumn, ...]
    model: ArmModel
    white: Array
    by_joint: Array
    rows: Array
    precision: Array
    residual: Array
    derived: dict[Any, Any] = field(default_factory=dict, repr=False)
    _behind: dict[int, ProjectedResidual] = field(default_factory=dict, repr=False)

    @cached_property
    def normal(self) -> NormalMatrix:
        """Normal matrix of all columns and ``target``, shared by projectors, criterion and cross-validation."""
        return NormalMatrix.of(self.rows, self.target)

    @cached_property
    def projector(self) -> NuisanceProjector:
        """Projector onto the complement of all fitted parameters."""
        return NuisanceProjector.of(self.rows, self.precision, self.normal.gram)

    def projector_of(self, kept: NDArray[np.bool_]) -> NuisanceProjector:
        """Return the projector onto the complement of the parameters in the mask ``kept``."""
        return NuisanceProjector.of(self.rows[kept], self.precision[kept], self.normal.take(kept).gram)

    @cached_property
    def projected_residual(self) -> ProjectedResidual:
        """The residual in the complement of all fitted parameters."""
        return ProjectedResidual(self.projector, self.residual)

    @cached_property
    def information_criterion(self) -> float:
        """Minus twice the log marginal likelihood, with the parameters that have a smooth prior integrated out.

        Each other parameter costs ln f, as in the Bayesian information criterion. f is the number of coordinates less
        the parameters of the geometry, which all models share: so many determine the scatter (restricted likelihood).
        """
        first = self.layout.geometric
        smooth = np.zeros(len(self.precision), dtype=bool)
        smooth[first:] = self.precision[first:] > 0.0
        values = self.identification.values
        square = float(self.residual @ self.residual) + float(self.precision[smooth] @ values[smooth] ** 2)
        log_variance = -2.0 * float(np.sum(np.log(np.einsum("aan->an", self.white))))
        flat = int(np.count_nonzero(~smooth))
        order = np.argsort(smooth, kind="stable")
        rest = self.normal.take(order).behind(flat, self.precision[order[:flat]])
        of_geometry = self.normal.take(np.arange(first)).determined(self.precision[:first])
        freedom = max(len(self.residual) - of_geometry, 1.0)
        scatter = log_variance * freedom / len(self.residual)
        price = (self.normal.coordinates - rest.coordinates) * math.log(freedom)
        return square + scatter + price + rest.log_occam(1.0 / self.precision[smooth])

    def residual_without(self, term: int) -> ProjectedResidual:
        """Return the residual of the model without one term, in the complement of that model's parameters."""
        if term not in self._behind:
            projector = self.projector_of(self.layout.all_but(term))
            self._behind[term] = ProjectedResidual(projector, self.residual + self.signal(term))
        return self._behind[term]

    def removed_square(self, term: int) -> float:
        """Compute the sum of squares that only this term explains: its signal in the complement of all others."""
        kept, signal = self.layout.all_but(term), self.signal(term)
        others = self.rows[kept]
        # one linear solution: a projector of hundreds of smooth columns costs ten times as much
        values = self.normal.take(kept).solver(self.precision[kept])(others @ signal)
        return float(np.sum((signal - values @ others) ** 2))

    def without_columns(self, terms: Collection[int]) -> JointFit:
        """Return the linear model without the columns of some terms with priors: others must explain their part."""
        kept = np.all([self.layout.all_but(term) for term in terms], axis=0)
        fewer = replace(self, rows=self.rows[kept], precision=self.precision[kept], derived={})
        fewer.__dict__["target"] = self.target
        return fewer

    def term_rows(self, term: int) -> Array:
        """Return the whitened columns of a term (m, 3 n)."""
        return self.rows[self.layout.parameters(term)]

    def law_rows(self, term: int) -> Array:
        """Return the whitened columns of a term's law (m, 3 n), without those of its discrepancy term."""
        return self.term_rows(term)[: len(self.terms[term].names)]

    def law_misfit(self, term: int) -> float:
        """Return the ratio of the rms displacement by a term's discrepancy term to that by its law."""
        values, size = self.term_values(term), len(self.terms[term].names)
        by_law = float(np.linalg.norm(values[:size] @ self.law_rows(term)))
        by_discrepancy = float(np.linalg.norm(values[size:] @ self.term_rows(term)[size:]))
        return by_discrepancy / by_law if by_law > 0.0 else 0.0

    def term_values(self, term: int) -> Array:
        """Return the fitted values of a term's parameters (m,)."""
        return self.identification.effect_values[self.layout.columns(term)]

    def term_columns(self, term: int) -> tuple[EffectColumn, ...]:
        """Return the columns of a term."""
        return self.columns[self.layout.columns(term)]

    def signal(self, term: int) -> Array:
        """Return the whitened displacement that a term predicts (3 n,)."""
        return np.asarray(self.term_values(term) @ self.term_rows(term))

    @property
    def geometry_mean(self) -> Array:
        """Means of the priors (K,) of the geometric parameters: nominal, or the bound at which one is held."""
        return self.identification.mean[: self.layout.geometric]

    @cached_property
    def target(self) -> Array:
        """Whitened residual plus prediction of the terms with priors (3 n,): the data of linear refits with priors."""
        first = self.layout.geometric
        penalised = np.flatnonzero(self.precision[first:] > 0.0)
        if not len(penalised):
            return self.residual
        held = self.identification.effect_values[penalised] @ self.rows[first + penalised]
        return np.asarray(self.residual + held)

    def candidate(self, data: ArmData, slug: str, law: Law) -> CandidateLaw:
        """Return a law as a candidate beside this model."""
        columns = data.columns(slug, law)
        return CandidateLaw(slug, law, tuple(columns), self.displacements(columns))

    def candidates(self, data: ArmData, slugs: Sequence[str]) -> list[CandidateLaw]:
        """Return all laws of the effects ``slugs`` that the data allow to test, as candidates."""
        testable = [slug for slug in slugs if not EFFECTS[slug].missing_data(data.context)]
        return [self.candidate(data, slug, law) for slug in testable for law in EFFECTS[slug].laws(data.context)]

    def displacements(self, columns: Sequence[EffectColumn]) -> Array:
        """Return the whitened SMR displacements (m, 3 n) of columns."""
        return whitened_displacements(columns, self.by_joint, self.white)

    def blocks_beyond_bounds(self, term: int) -> set[str]:
        """Return the blocks of a term with a value outside its physical bounds by more than chance allows."""
        errors = self.identification.standard_errors[self.layout.parameters(term)]
        return blocks_beyond_bounds(self.term_columns(term), self.term_values(term), errors)


def fit_terms(data: ArmData, terms: ModelTerms, near: Identification | None = None) -> JointFit:
    """Fit geometry and terms to all readings and linearise there; start from ``near``, a fit of the same terms."""
    return _linearised(data, terms, *_identify(data, terms, near))


def _layout(found: Identification, terms: ModelTerms) -> TermLayout:
    return TermLayout.of(len(found.parameter_set.columns), [term.size for term in terms])


def _linearised(data: ArmData, terms: ModelTerms, found: Identification, columns: tuple[EffectColumn, ...]) -> JointFit:
    layout = _layout(found, terms)
    white = whitening(data.sigma)
    linear = LinearModel.of(found.geometry, data.readings.q, white, found.parameter_set, columns, data.conditions.R_M_S)
    fit = JointFit(
        terms=terms,
        layout=layout,
        identification=found,
        columns=columns,
        model=_fitted_model(data, found, terms, layout),
        white=white,
        by_joint=linear.by_joint,
        rows=linear.rows,
        precision=found.precision,
        residual=np.einsum("acn,nc->an", white, found.residuals).ravel(),
    )
    return _with_misfits(fit) if any(term.modulations for term in terms) else fit


def _with_misfits(fit: JointFit) -> JointFit:
    """Set in the fit's model the misfit of each law, see ``JointFit.law_misfit``."""
    stated = [replace(effect, law_misfit=fit.law_misfit(number)) for number, effect in enumerate(fit.model.effects)]
    return replace(fit, model=replace(fit.model, effects=tuple(stated)))


def with_posterior(data: ArmData, fit: JointFit, spread: float = 1.0) -> ArmModel:
    """Return the fitted model with samples of its parameters and the scatter of readings, ``spread`` times as wide."""
    found = fit.identification
    kept = [*range(len(found.estimated.columns)), *range(fit.layout.geometric, fit.layout.total)]
    samples = samples_of(data, fit, found.covariance[np.ix_(kept, kept)], max(found.scale, 1.0), spread)
    return replace(fit.model, posterior=samples)


def samples_of(
    data: ArmData, fit: JointFit, covariance: Array, scale: float, spread: float, seed: int = _SAMPLE_SEED
) -> PosteriorSamples:
    """Draw parameters of a fit, ``spread`` times as wide, and state the noise of the readings, ``scale`` times it."""
    estimated = fit.identification.estimated
    return PosteriorSamples.of_covariance(
        columns=estimated.columns,
        sizes=[term.size for term in fit.terms],
        covariance=covariance * spread**2,
        noise=noise_of(data, scale * spread, smoothness_of(fit.terms)),
        seed=(data.profile.seed, seed),
        tied=estimated.tied,
    )


def noise_of(data: ArmData, scale: float = 1.0, smooth: Smoothness | None = None) -> ReadingsNoise:
    """Return the noise by which the readings are weighted, times a scale; and its parts if known."""
    noise = readings_noise(data.sigma, data.angular, scale)
    if smooth is None or not any(smooth.scatter.joints):
        return noise
    own = uncertainty_with_scatter(data, replace(smooth.scatter, joints=()))[data.points]
    joints_rad = scale * np.array(smooth.scatter.joints)
    return noise._replace(parts=np.array([scale * math.sqrt(mean_variance(own)), *joints_rad]))


def refit(data: ArmData, terms: ModelTerms) -> tuple[ArmData, JointFit]:
    """Fit terms with re-estimated weights; evaluate effects at the geometry found, or very near it."""
    here, near = reweighted(data, terms)
    found, columns = _identify(here, terms, near)
    if sum(found.steps) > _SAME_COLUMNS:
        here = here.at(_fitted_model(here, found, terms, _layout(found, terms)))
        return here, fit_terms(here, terms, found)
    fit = _linearised(here, terms, found, columns)
    return here.beginning_at(fit.model), fit


def reweighted(data: ArmData, terms: ModelTerms) -> tuple[ArmData, Identification | None]:
    """Return the data with weights that include the scatter of a model with ``terms`` beyond the stated uncertainty.

    The estimate starts from the weights of the data. If no uncertainty is stated, all of the scatter is estimated. With
    smooth terms the scatter is the one that maximised their evidence. The second value is the last fit made on the way;
    None if there was none.
    """
    smooth, found = smoothness_of(terms), None
    if smooth is not None:
        return replace(data, sigma=uncertainty_with_scatter(data, smooth.scatter)), None
    if data.stated is None:
        # a smooth term that was there may have left scatter by joint: covariances
        data = replace(data, sigma=np.full(len(data), math.sqrt(mean_variance(data.sigma))))
        for _ in range(_WEIGHING_ROUNDS):
            found, _ = _identify(data, terms, found)
            data = replace(data, sigma=np.maximum(data.sigma * found.scale, LEAST_SCATTER_M))
            if abs(found.scale - 1.0) <= _EXCESS_CHANGE:
                break
        return data, found
    sigma, excess = data.sigma, (-1.0, -1.0)
    for _ in range(_WEIGHING_ROUNDS):
        found, _ = _identify(replace(data, sigma=sigma), terms, found)
        before, excess = excess, excess_of(found, data.stated)
        sigma = with_excess(data.stated, excess[0], data.angular, excess[1])
        if all(abs(now - then) <= _EXCESS_CHANGE * now for now, then in zip(excess, before, strict=True)):
            break
    return replace(data, sigma=sigma), found


def uncertainty_with_scatter(data: ArmData, scatter: Excess) -> Array:
    """Add a scatter to the stated uncertainty: standard uncertainties (n,) [m] or covariances (n, 3, 3) [m^2]."""
    if data.stated is None:
        sigma = np.full(len(data), max(scatter.m, LEAST_SCATTER_M))
    else:
        stated = data.stated * (scatter.claim if data.stated.ndim == 1 else scatter.claim**2)
        sigma = with_excess(stated, scatter.m**2, data.angular, scatter.rad**2)
    if not any(scatter.joints):
        return sigma
    by_joint = joint_motions(data)
    return np.asarray(
        covariances_of(sigma) + np.einsum("j,ajn,bjn->nab", np.square(scatter.joints), by_joint, by_joint)
    )


def joint_motions(data: ArmData) -> Array:
    """Return the derivatives (3, N, n) of the readings with respect to the joint angles."""
    return joint_jacobian(data.model.geometry, JointAngles.of(data.readings.q, data.conditions.R_M_S))[1]


def _identify(
    data: ArmData, terms: ModelTerms, near: Identification | None = None
) -> tuple[Identification, tuple[EffectColumn, ...]]:
    """Identify geometry and terms jointly, with effect parameters in the order of the terms' columns.

    ``near`` is an identification of the same terms, whose values are the start.
    """
    columns, settings = data.term_columns(terms), data.profile.calibration
    start = _start_values(data, terms, columns) if near is None else near.effect_values[: len(columns)]
    found = identify(
        data.model.geometry if near is None else near.geometry,
        data.readings.q,
        data.readings.p_M,
        R_M_S=data.conditions.R_M_S,
        sigma=data.sigma,
        parameter_set=data.parameter_set,
        prior_sigma=data.prior_sigma,
        prior_mean=data.model.nominal,
        robust=settings.robust,
        effects=EffectColumns.of(columns, len(data), start) if columns else None,
        tolerance=max(settings.tolerance, TOLERANCE if smoothness_of(terms) is None else _SMOOTH_TOLERANCE),
        max_iterations=max(settings.max_iterations, _LEAST_STEPS),
    ).settled("fit of geometry and effects")
    return found, columns


def _start_values(data: ArmData, terms: ModelTerms, columns: Sequence[EffectColumn]) -> Array:
    """Return start values (m,) of an earlier fit; zero for columns that it lacked."""
    slugs = (term.slug for term in terms for _ in range(term.size))
    pairs = zip(slugs, columns, strict=True)
    return np.array([data.start.get((slug, column.name), 0.0) for slug, column in pairs])


def _fitted_model(data: ArmData, found: Identification, terms: ModelTerms, layout: TermLayout) -> ArmModel:
    """Return the arm with the fitted terms; its covariance omits the many coefficients with smooth priors."""
    fitted = []
    kept = list(range(len(found.parameter_set.columns)))
    for number, term in enumerate(terms):
        here = layout.parameters(number)
        if term.smooth is None:
            kept += range(here.start, here.start + len(term.names))
        fitted.append(
            EffectTerm(
                slug=term.slug,
                names=(*term.names, *(one.name for one in term.modulations)),
                values=found.values[here],
                standard_errors=found.standard_errors[here],
                units=found.units[here],
                law=term.law,
                note=term.note,
                modulations=term.modulations,
            )
        )
    return replace(
        data.model,
        geometry=found.geometry,
        effects=tuple(fitted),
        identified=tuple(found.names[i] for i in kept),
        covariance=found.covariance[np.ix_(kept, kept)],
    )


# -- K-fold cross-validation of a new term, linear about a joint fit --------------------------------------------------
#
# Each fold is predicted by the least-squares solution of the other folds (with priors),
#
#     beta = (X_in X_in^T + P)^-1 X_in y_in,
#
# from the normal matrix of all readings less that of the fold. The hat matrix of the fit would save these solutions,
# but I - H is nearly singular if few readings are left: a direction that they do not determine would then count as
# predicted.

_FOLD_SEED = 0xF01D
"""Combined with the profile's seed, so that the folds are independent of all other samples."""


def cross_validated_gain(data: ArmData, fit: JointFit, new_rows: Array) -> float:
    """Return the decrease of the whitened sum of squares of left-out readings when columns (m, 3 n) join a fit."""
    pairs = _left_out(fit, new_rows, _fold_numbers(data))
    return float(sum(np.sum(before**2) - np.sum(after**2) for before, after in pairs))


def left_out(data: ArmData, fit: JointFit) -> Array:
    """Predict each fold of whole configurations, or of whole neighbourhoods, by the others, linear about a fit.

    Return residuals [m, rad] (n, 3).
    """
    residual = np.empty(len(fit.residual))
    for one in _folds(fit, _fold_numbers(data)):
        residual[one.out] = one.residual
    return np.asarray(np.einsum("nab,bn->na", np.linalg.inv(fit.white.transpose(2, 0, 1)), residual.reshape(3, -1)))


def left_out_in_sd(data: ArmData, fit: JointFit) -> Array:
    """Return the residuals (3 n,) of ``left_out``, whitened, in units of their predicted standard deviation."""
    scaled = np.empty(len(fit.residual))
    for one in _folds(fit, _fold_numbers(data)):
        rows = fit.rows[:, one.out]
        scaled[one.out] = one.residual / np.sqrt(1.0 + np.einsum("pk,pk->k", rows, one.solve(rows)))
    return scaled


def _fold_numbers(data: ArmData) -> NDArray[np.intp]:
    """Return the number of the fold (3 n,) of each coordinate."""
    generator = np.random.default_rng([data.profile.seed, _FOLD_SEED])
    return np.tile(folds_of(data.undivided, data.profile.discovery.folds, generator), 3)


def _left_out(fit: JointFit, new_rows: Array, fold: NDArray[np.intp]) -> Iterator[tuple[Array, Array]]:
    """Yield for each fold the residuals of the left-out coordinates without and with the new columns."""
    scale = 1.0 / np.maximum(np.linalg.norm(new_rows, axis=1), SMALLEST)
    new, target = new_rows * scale[:, None], fit.target
    with_fit = fit.rows @ new.T
    for one in _folds(fit, fold):
        learnt = ~one.out
        B = new[:, learnt]
        cross, gram = with_fit - fit.rows[:, one.out] @ new[:, one.out].T, B @ B.T
        taken = one.solve(cross)
        factor = cholesky(gram - cross.T @ taken)
        if factor is None or not (factor.diagonal() > PIVOT * np.sqrt(gram.diagonal())).all():
            # the new columns are not independent of each other or of the fit
            rows = np.concatenate([fit.rows, new])
            precision = np.concatenate([fit.precision, np.zeros(len(new))])
            of_all = np.concatenate([fit.normal.scale, np.ones(len(new))])
            normal = NormalMatrix.of(rows[:, learnt], target[learnt])
            solution = normal.solver(precision, of_all)(normal.moment)
            yield one.residual, target[one.out] - solution @ rows[:, one.out]
            continue
        moment = B @ target[learnt] - taken.T @ one.moment
        values = scipy.linalg.lapack.dpotrs(factor, moment, lower=1)[0]
        yield one.residual, one.residual - values @ (new[:, one.out] - taken.T @ fit.rows[:, one.out])


@dataclass(frozen=True, eq=False)
class _Fold:
    """A fit without the readings of one fold: the mask ``out`` (3 n,) of these, and their residuals ``residual``.

    ``solve`` and ``moment`` are its factored equations: one matrix a fold, not three.
    """

    out: NDArray[np.bool_]
    solve: Callable[[Array], Array]
    moment: Array
    residual: Array


def _folds(fit: JointFit, fold: NDArray[np.intp]) -> list[_Fold]:
    """Return the fits without each fold, cached in the whole fit: many columns are tried beside it."""
    key = fold.tobytes()
    if key not in fit.derived:
        rows, target, found = fit.rows, fit.target, []
        whole = fit.normal
        for number in range(int(fold.max()) + 1):
            out = fold == number
            normal = whole - NormalMatrix.of(rows[:, out], target[out])
            solve = normal.solver(fit.precision, whole.scale)
            residual = target[out] - solve(normal.moment) @ rows[:, out]
            found.append(_Fold(out, solve, normal.moment, residual))
        fit.derived[key] = found
    kept: list[_Fold] = fit.derived[key]
    return kept
