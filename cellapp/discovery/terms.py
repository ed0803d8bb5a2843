"""Terms of a model under test: which effects, by which laws, with which columns; and where their parameters stand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.curve_prior import MAX_CYCLES, CurvePrior, spectrum_variances
from cellapp.effects import EFFECTS, Effect, EffectColumn, Law
from cellapp.effects.contradiction import ContradictionForm
from cellapp.effects.modulation import Modulation
from cellapp.kinematics.transforms import Array

UNKNOWN = "unknown"
"""Slug of data-driven terms."""
TRANSMISSION_ERROR = "transmission_error"
"""Slug of the effect whose lines a free curve of the joint angle can replace."""
_LEAST_PRIOR = 1e-9
"""Least standard deviation of a curve coefficient [rad]: 1 nm at a metre, which keeps the normal matrix invertible."""


@dataclass(frozen=True)
class ModelTerm:
    """An effect in a model under test.

    Attributes
    ----------
    slug, law
        Effect and law.
    names : tuple of str
        Which of the law's columns.
    curves : CurvePrior, optional
        Prior of free curves of the joint angle.
    free : frozenset of str
        Columns of a free curve without a prior: sharp lines.
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
    curves: CurvePrior | None = None
    free: frozenset[str] = frozenset()
    note: str = ""
    modulations: tuple[Modulation, ...] = ()
    modulation_sd: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Number of its columns: of the law and of its free part."""
        return len(self.names) + len(self.modulations)

    @property
    def has_prior(self) -> bool:
        """Whether some of its columns have a prior."""
        return self.curves is not None or len(self.modulations) > 0

    @property
    def effect(self) -> Effect | None:
        """The effect whose law it has, also where values are impossible; None for what is data-driven."""
        if isinstance(self.law.form, ContradictionForm):
            return self.law.form.effect
        return EFFECTS[self.slug] if self.is_library_effect else None

    @property
    def is_library_effect(self) -> bool:
        """Whether it has a name and a law with few parameters: neither a data-driven term nor free curves."""
        return self.slug != UNKNOWN and self.curves is None

    def prior_sd(self, columns: Sequence[EffectColumn]) -> Array:
        """Standard deviation (m,) of the prior of each of its ``columns``, infinite for those without."""
        sd = np.concatenate([np.full(len(self.names), math.inf), np.array(self.modulation_sd)])
        if self.curves is None:
            return sd
        curves = self.curves
        by_joint: Mapping[int, Array] = {
            joint: np.sqrt(spectrum_variances(length, amplitude, MAX_CYCLES))
            for joint, length, amplitude in zip(
                curves.joints, curves.lengths.tolist(), curves.amplitudes.tolist(), strict=True
            )
        }
        for place, column in enumerate(columns):
            if column.name in self.free or column.cycles is None or column.joint is None:
                continue
            if column.cycles <= MAX_CYCLES and column.joint in by_joint:
                sd[place] = max(float(by_joint[column.joint][column.cycles - 1]), _LEAST_PRIOR)
        return sd


ModelTerms = tuple[ModelTerm, ...]
"""Terms in the order of their parameters."""


def without_term(terms: ModelTerms, term: int) -> ModelTerms:
    """All terms but one."""
    return terms[:term] + terms[term + 1 :]


def with_term(terms: ModelTerms, term: int, instead: ModelTerm) -> ModelTerms:
    """The terms with one replaced."""
    return (*terms[:term], instead, *terms[term + 1 :])


def curve_prior_of(terms: ModelTerms) -> CurvePrior | None:
    """Prior of the free curves among some terms; None without curves. A model has one set of curves at most."""
    return next((term.curves for term in terms if term.curves is not None), None)


def has_curves(terms: ModelTerms) -> bool:
    """Whether some terms hold free curves."""
    return curve_prior_of(terms) is not None


def prior_sd(terms: ModelTerms, columns: Sequence[EffectColumn]) -> Array | None:
    """Standard deviation of the prior of each of the terms' columns, infinite without; None where no term has any."""
    if not any(term.has_prior for term in terms):
        return None
    layout = TermLayout.of(0, [term.size for term in terms])
    return np.concatenate([term.prior_sd(columns[layout.columns(number)]) for number, term in enumerate(terms)])


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
