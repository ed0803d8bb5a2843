"""Terms of a model under test: effects, laws, columns, and the indices of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS, Effect, EffectColumn, Law
from cellapp.robot.effects.effect import BorrowedForm
from cellapp.robot.effects.modulation import Modulation
from cellapp.robot.effects.periodic import TransmissionError
from cellapp.robot.kinematics.transforms import Array

UNKNOWN = "unknown"
"""Slug of data-driven terms."""
TRANSMISSION_ERROR = TransmissionError.slug
"""Slug of the effect whose lines a free curve of the joint angle may replace."""
_LEAST_PRIOR = 1e-9
"""Least prior standard deviation of a coefficient [rad, m]: 1 nm at a metre; keeps the normal matrix invertible."""


@dataclass(frozen=True)
class Excess:
    """Noise of readings, estimated with a model.

    Attributes
    ----------
    m, rad : float
        Standard deviation beyond the stated one, of a coordinate [m] and of a component of an orientation [rad].
    joints : tuple of float
        Standard deviation of each joint's position from reading to reading [rad]; empty if not estimated.
    claim : float
        Factor of the stated standard deviations: below one if readings scatter less than they state.
    """

    m: float
    rad: float = 0.0
    joints: tuple[float, ...] = ()
    claim: float = 1.0


@dataclass(frozen=True)
class Smoothness:
    """Evidence and hyperparameters of a smooth term.

    Attributes
    ----------
    evidence : float
        Twice the gain of the log evidence by this term.
    hyperparameters : int
        Number of fitted amplitudes and length scales.
    scatter : Excess
        Standard deviation beyond the stated uncertainty, estimated together with the prior.
    """

    evidence: float
    hyperparameters: int
    scatter: Excess


@dataclass(frozen=True)
class ModelTerm:
    """An effect in a model under test.

    Attributes
    ----------
    slug, law
        Effect and law.
    names : tuple of str
        Names of the law's columns in use.
    smooth : Smoothness, optional
        Set for a smooth free function, whose columns have priors.
    note : str
        Description of a data-driven term.
    modulations : tuple of Modulation
        Free part of the law: further columns, behind those of the law.
    modulation_sd : tuple of float
        Prior standard deviation of each modulation, in its unit.
    """

    slug: str
    law: Law
    names: tuple[str, ...]
    smooth: Smoothness | None = None
    note: str = ""
    modulations: tuple[Modulation, ...] = ()
    modulation_sd: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Number of columns: those of the law and of its free part."""
        return len(self.names) + len(self.modulations)

    @property
    def effect(self) -> Effect | None:
        """The effect whose law the term has, even if unnamed; None for free functions and data-driven terms."""
        if isinstance(self.law.form, BorrowedForm) and self.smooth is None:
            return self.law.form.effect
        return EFFECTS[self.slug] if self.is_library_effect else None

    @property
    def is_library_effect(self) -> bool:
        """Whether the term has a name and a law of few parameters: neither a data-driven term nor a smooth function."""
        return self.slug != UNKNOWN and self.smooth is None


ModelTerms = tuple[ModelTerm, ...]
"""Terms in the order of their parameters."""


def without_term(terms: ModelTerms, term: int) -> ModelTerms:
    """Return all terms but one."""
    return terms[:term] + terms[term + 1 :]


def with_term(terms: ModelTerms, term: int, instead: ModelTerm) -> ModelTerms:
    """Replace one of the terms."""
    return (*terms[:term], instead, *terms[term + 1 :])


def smoothness_of(terms: ModelTerms) -> Smoothness | None:
    """Return the smoothness of the first smooth term; None if none. Those of one model are found together."""
    return next((term.smooth for term in terms if term.smooth is not None), None)


def has_smooth_terms(terms: ModelTerms) -> bool:
    """Return whether any term is a smooth free function."""
    return smoothness_of(terms) is not None


def prior_sd(columns: Sequence[EffectColumn]) -> Array | None:
    """Return the prior standard deviation of each column, infinite without a prior; None if no column has a prior."""
    sd = np.array([column.prior_sd for column in columns])
    return np.maximum(sd, _LEAST_PRIOR) if np.isfinite(sd).any() else None


