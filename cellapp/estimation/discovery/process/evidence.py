"""Evidence of a structured process from one Gram matrix, its gradient, and the hyperparameters that maximise it.

    y = X w + e,   w_k ~ N(0, v_k(theta)),   e ~ N(0, s I)

y and the columns X are taken in the complement of the nuisance parameters (geometry, named laws). The evidence
(marginal likelihood) follows from ``G = X^T X``, ``b = X^T y`` and ``y^T y`` alone (Rasmussen, Williams, Gaussian
Processes for Machine Learning, 2006, section 5.4, in weight space, section 2.1): its cost does not depend on the number
of readings. Columns whose prior is negligible against the noise are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.discovery.normal_matrix import NormalMatrix
from cellapp.estimation.discovery.process.components import Component
from cellapp.robot.kinematics.transforms import Array

NEGLIGIBLE_COLUMN = 1e-2
"""Ratio of prior signal variance to noise variance below which a column is left out: it would change the log evidence
by half of that. All such columns of a measured arm together change it by less than 0.5."""
_LOG_AMPLITUDE = (-7.0, 5.0)
"""Bounds of the log ratio of an amplitude to its first guess: from a thousandth to 150 times."""
_LOG_NOISE = (-9.0, 0.5)
"""Bounds of the log ratio of the noise variance to that of the data: at most slightly above all of it."""
_START_NOISE = 0.2
"""First guess of the noise's share of the variance."""
_LENGTH_STEP = 1e-4
"""Step of the log length scale for the derivative of its spectrum by forward difference."""
_LEAST_GAIN = 1e-6
"""Relative gain of the evidence at which the optimiser stops: 1e-3 on usual values, far below a score that counts."""
_IMPOSSIBLE = 1e300


