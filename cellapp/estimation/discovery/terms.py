"""Terms of a model under test: which effects, by which laws, with which columns; and where their parameters stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects import EFFECTS, Effect, EffectColumn, Law
from cellapp.robot.effects.contradiction import BorrowedForm
from cellapp.robot.effects.modulation import Modulation
from cellapp.robot.effects.periodic import TransmissionError
from cellapp.robot.kinematics.transforms import Array

UNKNOWN = "unknown"
"""Slug of data-driven terms."""
TRANSMISSION_ERROR = TransmissionError.slug
"""Slug of the effect whose lines a free curve of the joint angle can replace."""
_LEAST_PRIOR = 1e-9
"""Least standard deviation of a coefficient [rad, m]: 1 nm at a metre, which keeps the normal matrix invertible."""


@dataclass(frozen=True)
class Excess:
    """Standard deviation beyond the stated one of a coordinate [m], and of a component of an orientation [rad]."""

    m: float
    rad: float = 0.0


@dataclass(frozen=True)
class Smoothness:
    """How a smooth term was found.

    Attributes
    ----------
    evidence : float
        Twice the gain of the log evidence by this term.
    hyperparameters : int
        Amplitudes and length scales that were fitted.
    scatter : Excess
        Standard deviation beyond the stated uncertainty that goes with the prior.
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
        Which of the law's columns.
    smooth : Smoothness, optional
        Of a smooth free function, whose columns have priors.
    note : str
        Description of a data-driven term.
    modulations : tuple of Modulation
        Free part of the law: further columns, after those of the law.
    modulation_sd : tuple of float
        Standard deviation of the prior of each of these, in its unit.
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
        """Number of its columns: of the law and of its free part."""
        return len(self.names) + len(self.modulations)

    @property
    def effect(self) -> Effect | None:
        """The effect whose law it has, also without its name; None for what is free or data-driven."""
        if isinstance(self.law.form, BorrowedForm) and self.smooth is None:
            return self.law.form.effect
        return EFFECTS[self.slug] if self.is_library_effect else None

    @property
    def is_library_effect(self) -> bool:
        """Whether it has a name and a law with few parameters: neither a data-driven term nor a smooth function."""
        return self.slug != UNKNOWN and self.smooth is None


ModelTerms = tuple[ModelTerm, ...]
"""Terms in the order of their parameters."""


def without_term(terms: ModelTerms, term: int) -> ModelTerms:
    """All terms but one."""
    return terms[:term] + terms[term + 1 :]


def with_term(terms: ModelTerms, term: int, instead: ModelTerm) -> ModelTerms:
    """The terms with one replaced."""
    return (*terms[:term], instead, *terms[term + 1 :])


def smoothness_of(terms: ModelTerms) -> Smoothness | None:
    """That of the first smooth term; None without one. Smooth terms of one model are found together."""
    return next((term.smooth for term in terms if term.smooth is not None), None)


def has_smooth_terms(terms: ModelTerms) -> bool:
    """Whether some terms are smooth free functions."""
    return smoothness_of(terms) is not None


def prior_sd(columns: Sequence[EffectColumn]) -> Array | None:
    """Standard deviation of the prior of each column, infinite without; None where no column has any."""
    sd = np.array([column.prior_sd for column in columns])
    return np.maximum(sd, _LEAST_PRIOR) if np.isfinite(sd).any() else None


@dataclass(frozen=True)
class TermLayout:
    """Where the parameters of each term stand: first those of the geometry, then the terms in their order.

    Attributes
    ----------
    geometric : int
        Number of geometric parameters.
    ends : tuple of int
        For each term the end of its columns, counted from the first effect column.
    """

    geometric: int
    ends: tuple[int, ...]

    @classmethod
    def of(cls, geometric: int, sizes: Sequence[int]) -> TermLayout:
        """From the number of columns of each term."""
        return cls(geometric, tuple(accumulate(sizes)))

    @property
    def total(self) -> int:
        """Number of all parameters."""
        return self.geometric + (self.ends[-1] if self.ends else 0)

    def columns(self, term: int) -> slice:
        """Places of a term among the effect columns."""
        return slice(self.ends[term - 1] if term else 0, self.ends[term])

    def parameters(self, term: int) -> slice:
        """Places of a term among all parameters."""
        columns = self.columns(term)
        return slice(self.geometric + columns.start, self.geometric + columns.stop)

    def all_but(self, term: int) -> NDArray[np.bool_]:
        """Mask of the parameters that are not of a term."""
        kept = np.ones(self.total, dtype=bool)
        kept[self.parameters(term)] = False
        return kept