@dataclass(frozen=True)
class TermLayout:
    """Indices of the parameters of each term: those of the geometry first, then the terms in order.

    Attributes
    ----------
    geometric : int
        Number of geometric parameters.
    ends : tuple of int
        End of the columns of each term, counted from the first effect column.
    """

    geometric: int
    ends: tuple[int, ...]

    @classmethod
    def of(cls, geometric: int, sizes: Sequence[int]) -> TermLayout:
        """Build the layout from the number of columns of each term."""
        return cls(geometric, tuple(accumulate(sizes)))

    @property
    def total(self) -> int:
        """Number of all parameters."""
        return self.geometric + (self.ends[-1] if self.ends else 0)

    def columns(self, term: int) -> slice:
        """Return the slice of a term among the effect columns."""
        return slice(self.ends[term - 1] if term else 0, self.ends[term])

    def parameters(self, term: int) -> slice:
        """Return the slice of a term among all parameters."""
        columns = self.columns(term)
        return slice(self.geometric + columns.start, self.geometric + columns.stop)

    def all_but(self, term: int) -> NDArray[np.bool_]:
        """Return a mask of all parameters except those of a term."""
        kept = np.ones(self.total, dtype=bool)
        kept[self.parameters(term)] = False
        return kept


# -- Candidate laws: an effect's law on the data at hand, with the whitened SMR displacement of each parameter --------

BOUND_ERRORS = 4.0
"""Standard errors by which a value may exceed its physical bound: by chance one in 30 000 does. The estimate of a joint
that an effect hardly loads is often negative."""

Block = tuple[int, ...]
"""Indices of the columns of one block, which enter a model together."""


@dataclass(frozen=True, eq=False)
class CandidateLaw:
    """A law of an effect: its columns and their whitened displacements ``rows`` (m, d)."""

    slug: str
    law: Law
    columns: tuple[EffectColumn, ...]
    rows: Array

    @cached_property
    def blocks(self) -> list[Block]:
        """Columns of each block."""
        found = grouped((column.block, place) for place, column in enumerate(self.columns))
        return [tuple(places) for places in found.values()]

    def refines(self, block: Sequence[int]) -> bool:
        """Return whether a block only refines others and is no effect alone."""
        return self.columns[block[0]].refines

    def keep(self, places: Sequence[int]) -> CandidateLaw:
        """Return the law with some of its columns only."""
        chosen = list(places)
        return CandidateLaw(self.slug, self.law, tuple(self.columns[k] for k in chosen), self.rows[chosen])


@dataclass(frozen=True)
class LawScore:
    """Score of a law on a residual.

    Attributes
    ----------
    candidate : CandidateLaw
    value : float
        Gain of the BIC less the price of choosing the law.
    chosen : tuple of int
        Indices of the needed columns.
    explained_share : float
        R^2.
    """

    candidate: CandidateLaw
    value: float
    chosen: tuple[int, ...]
    explained_share: float

    @property
    def slug(self) -> str:
        """The effect."""
        return self.candidate.slug

    @property
    def key(self) -> tuple[str, str]:
        """Effect and law."""
        return self.candidate.slug, self.candidate.law.name

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the needed columns."""
        return tuple(self.candidate.columns[place].name for place in self.chosen)

    @property
    def rows(self) -> Array:
        """Whitened displacements of the needed columns."""
        return self.candidate.rows[list(self.chosen)]


def blocks_beyond_bounds(columns: Sequence[EffectColumn], values: Array, errors: Array) -> set[str]:
    """Return the blocks with a value (m,) outside its column's bounds by more than its standard error (m,) allows."""
    return {
        column.block
        for column, value, error in zip(columns, values.tolist(), errors.tolist(), strict=True)
        if not column.lower - BOUND_ERRORS * error <= value <= column.upper + BOUND_ERRORS * error
    }


def whitened_displacements(columns: Sequence[EffectColumn], by_joint: Array, white: Array) -> Array:
    """Compute whitened SMR displacements (m, 3 n) per unit of each column's parameter.

    Parameters
    ----------
    columns : sequence of EffectColumn, length m
    by_joint : array, shape (3, N, n)
        Derivatives of the SMR position with respect to the joint angles, WHITENED [1/rad].
    white : array, shape (3, 3, n)
        Whitening of each point [1/m].
    """
    n = white.shape[2]
    offsets = np.array([one.offset for one in columns if one.offset is not None])
    joints: NDArray[np.intp] = np.array([one.index for one in columns if one.offset is not None], dtype=np.intp)
    of_joints = np.take(by_joint.swapaxes(0, 1), joints, axis=0)
    if len(joints):
        of_joints *= offsets[:, None]
    if len(joints) == len(columns):
        return np.asarray(of_joints.reshape(len(columns), 3 * n))
    rows = np.empty((len(columns), 3, n))
    offset = np.array([one.offset is not None for one in columns])
    rows[offset] = of_joints
    shifts = np.array([one.shift_M for one in columns if one.offset is None])
    rows[~offset] = np.einsum("acn,mnc->man", white, shifts)
    return rows.reshape(len(columns), 3 * n)
