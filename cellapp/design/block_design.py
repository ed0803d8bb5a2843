"""Choice of n of m candidate blocks of rows (stops of three coordinates each): A- and I-optimal, nearly minimax.

With whitened rows x_i (3, p) of each candidate and prior information P, a design D has the covariance
C = (P + sum_{i in D} x_i^T x_i)^-1. It is judged by

    J(C) = a ln mean_k (s_k / r_k) + b ln mean_j u_j + c ln (mean_j u_j^h)^(1/h),

s_k the standard errors of the wanted parameters and r_k those of a random design of the same size, u_j the standard
uncertainties of predictions at points of the workspace; a high power h stands for the worst point. J is linearised at
a design: dJ = tr(W dC), W positive semidefinite, which is the A- or L-criterion that greedy choice and exchange reduce
(Fedorov, Theory of Optimal Experiments, 1972). Adding a candidate x changes it by

    tr(C W) - tr(C' W) = tr((I + V)^-1 U),    V = x C x^T,    U = x C W C x^T    (both 3 by 3),

removing one by tr((I - V)^-1 U). V and U of all candidates follow each change of the design by products with matrices
of rank three (Woodbury), at a cost of O(p) each; they are computed afresh from time to time against rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cellapp.kinematics.transforms import Array

_WORST_POWER = 12.0


@dataclass(frozen=True)
class DesignErrors:
    """Errors of a design: mean ratio of standard errors, mean and largest uncertainty of predictions."""

    parameters: float
    mean: float
    worst: float


@dataclass(frozen=True, eq=False)
class Criterion:
    """What a design is judged by.

    Attributes
    ----------
    reference : array, shape (k,)
        Standard errors of the first k parameters with a random design.
    points : array, shape (s, 3, p)
        Derivatives of predictions by the parameters.
    shares : (float, float, float)
        Exponents a, b, c of the three errors.
    """

    reference: Array
    points: Array
    shares: tuple[float, float, float] = (1.0, 1.0, 1.0)
    power: float = _WORST_POWER

    def errors(self, covariance: Array) -> DesignErrors:
        parameters, points = self._errors(covariance)
        return DesignErrors(float(np.mean(parameters)), float(np.mean(points)), float(points.max()))

    def value(self, covariance: Array) -> float:
        """J."""
        parameters, points = self._errors(covariance)
        a, b, c = self.shares
        worst = np.log(points.max()) + np.log(np.mean((points / points.max()) ** self.power)) / self.power
        return float(a * np.log(np.mean(parameters)) + b * np.log(np.mean(points)) + c * worst)

    def weights(self, covariance: Array) -> Array:
        """W = dJ / dC (p, p)."""
        parameters, points = self._errors(covariance)
        a, b, c = self.shares
        # d s = dC_kk / (2 s) and d u = tr(F dC F^T) / (2 u)
        W = np.zeros_like(covariance)
        k = len(self.reference)
        of_parameters = a / (2.0 * parameters.sum() * parameters * self.reference**2)
        high = (points / points.max()) ** (self.power - 1.0)
        of_points = (b / points.sum() + c * high / (high @ points)) / (2.0 * points)
        rows = self.points.reshape(-1, len(covariance))
        W = (rows * np.repeat(of_points, 3)[:, None]).T @ rows
        W[np.arange(k), np.arange(k)] += of_parameters
        return W

    def _errors(self, covariance: Array) -> tuple[Array, Array]:
        k = len(self.reference)
        parameters = np.sqrt(np.diag(covariance)[:k]) / self.reference
        rows = self.points.reshape(-1, len(covariance))
        squares = np.einsum("rp,rp->r", rows @ covariance, rows).reshape(-1, 3).sum(axis=1)
        return parameters, np.sqrt(squares)


@dataclass(eq=False)
class Tracked:
    """Some candidates with V and U while the design changes."""

    rows: Array
    variance: Array
    value: Array

    @classmethod
    def of(cls, rows: Array, covariance: Array, weighted: Array) -> Tracked:
        m, _, p = rows.shape
        flat = rows.reshape(-1, p)
        variance = np.matmul((flat @ covariance).reshape(m, 3, p), rows.transpose(0, 2, 1))
        value = np.matmul((flat @ weighted).reshape(m, 3, p), rows.transpose(0, 2, 1))
        return cls(rows, variance.transpose(1, 2, 0).copy(), value.transpose(1, 2, 0).copy())

    def gains(self) -> Array:
        return _trace_solve(self.variance, self.value, 1.0)

    def losses(self) -> Array:
        return _trace_solve(self.variance, self.value, -1.0)

    def update(self, G: Array, H: Array, K: Array, S: Array) -> None:
        """C' = C - G K G^T."""
        m, _, p = self.rows.shape
        both = (self.rows.reshape(-1, p) @ np.concatenate([G, H], axis=1)).reshape(m, 3, 6).transpose(1, 2, 0)
        both = np.ascontiguousarray(both)
        P, Q = both[:, :3], both[:, 3:]
        PK = np.einsum("acm,cd->adm", P, K)
        B = np.einsum("acm,cd->adm", Q, K) - 0.5 * np.einsum("acm,cd->adm", PK, S @ K)
        self.variance -= np.einsum("acm,bcm->abm", PK, P)
        half = np.einsum("acm,bcm->abm", P, B)
        self.value -= half + half.transpose(1, 0, 2)


def _trace_solve(V: Array, U: Array, sign: float) -> Array:
    """tr((I + sign V)^-1 U) of symmetric matrices (3, 3, m)."""
    a, b, c = 1.0 + sign * V[0, 0], sign * V[0, 1], sign * V[0, 2]
    d, e, f = 1.0 + sign * V[1, 1], sign * V[1, 2], 1.0 + sign * V[2, 2]
    A, B, Cc = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * Cc
    total = A * U[0, 0] + (a * f - c * c) * U[1, 1] + (a * d - b * b) * U[2, 2]
    total += 2.0 * (B * U[0, 1] + Cc * U[0, 2] + (b * c - a * e) * U[1, 2])
    return total / det


def inverse(M: Array) -> Array:
    scale = 1.0 / np.sqrt(np.diag(M))
    factor, failed = lapack.dpotrf(M * scale * scale[:, None], lower=1)
    if failed:
        raise np.linalg.LinAlgError
    low = np.tril(lapack.dpotri(factor, lower=1)[0])
    return (low + np.tril(low, -1).T) * scale * scale[:, None]


@dataclass(eq=False)
class Design:
    information: Array
    W: Array
    C: Array = field(init=False)
    A: Array = field(init=False)
    tracked: list[Tracked] = field(default_factory=list)

    def __post_init__(self):
        self.refresh()

    def refresh(self, W=None):
        if W is not None:
            self.W = W
        self.C = inverse(self.information)
        self.A = self.C @ self.W @ self.C
        self.tracked = []

    def track(self, rows):
        t = Tracked.of(rows, self.C, self.A)
        self.tracked.append(t)
        return t

    def change(self, x, sign):
        G, H = self.C @ x.T, self.A @ x.T
        V, S = x @ G, x @ H
        K = sign * np.linalg.inv(np.eye(3) + sign * V)
        for t in self.tracked:
            t.update(G, H, K, S)
        self.information += sign * (x.T @ x)
        GK = G @ K
        HG = H @ GK.T
        self.C -= GK @ G.T
        self.A -= HG + HG.T - GK @ S @ GK.T
