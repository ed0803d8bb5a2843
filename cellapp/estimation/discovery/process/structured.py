"""Fit of the structured process to a model's residuals: hyperparameters by evidence, needed components, terms.

1. Start with the slower waves of all components that the data allow. Amplitudes, length scales and the noise maximise
   the evidence. Drop amplitudes without signal, and components that fall short by as much as they would need.
2. Weight the readings by the stated uncertainty and the scatter found; fit the remaining components with all waves.
3. Remove components that the evidence does not need, the least needed first, and fit the others again.
4. Turn the rest into smooth terms of the model, which is then fitted jointly with the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.readings_noise import mean_variance
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, fit_terms, uncertainty_with_scatter
from cellapp.estimation.discovery.normal_matrix import NormalMatrix
from cellapp.estimation.discovery.process.components import Component, components
from cellapp.estimation.discovery.process.evidence import (
    NEGLIGIBLE_COLUMN,
    Hyperparameters,
    ProcessData,
    first_guess,
    log_evidence,
    losses,
    most_evident,
)
from cellapp.estimation.discovery.terms import Excess, ModelTerm, ModelTerms, Smoothness
from cellapp.robot.kinematics.transforms import Array

LEAST_READINGS = 40
"""Least number of readings for a process: 120 coordinates for some 20 hyperparameters beside 30 of geometry."""
_FIRST_EVALUATIONS = 40
"""Most evaluations of the evidence with the first weights; it settles to a part in a thousand after some 30."""
_NEXT_EVALUATIONS = 12
"""Most evaluations after a change of weights or components, from the values found before."""
_LEAST_SIGNAL = 0.03
"""Ratio of signal to noise (rms) below which an amplitude is removed at once."""
_SMALLEST = 1e-300
"""Guard for the precision of columns without any variance."""


@dataclass(frozen=True, eq=False)
class StructuredProcess:
    """Components with their hyperparameters, in the complement of a model's parameters.

    Attributes
    ----------
    components : tuple of Component
    values : Hyperparameters
    gram : ProcessData
        Gram matrix of their columns.
    log_evidence : float
    """

    components: tuple[Component, ...]
    values: Hyperparameters
    gram: ProcessData
    log_evidence: float

    @classmethod
    def fitted(
        cls, fit: JointFit, chosen: Sequence[Component], start: Hyperparameters | None, evaluations: int
    ) -> StructuredProcess:
        """Find hyperparameters from ``start``; drop amplitudes that move the SMR by far less than the noise."""
        gram = gathered(fit, chosen)
        begin = first_guess(chosen, gram) if start is None else start
        values, log_evidence = most_evident(chosen, gram, begin, evaluations)
        return cls(tuple(chosen), values, gram, log_evidence).without_idle()

    def without_idle(self) -> StructuredProcess:
        """Return the process without amplitudes whose signal is negligible against the noise."""
        kept_components, amplitudes, lengths, places, first = [], [], [], [], 0
        power = np.diag(self.gram.gram) * self.values.variances(self.components) / self.gram.coordinates
        for number, one in enumerate(self.components):
            here = power[first : first + len(one.columns)]
            signal = np.bincount(one.groups, here, minlength=len(one.amplitude_keys)) / self.values.noise
            kept = np.flatnonzero(signal > _LEAST_SIGNAL**2)
            if len(kept):
                kept_components.append(one.of_amplitudes(kept.tolist()))
                amplitudes.append(self.values.amplitudes[number][kept])
                lengths.append(self.values.lengths[number])
                places.append(first + np.flatnonzero(np.isin(one.groups, kept)))
            first += len(one.columns)
        taken = np.concatenate(places).astype(np.intp) if places else np.zeros(0, dtype=np.intp)
        values = Hyperparameters(tuple(amplitudes), tuple(lengths), self.values.noise)
        return StructuredProcess(tuple(kept_components), values, self.gram.take(taken), self.log_evidence)

    def without(self, component: int) -> StructuredProcess:
        """Return the process without one component, at the hyperparameters of the others."""
        first = sum(len(one.columns) for one in self.components[:component])
        count = len(self.components[component].columns)
        taken = np.delete(np.arange(len(self.gram.moment)), np.s_[first : first + count])
        rest = self.components[:component] + self.components[component + 1 :]
        values, gram = self.values.without(component), self.gram.take(taken)
        return StructuredProcess(rest, values, gram, log_evidence(gram, values.variances(rest), values.noise))

    def without_hopeless(self, needed: float) -> StructuredProcess:
        """Remove components whose gain falls short by as much as they would need to stay, the weakest first."""
        process, gains = self, self.gains()
        while gains and min(gains) <= -needed:
            process = process.without(gains.index(min(gains)))
            gains = process.gains()
        return process

    def refitted(self, evaluations: int) -> StructuredProcess:
        """Fit the hyperparameters again from their present values."""
        values, log_evidence = most_evident(self.components, self.gram, self.values, evaluations)
        return replace(self, values=values, log_evidence=log_evidence)

    def price(self, component: int) -> float:
        """Return the price of the hyperparameters of a component, by the Bayesian information criterion."""
        return self.components[component].hyperparameters * math.log(self.gram.coordinates)

    def gains(self) -> list[float]:
        """Return each component's gain of the score at fixed hyperparameters: twice the log evidence less its price."""
        ends = np.cumsum([len(one.columns) for one in self.components])
        lost = losses(self.gram, self.values.variances(self.components), self.values.noise, ends.tolist())
        return [2.0 * loss - self.price(number) for number, loss in enumerate(lost.tolist())]


