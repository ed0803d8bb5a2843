"""Uncertainty of predictions from draws of all fitted parameters about their estimate.

The posterior of geometry and effects is close to normal, but with smooth functions its covariance has a million
entries. S draws of the parameters keep all correlations and give the standard deviation of any prediction with a
relative error of 1 / sqrt(2 S): 9 % with 64. With up to S parameters the draws are made orthogonal, so that their
second moment is exactly the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects import EFFECTS, EffectColumn, EffectContext, EffectTerm
from cellapp.robot.effects.modulation import with_modulations
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.transforms import Array

DRAWS = 64
_DIGITS = 4
"""Significant digits of a draw in JSON: more than enough, as the scatter is known to one digit."""


class ReadingsNoise(NamedTuple):
    """Standard deviations of measured coordinates about the true predictions.

    ``m`` is that of a coordinate [m], ``rad`` that of a component of an orientation [rad], None if none was measured.
    ``axes_rad`` (3,) are those about the three axes in ascending order if they differ, as with several SMRs on a
    flange; else None.
    """

    m: float
    rad: float | None = None
    axes_rad: Array | None = None


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Deviations of the fitted parameters from their estimate in S draws, and the scatter of the readings.

    Attributes
    ----------
    columns : tuple of int, length K
        Geometric parameters, as indices into ``parameter_names``.
    geometry : array, shape (S, K)
        Deviations of the geometric parameters, in their units.
    terms : tuple of array, shape (S, m)
        Deviations of the parameters of each term of the model, in the order of the term's names.
    noise_m, noise_rad, noise_axes_rad
        See ``ReadingsNoise``.
    """

    columns: tuple[int, ...]
    geometry: Array
    terms: tuple[Array, ...]
    noise_m: float
    noise_rad: float | None = None
    noise_axes_rad: Array | None = None

    @classmethod
    def of_covariance(
        cls,
        columns: tuple[int, ...],
        sizes: Sequence[int],
        covariance: Array,
        noise: ReadingsNoise,
        seed: Sequence[int],
    ) -> PosteriorDraws:
        """Draw from ``covariance`` (p, p) of K geometric parameters and of terms with ``sizes`` parameters."""
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        values, vectors = np.linalg.eigh(covariance / scale / scale[:, None])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(seed).standard_normal((DRAWS, len(scale)))
        if len(scale) <= DRAWS:
            normal = math.sqrt(DRAWS) * np.linalg.qr(normal)[0]
        drawn = (normal @ root.T) * scale
        ends = np.cumsum([len(columns), *sizes])
        parts = np.split(drawn, ends[:-1], axis=1)
        return cls(columns, parts[0], tuple(parts[1:]), *noise)

    def of_columns(self, end: int) -> PosteriorDraws:
        """Keep the draws of geometric parameters before ``end`` and of all terms; drop the noise of orientations."""
        kept = [place for place, column in enumerate(self.columns) if column < end]
        columns = tuple(self.columns[place] for place in kept)
        return replace(self, columns=columns, geometry=self.geometry[:, kept], noise_rad=None, noise_axes_rad=None)

    def displacements(self, geometry: Geometry, terms: Sequence[EffectTerm], context: EffectContext) -> Array:
        """Compute deviations (S, n, 3) of SMR [m] or orientation [rad] from the prediction, to first order."""
        by_geometry, by_terms = self.displacements_by_part(geometry, terms, context)
        return by_geometry + by_terms

    def displacements_by_part(
        self, geometry: Geometry, terms: Sequence[EffectTerm], context: EffectContext
    ) -> tuple[Array, Array]:
        """Compute deviations (S, n, 3) [m] of the SMR by geometric parameters and by terms; their sum is the total."""
        angles = JointAngles.of(context.q, context.conditions.R_M_S)
        _, J = jacobian(geometry, angles, self.columns)
        _, by_joint = joint_jacobian(geometry, angles)
        by_geometry = np.einsum("sk,ckn->snc", self.geometry, J, optimize=True)
        moved = np.zeros_like(by_geometry)
        joints = np.zeros((len(self.geometry), *context.q.shape))
        for term, drawn in zip(terms, self.terms, strict=True):
            _add(joints, moved, _columns(term, context), drawn)
        moved += np.einsum("snj,cjn->snc", joints, by_joint, optimize=True)
        return np.asarray(by_geometry), moved

    def joint_offsets(self, terms: Sequence[EffectTerm], context: EffectContext) -> Array:
        """Compute deviations (T, S, n, N) [rad] of the joint offsets by each of the T terms."""
        joints = np.zeros((len(terms), len(self.geometry), *context.q.shape))
        moved = np.zeros((*joints.shape[1:3], 3))  # shifts of the SMR are not needed
        for own, term, drawn in zip(joints, terms, self.terms, strict=True):
            _add(own, moved, _columns(term, context), drawn)
        return joints


def _columns(term: EffectTerm, context: EffectContext) -> list[EffectColumn]:
    """Return the columns of a term in the order of its parameters."""
    of_law = EFFECTS[term.slug].columns(context, term.law, frozenset(term.law_names))
    by_name = {column.name: column for column in with_modulations(of_law, term.modulations, context)}
    return [by_name[name] for name in term.names]


def _add(joints: Array, moved: Array, columns: Sequence[EffectColumn], drawn: Array) -> None:
    """Add joint offsets (S, n, N) and shifts (S, n, 3) of columns with drawn values (S, m)."""
    by_joint: dict[int, list[int]] = {}
    shifting: NDArray[np.intp] = np.array([k for k, one in enumerate(columns) if one.joint is None], dtype=np.intp)
    for k, column in enumerate(columns):
        if column.joint is not None:
            by_joint.setdefault(column.joint, []).append(k)
    for joint, own in by_joint.items():
        joints[:, :, joint] += drawn[:, own] @ np.array([columns[k].offset for k in own])
    if len(shifting):
        shifts = np.array([columns[k].shift_M for k in shifting])
        moved += np.tensordot(drawn[:, shifting], shifts, axes=1)


def posterior_to_json(posterior: PosteriorDraws) -> dict[str, Any]:
    """Convert draws to a JSON object, rounded."""
    return {
        "columns": list(posterior.columns),
        "geometry": _rounded(posterior.geometry),
        "terms": [_rounded(one) for one in posterior.terms],
        "noise_m": posterior.noise_m,
        **({} if posterior.noise_rad is None else {"noise_rad": posterior.noise_rad}),
        **({} if posterior.noise_axes_rad is None else {"noise_axes_rad": posterior.noise_axes_rad.tolist()}),
    }


def posterior_from_json(content: Mapping[str, Any]) -> PosteriorDraws:
    """Parse an object from ``posterior_to_json``."""
    geometry = np.array(content["geometry"], dtype=np.float64)
    terms = tuple(np.array(one, dtype=np.float64).reshape(len(geometry), -1) for one in content["terms"])
    noise_rad = float(content["noise_rad"]) if "noise_rad" in content else None
    axes = np.array(content["noise_axes_rad"], dtype=np.float64) if "noise_axes_rad" in content else None
    return PosteriorDraws(tuple(content["columns"]), geometry, terms, float(content["noise_m"]), noise_rad, axes)


def _rounded(values: Array) -> list[list[float]]:
    return [[float(f"{value:.{_DIGITS}g}") for value in row] for row in values.tolist()]
