"""Residuals of the measurement model, their Jacobian and the weighted normal equations.

The model of one reading is ``P_i = f(q_i + sum_j beta_j o_ij; g) + sum_j beta_j s_ij``: geometry g, and effects that
are linear in their parameters beta, each an offset o of a joint or a shift s of the SMR. A measured orientation is a
reading too: its P is zero, f is the rotation vector from the measured to the computed orientation, s a rotation.
Readings are processed in chunks, so that memory does not grow with their number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import ParameterSet, gram_matrix
from cellapp.robot.effects.context import EffectColumn
from cellapp.robot.kinematics.chain import Geometry, JointAngles, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

_CHUNK = 512
"""Configurations per chunk: the Jacobian of one chunk (3 x 40 x 512 floats, 0.5 MB) stays in the cache of a core."""


_LEAST_PRIOR = 1e-9
"""Least standard deviation of a prior, which keeps its precision finite."""


@dataclass(frozen=True)
class EffectColumns:
    """Effects that are linear in their m parameters, each of which offsets a joint or shifts the SMR.

    Attributes
    ----------
    names, units : tuple of str, length m
    of_joints, of_smr : arrays of int, shapes (k,), (m - k,)
        Places of the parameters that offset a joint, and of those that shift the SMR.
    joints : array, shape (k,)
        Index of the joint that each of the former offsets, from 0.
    offsets : array, shape (k, n)
        Joint offset per unit of the parameter [rad].
    shifts_M : array, shape (m - k, 3, n)
        Shift of the SMR per unit of the other parameters, in the tracker frame [m].
    prior_sd : array, shape (m,), or None
        Standard deviation of a zero-mean prior in each parameter's unit, infinite without a prior. If it is given,
        the stated uncertainty of the readings is taken as exact and is not rescaled by their scatter.
    start : array, shape (m,)
        Initial values of the iteration.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    of_joints: NDArray[np.intp]
    of_smr: NDArray[np.intp]
    joints: NDArray[np.intp]
    offsets: Array
    shifts_M: Array
    prior_sd: Array | None
    start: Array

    @classmethod
    def of(cls, columns: Sequence[EffectColumn], n: int, start: Array) -> EffectColumns:
        """Arrange the columns of effects at n readings; the iteration begins at ``start`` (m,)."""
        offset = np.array([column.joint is not None for column in columns], dtype=np.bool_)
        sd = np.array([column.prior_sd for column in columns])
        return cls(
            names=tuple(column.name for column in columns),
            units=tuple(column.unit for column in columns),
            of_joints=np.flatnonzero(offset),
            of_smr=np.flatnonzero(~offset),
            joints=np.array([column.joint for column in columns if column.joint is not None], dtype=np.intp),
            offsets=np.array([column.offset for column in columns if column.joint is not None]).reshape(-1, n),
            shifts_M=np.array([column.shift_M for column in columns if column.joint is None])
            .reshape(-1, n, 3)
            .swapaxes(1, 2),
            prior_sd=np.maximum(sd, _LEAST_PRIOR) if np.isfinite(sd).any() else None,
            start=start,
        )

    def take(self, rows: NDArray[np.intp]) -> EffectColumns:
        """Return the columns at the configurations ``rows``."""
        return replace(self, offsets=self.offsets[:, rows], shifts_M=self.shifts_M[:, :, rows])


@dataclass(frozen=True)
class Observations:
    """Readings in the layout of the kinematics, component first and configurations last.

    Attributes
    ----------
    angles : JointAngles
        Joint positions of the n configurations.
    q : array, shape (n, N)
        Joint positions [rad].
    p_M : array, shape (3, n)
        Measured SMR positions in the tracker frame [m]; zero for a measured orientation, which ``angles`` hold.
    white : array, shape (3, 3, n) or (n,), or None
        Whitening factors (``weights.whitener``); None for equal weights.
    effects : EffectColumns or None
    """

    angles: JointAngles
    q: Array
    p_M: Array
    white: Array | None
    effects: EffectColumns | None

    @cached_property
    def common_white(self) -> float | None:
        """Whitening factor of all coordinates; None if they have different ones."""
        if self.white is None:
            return 1.0
        first = float(self.white.flat[0])
        return first if self.white.ndim == 1 and bool(np.all(self.white == first)) else None

    @property
    def count(self) -> int:
        """Number of readings n."""
        return self.angles.count

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Yield the first configuration of each chunk and the one past its last."""
        for first in range(0, self.count, _CHUNK):
            yield first, min(first + _CHUNK, self.count)

    def angles_with(self, beta: Array, first: int, last: int) -> JointAngles:
        """Return the joint positions of a chunk with the offsets of the effects added."""
        if self.effects is None or not len(self.effects.joints):
            return self.angles.part(first, last)
        q = self.q[first:last].copy()
        joints, offsets = self.effects.joints, self.effects.offsets[:, first:last]
        for joint in np.unique(joints):
            columns = np.flatnonzero(joints == joint)
            q[:, joint] += beta[self.effects.of_joints[columns]] @ offsets[columns]
        R_M_S = self.angles.R_M_S
        return JointAngles.of(q, None if R_M_S is None else R_M_S[first:last])

    def shift(self, beta: Array, first: int, last: int) -> Array | None:
        """Compute the effects' shift of the SMR in a chunk, (3, last - first) [m]; None without such effects."""
        if self.effects is None or not len(self.effects.shifts_M):
            return None
        shifts = self.effects.shifts_M[:, :, first:last]
        return np.asarray(np.tensordot(beta[self.effects.of_smr], shifts, axes=1))

    def residuals(self, P: Array, beta: Array, first: int, last: int) -> Array:
        """Compute a chunk's residuals (3, last - first) [m], measured less computed; ``P`` [m] is without shifts."""
        shift = self.shift(beta, first, last)
        found = self.p_M[:, first:last] - P
        return found if shift is None else found - shift

    def whiten(self, vectors: Array, first: int, last: int) -> Array:
        """Scale vectors (3, ..., last - first) to units of their standard uncertainty.

        Return the vectors themselves if there is no whitening.
        """
        if self.white is None:
            return vectors
        white = self.white[..., first:last]
        if white.ndim == 1:
            return vectors * white
        out = np.empty_like(vectors)
        for row in range(3):  # white is lower triangular
            out[row] = white[row, 0] * vectors[0]
            for column in range(1, row + 1):
                out[row] += white[row, column] * vectors[column]
        return out


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations at one set of parameter values.

    Attributes
    ----------
    A : array, shape (k, k)
        ``sum J^T W J`` over whitened and weighted readings.
    b : array, shape (k,)
        ``sum J^T W r``.
    gram : array, shape (K, K)
        ``sum J^T J`` of the K geometric parameters without whitening and weights.
    cost : float
        ``sum r^T W r``.
    scale : array, shape (k,)
        Rms displacement of the SMR per unit of each parameter, one value for all rotations of the
        geometry [m/rad, m/m]. It scales parameters to metres at arm's length.
    residuals : array, shape (3, n)
        Measured minus computed SMR positions [m], or orientations [rad].
    of_rotations : array, shape (k, k), or None
        Part of ``A`` that measured orientations contribute; None without any.
    """

    A: Array
    b: Array
    gram: Array
    cost: float
    scale: Array
    residuals: Array
    of_rotations: Array | None = None

    @cached_property
    def unit(self) -> Array:
        """Amount (k,) of each parameter that moves the SMR by one metre at arm's length."""
        return 1.0 / self.scale