def gathered(fit: JointFit, chosen: Sequence[Component]) -> ProcessData:
    """Compute the Gram matrix of the components' columns in the complement of all parameters of a fit."""
    rows = np.concatenate([fit.rows, *(one.rows for one in chosen)])
    normal = NormalMatrix.of(rows, fit.target)
    return ProcessData.behind(normal, len(fit.rows), fit.precision, len(fit.residual))


def fit_process(
    data: ArmData, fit: JointFit, needed: float, candidates: Sequence[Component] | None = None
) -> tuple[StructuredProcess, Excess] | None:
    """Fit the process that residuals need; return it and the scatter beyond the stated uncertainty. None if not needed.

    ``needed`` is the gain of the score at which a component is kept. ``candidates`` are the components to choose from;
    None for all that the data allow.
    """
    if len(data) < LEAST_READINGS:
        return None
    candidates = components(data, fit) if candidates is None else candidates
    if not candidates:
        return None
    screened = StructuredProcess.fitted(fit, [one.coarse() for one in candidates], None, _FIRST_EVALUATIONS)
    screened = screened.without_hopeless(needed)
    if not screened.components:
        return None
    weighed = _weighed(data, fit, screened)
    process = _fitted_anew(weighed, fit, _whole(candidates, screened.components), screened)
    if data.turned is not None:  # the residuals of few waves give poor weights of positions and orientations
        weighed = _weighed(weighed, fit_terms(weighed, fit.terms), process)
        process = _fitted_anew(weighed, fit, process.components, process)
    scatter = _scatter(weighed, process.values.noise)
    process = needed_components(process, needed)
    return (process, scatter) if process.components else None


def _fitted_anew(
    data: ArmData, fit: JointFit, chosen: Sequence[Component], before: StructuredProcess
) -> StructuredProcess:
    """Fit a process again after a change of weights, from the hyperparameters found ``before``."""
    fit = fit_terms(data, fit.terms)
    here = [replace(one, rows=fit.displacements(one.columns)) for one in chosen]
    return StructuredProcess.fitted(fit, here, replace(before.values, noise=1.0), _NEXT_EVALUATIONS)


def _weighed(data: ArmData, fit: JointFit, process: StructuredProcess) -> ArmData:
    """Return the data with weights that include the scatter about a process, beside the fit that it was fitted to."""
    scatter = _scatter(data, process.values.noise)
    if data.turned is not None:
        of_points, of_turns = noise_of_kinds(fit, process, data.turned)
        scatter = Excess(_scatter(data, of_points).m, _scatter(data, of_turns).rad)
    return replace(data, sigma=uncertainty_with_scatter(data, scatter))


