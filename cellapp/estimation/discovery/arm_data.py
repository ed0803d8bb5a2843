"""Readings of one arm for discovery, and the terms of a model under test: effects, laws, columns, parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import identify_with_excess
from cellapp.estimation.calibration.least_squares import whitener, with_excess
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import ArmReadings, Quantities
from cellapp.estimation.readings.readings import Groups, repeats, undivided
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, Effect, EffectColumn, EffectContext, InputVariable, Law
from cellapp.robot.effects.effect import BorrowedForm
from cellapp.robot.effects.law import with_prior_sd
from cellapp.robot.effects.modulation import Modulation, with_modulations
from cellapp.robot.effects.periodic import TransmissionError
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

# -- Terms of a model -------------------------------------------------------------------------------------------------


UNKNOWN = "unknown"
"""Slug of data-driven terms."""
TRANSMISSION_ERROR = TransmissionError.slug
"""Slug of the effect whose lines a free curve of the joint angle may replace."""


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
        Discrepancy term of the law: further columns, behind those of the law.
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
        """Number of columns: those of the law and of its discrepancy term."""
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


# -- Readings of one arm ----------------------------------------------------------------------------------------------


TOLERANCE = 1e-6
"""Step [m at arm's length] at which a fit ends: a twentieth of a tracker's resolution."""
LEAST_SCATTER_M = 1e-7
"""Least scatter of any instrument [m]; the weights of readings computed without noise would be singular by rounding."""


@dataclass(frozen=True, eq=False)
class ArmData(Quantities):
    """Measured vectors of one arm, with the weights in use, for a search.

    The parameter set is selected once. If each joint fit selected it again, an effect could make redundant directions
    appear identifiable.

    Attributes
    ----------
    profile, model
        ``model`` has geometry only.
    parameter_set : ParameterSet
        Geometric parameters that are fitted.
    prior_sigma : mapping
        Standard deviations of their priors [m, rad], about nominal.
    start : mapping
        Values of an earlier fit, by effect and column, as a start of the next fit.
    true_q : array, shape (n, N), or None
        Joint positions with the offsets of known effects [rad]; None means the controller's positions.
    cache : dict
        Computed columns by effect, law and names (None for all names).
    """

    profile: Profile
    model: ArmModel
    parameter_set: ParameterSet
    prior_sigma: Mapping[str, float]
    start: Mapping[tuple[str, str], float] = field(default_factory=dict)
    true_q: Array | None = None
    cache: dict[tuple[str, str, tuple[str, ...] | None], list[EffectColumn]] = field(default_factory=dict)

    @classmethod
    def of(cls, arm: ArmReadings, prior_sigma: Mapping[str, float] | None = None) -> ArmData:
        """Set the weights from the stated uncertainty, and select the geometric parameters.

        ``prior_sigma`` [m, rad] replaces the profile's, about ``robot.model.nominal``.
        """
        profile, model, its = arm.profile, arm.model, arm.quantities()
        settings = profile.calibration
        readings, stated = its.readings, its.stated
        found, excess_m = identify_with_excess(
            model.nominal,
            its,
            parameter_set=settings.parameter_set,
            prior_sigma=prior_sigmas(model.nominal, settings.priors) if prior_sigma is None else prior_sigma,
            tolerance=TOLERANCE,
            tool_unknown=True,
        )
        sigma = np.full(len(readings), max(found.scale, LEAST_SCATTER_M)) if stated is None else stated
        if stated is not None and its.angular is not None:
            sigma = with_excess(stated, excess_m**2, its.angular, found.excess_rad**2)
        geometry_only = replace(model, effects=(), network=None, geometry=found.geometry)
        own: dict[str, Any] = {"parameter_set": found.estimated, "prior_sigma": found.prior_sigma}
        return cls(**{**vars(its), "sigma": sigma}, profile=profile, model=geometry_only, **own)

    @cached_property
    def group(self) -> Groups:
        """Group (n,) of the rows that are one configuration: position and orientation of a reading, and its repeats."""
        return repeats(self.readings.q)

    @cached_property
    def undivided(self) -> Groups:
        """Group (n,) of the rows that no fold divides: configurations, or neighbourhoods if most rows have one."""
        return undivided(self.readings.q)

    @cached_property
    def context(self) -> EffectContext:
        """Quantities that effects depend on, at the geometry of ``model``."""
        return replace(self.model.context(self.readings.q, conditions=self.conditions), q_actual=self.true_q)

    def at(self, model: ArmModel) -> ArmData:
        """Return the same readings, with effects at the geometry and the true joint positions of ``model``."""
        true_q = model.true_joints(self.readings.q, conditions=self.conditions) if model.effects else None
        kept = {key: columns for key, columns in self.cache.items() if _depends_on_angles_only(key[0], columns)}
        here = replace(self, model=replace(model, effects=(), network=None), true_q=true_q, cache=kept)
        return here.beginning_at(model)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> ArmData:
        """Return some of the rows."""
        return replace(super().take(rows), true_q=None if self.true_q is None else self.true_q[rows], cache={})

    def claiming(self, factor: float) -> ArmData:
        """Return the same data with the stated uncertainty of positions times a factor."""
        if self.stated is None or factor == 1.0:
            return self
        factors = np.full(len(self), factor) if self.angular is None else np.where(self.angular, 1.0, factor)
        stated = self.stated * (factors if self.stated.ndim == 1 else factors[:, None, None] ** 2)
        return replace(self, stated=stated, sigma=stated)

    def beginning_at(self, model: ArmModel) -> ArmData:
        """Return the same data; the next fit starts from the effects' values in ``model``."""
        values = {
            (term.slug, name): value
            for term in model.effects
            for name, value in zip(term.names, term.values.tolist(), strict=True)
        }
        return replace(self, start=values)

    def columns(self, slug: str, law: Law, names: Sequence[str] | None = None) -> list[EffectColumn]:
        """Return the columns of a law, all or those of ``names`` in that order."""
        described = f"{law.name} {sorted(law.constants.items())}"
        key = (slug, described, None if names is None else tuple(names))
        if key not in self.cache:
            if names is None:
                self.cache[key] = EFFECTS[slug].columns(self.context, law)
            else:
                whole = self.cache.get((slug, described, None))
                some = whole or EFFECTS[slug].columns(self.context, law, frozenset(names))
                by_name = {column.name: column for column in some}
                self.cache[key] = [by_name[name] for name in names]
        return self.cache[key]

    def term_columns(self, terms: ModelTerms) -> tuple[EffectColumn, ...]:
        """Return the columns of the terms in order: for each those of the law, then those of its discrepancy term."""
        found: list[EffectColumn] = []
        for term in terms:
            columns = with_modulations(self.columns(term.slug, term.law, term.names), term.modulations, self.context)
            found += columns[: len(term.names)]
            found += map(with_prior_sd, columns[len(term.names) :], term.modulation_sd)
        return tuple(found)


def named_columns(context: EffectContext, slug: str, law: Law, names: Sequence[str]) -> list[EffectColumn]:
    """Return the columns ``names`` of a law in that order."""
    found = {column.name: column for column in EFFECTS[slug].columns(context, law, frozenset(names))}
    return [found[name] for name in names]


def _depends_on_angles_only(slug: str, columns: Sequence[EffectColumn]) -> bool:
    """Return whether columns are the same at every geometry: joint offsets by measured joint angles only."""
    return EFFECTS[slug].variables == {InputVariable.JOINT_ANGLE} and all(one.joint is not None for one in columns)


def whitening(sigma: Array) -> Array:
    """Return matrices (3, 3, n) [1/m] that scale errors of n points to units of their standard uncertainty."""
    white = whitener(sigma)
    return np.asarray(np.eye(3)[:, :, None] * white) if white.ndim == 1 else white