def split_values(start: Geometry, parameters: ParameterSet, values: Array) -> tuple[Geometry, Array]:
    """Split ``values`` (k,): return the geometry with its identified parameters set, and the effects' values."""
    size = len(parameters.columns)
    return parameters.moved(start, values[:size]), values[size:]


def normal_equations(
    start: Geometry, observations: Observations, parameters: ParameterSet, values: Array, weights: Array | None
) -> NormalEquations:
    """Compute the normal equations at ``values`` (k,) with robust ``weights`` (n,)."""
    geometry, beta = split_values(start, parameters, values)
    k, size = len(values), len(parameters.columns)
    A, b, gram, cost = np.zeros((k, k)), np.zeros(k), np.zeros((size, size)), 0.0
    squares = np.zeros(k)
    residuals = np.empty((3, observations.count))
    angular = observations.angles.angular
    of_rotations = None if angular is None else np.zeros((k, k))
    common = observations.common_white if weights is None else None
    for first, last in observations.chunks():
        P, J = linearise(geometry, observations, parameters, beta, first, last)
        r = residuals[:, first:last] = observations.residuals(P, beta, first, last)
        if common is None:
            gram += gram_matrix(J[:, :size])
            squares[size:] += np.einsum("akn,akn->k", J[:, size:], J[:, size:])
            J, r = observations.whiten(J, first, last), observations.whiten(r, first, last)
            if weights is not None:
                root = np.sqrt(weights[first:last])
                J *= root
                r = r * root
        A += gram_matrix(J)
        if angular is not None and of_rotations is not None:
            of_rotations += gram_matrix(J[:, :, angular[first:last]])
        b += J.swapaxes(0, 1).reshape(k, -1) @ r.ravel()
        cost += float(np.vdot(r, r))
    if common is None:
        squares[:size] = gram.diagonal()
    else:
        gram, squares = A[:size, :size], A.diagonal()
        A, b, cost = A * common**2, b * common**2, cost * common**2
        of_rotations = None if of_rotations is None else of_rotations * common**2
    scale = parameter_scale(squares, observations.count, parameters)
    return NormalEquations(A, b, gram, cost, scale, residuals, of_rotations)


def linearise(
    geometry: Geometry, observations: Observations, parameters: ParameterSet, beta: Array, first: int, last: int
) -> tuple[Array, Array]:
    """Compute SMR positions (3, last - first) [m] and their Jacobian (3, k, last - first) in a chunk."""
    angles, effects = observations.angles_with(beta, first, last), observations.effects
    P, J = parameters.jacobian(geometry, angles)
    if effects is not None:
        _, by_joint = joint_jacobian(geometry, angles)
        size = J.shape[1]
        whole: Array = np.empty((size + len(effects.names), 3, last - first))
        whole[:size] = J.swapaxes(0, 1)
        whole[size + effects.of_joints] = effects.offsets[:, None, first:last] * by_joint.swapaxes(0, 1)[effects.joints]
        whole[size + effects.of_smr] = effects.shifts_M[:, :, first:last]
        J = whole.swapaxes(0, 1)
    return P, J


def parameter_scale(squares: Array, count: int, parameters: ParameterSet) -> Array:
    """Compute ``NormalEquations.scale`` from the sums of squares (k,) of J; 1 for translations of the geometry."""
    mean_square = np.maximum(squares / count, 1e-30)  # a parameter without effect must not divide by zero
    scale = np.ones(len(squares))
    rotations, size = parameters.rotations, len(parameters.columns)
    if rotations:
        scale[:rotations] = math.sqrt(float(mean_square[:rotations].sum()) / rotations)
    scale[size:] = np.sqrt(mean_square[size:])
    return scale