@dataclass(frozen=True, eq=False)
class ProcessData:
    """G (m, m), b (m,) and y^T y of the columns of some components in order; d independent coordinates."""

    gram: Array
    moment: Array
    square: float
    coordinates: float

    @classmethod
    def behind(cls, normal: NormalMatrix, flat: int, precision: Array, coordinates: int) -> ProcessData:
        """Eliminate the first ``flat`` columns, with prior precisions (flat,), and keep the others."""
        rest, determined = normal.behind(flat, precision)
        return cls(rest.gram, rest.moment, rest.square, coordinates - determined)

    def take(self, places: NDArray[np.intp]) -> ProcessData:
        """Return the data of some of the columns."""
        return ProcessData(self.gram[np.ix_(places, places)], self.moment[places], self.square, self.coordinates)


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """Amplitudes of each component, its length scale (1 if it has none), and the noise variance s."""

    amplitudes: tuple[Array, ...]
    lengths: tuple[float, ...]
    noise: float

    def without(self, component: int) -> Hyperparameters:
        """Return the hyperparameters of all components but one."""
        return Hyperparameters(
            self.amplitudes[:component] + self.amplitudes[component + 1 :],
            self.lengths[:component] + self.lengths[component + 1 :],
            self.noise,
        )

    def variances(self, components: Sequence[Component]) -> Array:
        """Return the prior variances of all columns."""
        found = [
            one.relative_variances(length) * amplitudes[one.groups] ** 2
            for one, amplitudes, length in zip(components, self.amplitudes, self.lengths, strict=True)
        ]
        return np.concatenate(found) if found else np.zeros(0)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log evidence, and its derivatives with respect to log v_k (m,) and to log s."""

    value: float
    by_variance: Array
    by_noise: float


@dataclass(frozen=True, eq=False)
class _Factored:
    """Indices of the active columns, the roots of their prior variances, and ``I + V^1/2 G V^1/2 / s = L L^T``."""

    active: NDArray[np.intp]
    root: Array
    gram: Array
    lower: Array

    @classmethod
    def of(cls, data: ProcessData, variance: Array, noise: float) -> _Factored | None:
        """Factor the matrix; None if it is not positive definite, as the noise is nearly zero."""
        active = np.flatnonzero(variance * np.diag(data.gram) > NEGLIGIBLE_COLUMN * noise)
        root = np.sqrt(variance[active])
        gram = data.gram if len(active) == len(variance) else data.gram[active].take(active, axis=1)
        A = gram * (root / noise)
        A *= root[:, None]
        A.flat[:: len(A) + 1] += 1.0
        if not len(active):
            return cls(active, root, gram, A)
        # transposed: in the order of LAPACK, without a copy
        lower, failed = scipy.linalg.lapack.dpotrf(A.T, lower=1, overwrite_a=1)
        return None if failed else cls(active, root, gram, lower)

    def value(self, data: ProcessData, noise: float) -> tuple[float, Array]:
        """Return the log evidence, and the solution of ``L L^T x = V^1/2 b / s``."""
        scaled = self.root * data.moment[self.active] / noise
        solution = scipy.linalg.lapack.dpotrs(self.lower, scaled, lower=1)[0] if len(scaled) else scaled
        log_determinant = 2.0 * float(np.log(np.diag(self.lower)).sum())
        left = data.square / noise - float(scaled @ solution)
        return -0.5 * (data.coordinates * math.log(noise) + log_determinant + left), solution


def log_evidence(data: ProcessData, variance: Array, noise: float) -> float:
    """Return the log evidence at prior variances (m,) and a noise variance."""
    factored = _Factored.of(data, variance, noise)
    return -_IMPOSSIBLE if factored is None else factored.value(data, noise)[0]


def evidence(data: ProcessData, variance: Array, noise: float) -> Evidence:
    """Return the evidence at prior variances (m,) and a noise variance, with its derivatives."""
    factored = _Factored.of(data, variance, noise)
    if factored is None:  # this low value makes the optimiser step back
        return Evidence(-_IMPOSSIBLE, np.zeros(len(variance)), 0.0)
    value, solution = factored.value(data, noise)
    active = factored.active
    by_variance = np.zeros(len(variance))
    inverse = np.zeros(0)
    if len(active):
        # single precision is enough for a gradient; zero above the diagonal, like the factor
        triangle = scipy.linalg.lapack.strtri(factored.lower.astype(np.float32), lower=1)[0]
        inverse = np.einsum("kl,kl->l", triangle, triangle).astype(np.float64)
        by_variance[active] = 0.5 * (solution**2 + inverse - 1.0)
    fitted = factored.root * solution
    explained = float(fitted @ data.moment[active])
    left = data.square - 2.0 * explained + float(fitted @ (factored.gram @ fitted))
    by_noise = -0.5 * (data.coordinates - float(np.sum(1.0 - inverse))) + 0.5 * left / noise
    return Evidence(value, by_variance, by_noise)


def losses(data: ProcessData, variance: Array, noise: float, ends: Sequence[int]) -> Array:
    """Return the loss of log evidence (c,) without each of c consecutive groups of columns, which end at ``ends``.

    With x the solution of A x = b for all columns, and C = A^-1, the loss without the group g follows from its blocks:
    ``(ln det C_gg + x_g^T C_gg^-1 x_g) / 2`` (inverse of a partitioned matrix).
    """
    factored = _Factored.of(data, variance, noise)
    if factored is None:
        return np.full(len(ends), math.inf)
    _, solution = factored.value(data, noise)
    inverse = scipy.linalg.lapack.dpotri(factored.lower, lower=1)[0] if len(solution) else factored.lower
    found, first = np.zeros(len(ends)), 0
    for group, end in enumerate(np.searchsorted(factored.active, ends).tolist()):
        if end > first:
            block, x = inverse[first:end, first:end], solution[first:end]
            lower = scipy.linalg.lapack.dpotrf(block, lower=1)[0]
            explained = float(x @ scipy.linalg.lapack.dpotrs(lower, x, lower=1)[0])
            found[group] = float(np.log(np.diag(lower)).sum()) + 0.5 * explained
        first = end
    return found


@dataclass(frozen=True, eq=False)
class _Packing:
    """Conversion of hyperparameters to one vector of logarithms: amplitudes, existing length scales, noise."""

    components: tuple[Component, ...]

    def pack(self, values: Hyperparameters) -> Array:
        amplitudes = [np.log(one) for one in values.amplitudes]
        lengths = [math.log(length) for one, length in zip(self.components, values.lengths, strict=True) if one.lengths]
        return np.concatenate([*amplitudes, np.array([*lengths, math.log(values.noise)])])

    def unpack(self, theta: Array) -> Hyperparameters:
        amplitudes, at = [], 0
        for one in self.components:
            amplitudes.append(np.exp(theta[at : at + len(one.amplitude_keys)]))
            at += len(one.amplitude_keys)
        lengths = []
        for one in self.components:
            lengths.append(math.exp(theta[at]) if one.lengths else 1.0)
            at += 1 if one.lengths else 0
        return Hyperparameters(tuple(amplitudes), tuple(lengths), math.exp(theta[-1]))

    def bounds(self, noise: float) -> list[tuple[float, float]]:
        low, high = _LOG_AMPLITUDE
        starts = [math.log(one.start) for one in self.components for _ in one.amplitude_keys]
        found = [(start + low, start + high) for start in starts]
        found += [(math.log(one.lengths.least), math.log(one.lengths.most)) for one in self.components if one.lengths]
        return [*found, (math.log(noise) + _LOG_NOISE[0], math.log(noise) + _LOG_NOISE[1])]

    def gradient(self, values: Hyperparameters, found: Evidence) -> Array:
        by_amplitude, by_length, at = [], [], 0
        for one, length in zip(self.components, values.lengths, strict=True):
            here = found.by_variance[at : at + len(one.columns)]
            at += len(one.columns)
            by_amplitude.append(2.0 * np.bincount(one.groups, here, minlength=len(one.amplitude_keys)))
            if one.lengths:
                longer = one.relative_variances(length * math.exp(_LENGTH_STEP))
                by_length.append(float(here @ np.log(longer / one.relative_variances(length))) / _LENGTH_STEP)
        return np.concatenate([*by_amplitude, np.array([*by_length, found.by_noise])])


def first_guess(components: Sequence[Component], data: ProcessData) -> Hyperparameters:
    """Return start values of the hyperparameters."""
    return Hyperparameters(
        tuple(np.full(len(one.amplitude_keys), one.start) for one in components),
        tuple(one.lengths.start if one.lengths else 1.0 for one in components),
        _START_NOISE * data.square / data.coordinates,
    )


def most_evident(
    components: Sequence[Component], data: ProcessData, start: Hyperparameters, evaluations: int
) -> tuple[Hyperparameters, float]:
    """Maximise the evidence near ``start``; return the hyperparameters and the log evidence there."""
    packing = _Packing(tuple(components))

    def objective(theta: Array) -> tuple[float, Array]:
        values = packing.unpack(theta)
        found = evidence(data, values.variances(components), values.noise)
        return -found.value, -packing.gradient(values, found)

    bounds = packing.bounds(data.square / data.coordinates)
    low, high = np.array(bounds).T
    found = scipy.optimize.minimize(
        objective,
        np.clip(packing.pack(start), low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxfun": evaluations, "ftol": _LEAST_GAIN},
    )
    return packing.unpack(found.x), -float(found.fun)