def noise_of_kinds(fit: JointFit, process: StructuredProcess, turned: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the variances of positions and of orientations ``turned`` (n,) about a process, relative to the weights.

    The sum of squared residuals of each kind is divided by its coordinates less the parameters that it determines
    (MacKay, Neural Comput. 4 (1992) 415): at the maximum of the evidence this is its noise variance.
    """
    rows = np.concatenate([one.rows for one in process.components])
    noise, projector = process.values.noise, fit.projector
    projected = projector.project(rows)
    A = process.gram.gram / noise + np.diag(1.0 / np.maximum(process.values.variances(process.components), _SMALLEST))
    lower = scipy.linalg.cholesky(A, lower=True, check_finite=False)
    half = scipy.linalg.solve_triangular(lower, projected, lower=True, check_finite=False, overwrite_b=True)
    half /= math.sqrt(noise)
    behind = fit.projected_residual.projected
    left = behind - (half @ behind) @ half
    determined = np.sum(half**2, axis=0) + np.sum(projector.basis**2, axis=1)
    found = []
    for kind in (~turned, turned):
        of_kind = np.tile(kind, 3)
        freedom = max(np.count_nonzero(of_kind) - float(determined[of_kind].sum()), 1.0)
        found.append(float(left[of_kind] @ left[of_kind]) / freedom)
    return found[0], found[1]


def _whole(candidates: Sequence[Component], screened: Sequence[Component]) -> list[Component]:
    """Return the candidates with the amplitudes left by a screening, and with all their waves."""
    found = []
    for one in screened:
        whole = next(other for other in candidates if (other.slug, other.form) == (one.slug, one.form))
        found.append(whole.of_amplitudes([whole.amplitude_keys.index(key) for key in one.amplitude_keys]))
    return found


def needed_components(process: StructuredProcess, needed: float) -> StructuredProcess:
    """Remove the components that the evidence does not need, the least needed first.

    Fitting the others again only raises the evidence without a component: that is done only if it may decide.
    """
    settled = True
    while process.components:
        gains = process.gains()
        weakest = int(np.argmin(gains))
        if gains[weakest] <= needed:
            process, settled = process.without(weakest), False
            continue
        if not settled:
            process, settled = process.refitted(_NEXT_EVALUATIONS), True
            continue
        if gains[weakest] > 2.0 * needed or len(process.components) == 1:
            break
        rest = process.without(weakest).refitted(_NEXT_EVALUATIONS)
        if 2.0 * (process.log_evidence - rest.log_evidence) - process.price(weakest) > needed:
            break
        process = rest
    return process


def process_terms(process: StructuredProcess, scatter: Excess) -> ModelTerms:
    """Return the components as smooth terms of a model, with the columns whose prior matters."""
    terms, first = [], 0
    variances = process.values.variances(process.components)
    power = np.diag(process.gram.gram) * variances / process.values.noise
    gains = process.gains()
    for number, one in enumerate(process.components):
        here = power[first : first + len(one.columns)]
        first += len(one.columns)
        names = tuple(one.columns[k].name for k in np.flatnonzero(here > NEGLIGIBLE_COLUMN))
        law = one.law(process.values.amplitudes[number], process.values.lengths[number])
        terms.append(ModelTerm(one.slug, law, names, Smoothness(gains[number], one.hyperparameters, scatter)))
    return tuple(terms)


def _scatter(data: ArmData, noise: float) -> Excess:
    """Return standard deviations beyond the stated uncertainty, from the noise relative to the weights."""
    if data.turned is None:
        return Excess(_beyond(noise, data.sigma, data.stated))
    kinds = (
        (data.sigma[rows], None if data.stated is None else data.stated[rows]) for rows in (~data.turned, data.turned)
    )
    return Excess(*(_beyond(noise, *kind) for kind in kinds))


def _beyond(noise: float, sigma: Array, stated: Array | None) -> float:
    """Return the standard deviation beyond the stated one of readings with weights from ``sigma``."""
    total = noise * mean_variance(sigma)
    return math.sqrt(max(total - (0.0 if stated is None else mean_variance(stated)), 0.0))
