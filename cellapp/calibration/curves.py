"""Free curves of the joint errors: a smooth periodic curve for each joint, known by its prior, found with the geometry.

    dq_j = sum_k A_jk cos(k q_j) + B_jk sin(k q_j),   k = 2 ... K,   A_jk, B_jk ~ N(0, v_jk)
    v_jk proportional to (5 / l_j^2 + k^2)^-3,  sum over all k = a_j^2

which is a Gaussian process on the circle with the spectrum of a Matern-5/2 covariance of length l_j and standard
deviation a_j (Rasmussen, Williams, Gaussian Processes for Machine Learning, 2006, section 4.2). Lengths, amplitudes and
the noise maximise the evidence of the residuals in the complement of the geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize

from cellapp.kinematics.transforms import Array

CYCLES = 100
"""Cycles a turn up to which curves go: 3.6 degrees."""
_MOST_SPECTRUM = 4000
_LENGTHS = (math.radians(1.5), math.radians(20.0))
_START_LENGTH = math.radians(5.0)
_EVALUATIONS = 60


@dataclass(frozen=True)
class Curves:
    """The prior of the curves of some joints, and how well it explains.

    Attributes
    ----------
    joints : tuple of int
        From 0.
    lengths, amplitudes : arrays, shape (len(joints),)
        [rad].
    noise : float
        Factor on the stated uncertainty of the readings.
    evidence : float
        Twice the gain of the logarithm of the evidence over no curve at all with its best noise.
    """

    joints: tuple[int, ...]
    lengths: Array
    amplitudes: Array
    noise: float
    evidence: float

    def without(self, least: float) -> tuple[int, ...]:
        """The joints whose amplitude is at least ``least`` [rad]."""
        return tuple(j for j, a in zip(self.joints, self.amplitudes.tolist(), strict=True) if a >= least)


def variances(length: float, amplitude: float, cycles: int) -> Array:
    """Prior variances (cycles,) [rad^2] of the cosine, and of the sine, of 1 ... ``cycles`` cycles a turn."""
    k = np.arange(1, _MOST_SPECTRUM + 1)
    spectrum = (5.0 / length**2 + k.astype(np.float64) ** 2) ** -3
    return np.asarray(amplitude**2 * spectrum[:cycles] / spectrum.sum())


def waves(q: Array, cycles: int) -> Array:
    """Cosine and sine of 2 ... ``cycles`` times ``q`` (n,), in turns: (2 (cycles - 1), n)."""
    angles = np.arange(2, cycles + 1)[:, None] * q
    return np.stack([np.cos(angles), np.sin(angles)], axis=1).reshape(-1, len(q))


def find_curves(
    q: Array,
    by_joint: Array,
    white: Array,
    basis: Array,
    residual: Array,
    joints: tuple[int, ...],
    cycles: int,
    evaluations: int = _EVALUATIONS,
) -> Curves:
    """The curves' prior of greatest evidence.

    Parameters
    ----------
    q : array, shape (n, N) [rad]
    by_joint : array, shape (3, N, n)
        Derivatives of the SMR position by the joints [m/rad].
    white : array, shape (3, 3, n)
        What whitens each point [1/m].
    basis : array, shape (3 n, k)
        Orthonormal; what geometry and other effects follow.
    residual : array, shape (3 n,)
        Whitened, in the complement of ``basis``.
    joints : tuple of int
        Joints to give a curve, from 0.
    cycles : int
    evaluations : int
        At most so many evaluations of the evidence.
    """
    n = len(q)
    moved = np.einsum("acn,cjn->ajn", white, by_joint[:, list(joints)])
    size = 2 * (cycles - 1)
    design = np.empty((3 * n, size * len(joints)))
    for place, joint in enumerate(joints):
        shape = (moved[:, place, None] * waves(q[:, joint], cycles)).swapaxes(1, 2)
        design[:, place * size : (place + 1) * size] = shape.reshape(3 * n, size)
    share = basis.T @ design
    gram = design.T @ design - share.T @ share
    projection = design.T @ residual
    square, freedom = float(residual @ residual), len(residual) - basis.shape[1]
    start_noise = square / freedom
    typical = math.sqrt(max(start_noise, 1.0) / max(float(np.mean(np.diag(gram))) / n * 2.0, 1e-300))
    count = len(joints)

    def unpack(free: Array) -> tuple[Array, Array, float]:
        return np.exp(free[:count]) * typical, np.exp(free[count : 2 * count]), float(np.exp(free[-1])) * start_noise

    def cost(free: Array) -> tuple[float, Array]:
        amplitudes, lengths, noise = unpack(free)
        prior, slope = [], []
        for amplitude, length in zip(amplitudes.tolist(), lengths.tolist(), strict=True):
            here = np.repeat(variances(length, amplitude, cycles)[1:], 2)
            step = 1e-4
            more = np.repeat(variances(length * math.exp(step), amplitude, cycles)[1:], 2)
            prior.append(here)
            slope.append(np.log(more / here) / step)
        variance = np.concatenate(prior)
        value, by_variance, by_noise = _evidence(gram, projection, square, freedom, variance, noise)
        grouped = by_variance.reshape(count, size)
        gradient = np.concatenate([2.0 * grouped.sum(axis=1), np.sum(grouped * np.array(slope), axis=1), [by_noise]])
        return -value, -gradient

    start = np.concatenate([np.zeros(count), np.full(count, math.log(_START_LENGTH)), [math.log(0.2)]])
    bounds = [(-9.0, 5.0)] * count + [(math.log(_LENGTHS[0]), math.log(_LENGTHS[1]))] * count + [(-9.0, 0.5)]
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxfun": evaluations, "ftol": 1e-7}
    )
    amplitudes, lengths, noise = unpack(found.x)
    without = -0.5 * freedom * (math.log(start_noise) + 1.0)
    return Curves(joints, lengths, amplitudes, math.sqrt(noise), 2.0 * (-float(found.fun) - without))


def _evidence(
    gram: Array, projection: Array, square: float, freedom: int, variance: Array, noise: float
) -> tuple[float, Array, float]:
    """Logarithm of the evidence, its derivatives by the logarithms of each prior variance and of the noise variance."""
    root = np.sqrt(variance)
    A = gram * (root[:, None] * root / noise)
    A[np.diag_indices_from(A)] += 1.0
    factor, failed = lapack.dpotrf(A, lower=1, overwrite_a=1)
    if failed:
        return -1e300, np.zeros_like(variance), 0.0
    log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
    scaled = root * projection / noise
    solution = lapack.dpotrs(factor, scaled, lower=1)[0]
    inverse = np.diag(lapack.dpotri(factor, lower=1)[0])
    explained = float(scaled @ solution) * noise
    value = -0.5 * (freedom * math.log(noise) + log_determinant + (square - explained) / noise)
    by_variance = 0.5 * (solution**2 + inverse - 1.0)
    left = square - 2.0 * explained + float(solution @ (A_times(gram, root, noise, solution))) * noise
    by_noise = -0.5 * (freedom - float(np.sum(1.0 - inverse))) + 0.5 * left / noise
    return value, by_variance, by_noise


def A_times(gram: Array, root: Array, noise: float, vector: Array) -> Array:
    """Explained part's quadratic form: ``root gram root / noise`` times a vector."""
    return np.asarray(root * (gram @ (root * vector)) / noise)


def spread(covariance: Array, points: int) -> Array:
    """Standard deviation of a curve at ``points`` equal steps from -pi to pi, from its coefficients' covariance."""
    around = np.linspace(-math.pi, math.pi, points, endpoint=False)
    shapes = waves(around, len(covariance) // 2 + 1)  # from 2 cycles on, none left out
    return np.asarray(np.sqrt(np.maximum(np.einsum("mp,mk,kp->p", shapes, covariance, shapes, optimize=True), 0.0)))


__all__ = ["CYCLES", "Curves", "NDArray", "find_curves", "spread", "variances", "waves"]
