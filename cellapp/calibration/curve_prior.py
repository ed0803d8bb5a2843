"""Smooth periodic joint-error curves: a Gaussian-process prior for each joint, its parameters by maximum evidence.

    dq_j = sum_k A_jk cos(k q_j) + B_jk sin(k q_j),   k = 2 ... K,   A_jk, B_jk ~ N(0, v_jk)
    v_jk proportional to (5 / l_j^2 + k^2)^-3,  sum over all k = a_j^2

The spectrum is that of a Matern-5/2 covariance on the circle with length scale l_j and standard deviation a_j
(Rasmussen, Williams, Gaussian Processes for Machine Learning, 2006, section 4.2). One cycle a turn is left out: it is
an encoder eccentricity. Length scales, amplitudes and the noise maximise the evidence (marginal likelihood, ibid.
section 5.4) of the residuals in the complement of the other parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from cellapp.kinematics.transforms import Array

MAX_CYCLES = 100
"""Highest cycle count of a curve: a period of 3.6 degrees, below the shortest length scale that is tried."""
_SPECTRUM_CYCLES = 4000
"""Cycle counts over which the spectrum is normalised. Even at the shortest length scale less than 1e-8 is beyond."""
_LENGTH_BOUNDS = (math.radians(1.5), math.radians(20.0))
"""Length scales [rad]: below half the shortest period; beyond 20 degrees a few harmonics describe a curve."""
_START_LENGTH = math.radians(5.0)
"""First guess of a length scale [rad]: near the geometric mean of its bounds."""
_START_NOISE_SHARE = 0.2
"""First guess of the share of the residual's variance that is noise; curves are tried where they dominate."""
_LOG_BOUNDS = (-9.0, 5.0)
"""Bounds of the logarithm of an amplitude over the typical one: from 1e-4 (no curve) to 150."""
_LOG_NOISE_BOUNDS = (-9.0, 0.5)
"""Bounds of the logarithm of the noise variance over the residual's: at most slightly above all of it."""
_EVALUATIONS = 60
"""Default limit on evaluations of the evidence; on the readings of the real UR10 it converges after some 25."""
_LOG_LENGTH_STEP = 1e-4
"""Step of the logarithm of a length scale for the derivative of the spectrum by forward difference."""
_LEAST_GAIN = 1e-7
"""Relative gain of the evidence at which the optimiser stops: 1e-3 on typical values, far below a score that counts."""


@dataclass(frozen=True)
class CurvePrior:
    """Prior of the error curves of some joints.

    Attributes
    ----------
    joints : tuple of int
        From 0.
    lengths, amplitudes : arrays, shape (len(joints),)
        Length scale and standard deviation of each curve [rad].
    noise : float
        Factor on the stated uncertainty of the readings.
    evidence : float
        Twice the gain of the log evidence over a model without curves and with its best noise.
    """

    joints: tuple[int, ...]
    lengths: Array
    amplitudes: Array
    noise: float
    evidence: float


def spectrum_variances(length: float, amplitude: float, cycles: int) -> Array:
    """Prior variances (cycles,) [rad^2] of the cosine, and of the sine, of 1 ... ``cycles`` cycles a turn."""
    k = np.arange(1, _SPECTRUM_CYCLES + 1)
    spectrum = (5.0 / length**2 + k.astype(np.float64) ** 2) ** -3
    return np.asarray(amplitude**2 * spectrum[:cycles] / spectrum.sum())


def harmonics(q: Array, cycles: int) -> Array:
    """Cosine and sine of 2 ... ``cycles`` times ``q`` (n,), alternating: (2 (cycles - 1), n)."""
    angles = np.arange(2, cycles + 1)[:, None] * q
    return np.stack([np.cos(angles), np.sin(angles)], axis=1).reshape(-1, len(q))


def fit_curve_prior(
    q: Array,
    by_joint: Array,
    white: Array,
    basis: Array,
    residual: Array,
    joints: tuple[int, ...],
    cycles: int,
    evaluations: int = _EVALUATIONS,
) -> CurvePrior:
    """Find the prior of greatest evidence.

    Parameters
    ----------
    q : array, shape (n, N)
        Joint positions [rad].
    by_joint : array, shape (3, N, n)
        Derivatives of the SMR position by the joints [m/rad].
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    basis : array, shape (3 n, k)
        Orthonormal basis of what geometry and the other effects can explain.
    residual : array, shape (3 n,)
        Whitened residual, projected onto the complement of ``basis``.
    joints : tuple of int
        Joints that get a curve, from 0.
    cycles : int
        Highest cycle count.
    evaluations : int
        Limit on evaluations of the evidence.
    """
    design = _curve_design(q, by_joint, white, joints, cycles)
    explained = basis.T @ design
    gram = design.T @ design - explained.T @ explained
    problem = _Evidence(gram, design.T @ residual, float(residual @ residual), len(residual) - basis.shape[1])
    per_reading = max(float(np.mean(np.diag(gram))) / len(q) * 2.0, 1e-300)
    typical = math.sqrt(max(problem.square / problem.freedom, 1.0) / per_reading)
    return _most_evident_prior(problem, joints, typical, cycles, evaluations)


def _most_evident_prior(
    problem: _Evidence, joints: tuple[int, ...], typical: float, cycles: int, evaluations: int
) -> CurvePrior:
    """Maximise the evidence by L-BFGS over log amplitudes (about ``typical`` [rad]), log length scales, log noise."""
    count, variance = len(joints), problem.square / problem.freedom

    def unpack(free: Array) -> tuple[Array, Array, float]:
        return np.exp(free[:count]) * typical, np.exp(free[count : 2 * count]), float(np.exp(free[-1])) * variance

    def cost(free: Array) -> tuple[float, Array]:
        value, gradient = problem.by_parameters(*unpack(free), cycles)
        return -value, -gradient

    log_lengths = (math.log(_LENGTH_BOUNDS[0]), math.log(_LENGTH_BOUNDS[1]))
    found = minimize(
        cost,
        np.concatenate([np.zeros(count), np.full(count, math.log(_START_LENGTH)), [math.log(_START_NOISE_SHARE)]]),
        jac=True,
        method="L-BFGS-B",
        bounds=[_LOG_BOUNDS] * count + [log_lengths] * count + [_LOG_NOISE_BOUNDS],
        options={"maxfun": evaluations, "ftol": _LEAST_GAIN},
    )
    amplitudes, lengths, noise = unpack(found.x)
    without_curves = -0.5 * problem.freedom * (math.log(variance) + 1.0)
    return CurvePrior(joints, lengths, amplitudes, math.sqrt(noise), 2.0 * (-float(found.fun) - without_curves))


def _curve_design(q: Array, by_joint: Array, white: Array, joints: tuple[int, ...], cycles: int) -> Array:
    """Whitened columns (3 n, 2 (cycles - 1) len(joints)) of all curve coefficients, joint by joint."""
    moved = np.einsum("acn,cjn->ajn", white, by_joint[:, list(joints)])
    size = 2 * (cycles - 1)
    design = np.empty((3 * len(q), size * len(joints)))
    for place, joint in enumerate(joints):
        columns = (moved[:, place, None] * harmonics(q[:, joint], cycles)).swapaxes(1, 2)
        design[:, place * size : (place + 1) * size] = columns.reshape(3 * len(q), size)
    return design


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Log evidence of a projected residual r under ``r = X c + e``, ``c ~ N(0, diag(v))``, ``e ~ N(0, s I)``.

    ``gram`` is X^T X and ``moment`` X^T r in the complement of the other parameters, ``square`` r^T r, ``freedom`` the
    dimension of that complement.
    """

    gram: Array
    moment: Array
    square: float
    freedom: int

    def by_parameters(self, amplitudes: Array, lengths: Array, noise: float, cycles: int) -> tuple[float, Array]:
        """Value and gradient by the logarithms of amplitudes, length scales and noise variance."""
        variances, slopes = [], []
        for amplitude, length in zip(amplitudes.tolist(), lengths.tolist(), strict=True):
            here = np.repeat(spectrum_variances(length, amplitude, cycles)[1:], 2)
            longer = np.repeat(spectrum_variances(length * math.exp(_LOG_LENGTH_STEP), amplitude, cycles)[1:], 2)
            variances.append(here)
            slopes.append(np.log(longer / here) / _LOG_LENGTH_STEP)
        value, by_variance, by_noise = self.by_variances(np.concatenate(variances), noise)
        grouped = by_variance.reshape(len(amplitudes), -1)
        by_amplitude = 2.0 * grouped.sum(axis=1)
        return value, np.concatenate([by_amplitude, np.sum(grouped * np.array(slopes), axis=1), [by_noise]])

    def by_variances(self, variance: Array, noise: float) -> tuple[float, Array, float]:
        """Value and derivatives by the logarithms of each prior variance and of the noise variance."""
        root = np.sqrt(variance)
        A = self.gram * (root[:, None] * root / noise)
        A[np.diag_indices_from(A)] += 1.0
        factor, failed = lapack.dpotrf(A, lower=1, overwrite_a=1)
        if failed:  # the noise is nearly zero here: so low a value makes the optimiser step back
            return -1e300, np.zeros_like(variance), 0.0
        log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
        scaled = root * self.moment / noise
        solution = lapack.dpotrs(factor, scaled, lower=1)[0]
        inverse_diagonal = np.diag(lapack.dpotri(factor, lower=1)[0])
        explained = float(scaled @ solution) * noise
        value = -0.5 * (self.freedom * math.log(noise) + log_determinant + (self.square - explained) / noise)
        by_variance = 0.5 * (solution**2 + inverse_diagonal - 1.0)
        fitted = root * solution
        left = self.square - 2.0 * explained + float(fitted @ (self.gram @ fitted))
        by_noise = -0.5 * (self.freedom - float(np.sum(1.0 - inverse_diagonal))) + 0.5 * left / noise
        return value, by_variance, by_noise


def curve_standard_deviation(covariance: Array, points: int) -> Array:
    """Standard deviation [rad] of a curve at ``points`` equal steps from -pi to pi.

    ``covariance`` (2 (K - 1), 2 (K - 1)) [rad^2] is that of its coefficients from 2 to K cycles a turn.
    """
    around = np.linspace(-math.pi, math.pi, points, endpoint=False)
    shapes = harmonics(around, len(covariance) // 2 + 1)
    return np.asarray(np.sqrt(np.maximum(np.einsum("mp,mk,kp->p", shapes, covariance, shapes, optimize=True), 0.0)))
