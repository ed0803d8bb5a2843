"""Prior knowledge of an arm from an earlier calibration: a normal distribution of the arm's own parameters.

The arm's own parameters are the D-H rows and the effects that declare themselves ``arm_bound``. Base, tool and other
effects are integrated out. What the earlier readings cannot distinguish from a pose of the base or of the SMR (the
zeros of the first and of the last joint) then keeps its original priors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import PriorSpread, candidate_columns, typical_spreads
from cellapp.estimation.calibration.quantities import Quantities
from cellapp.estimation.calibration.records import SignaturePart
from cellapp.estimation.discovery.prior_fit import Posterior, Prior, term_columns, values_of
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.kinematics.chain import Geometry, all_names, parameter_names
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

_LEAST_SD = 1e-12
"""Least standard deviation, which keeps a precision finite [m, rad or the effect's unit]."""
_RIDGE = 1e-8
"""Added to the diagonal of correlations before inversion: it raises a standard deviation by at most a hundredth of a
per cent, and keeps directions that were known to rounding."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Normal distribution of an arm's own parameters.

    Attributes
    ----------
    nominal : Geometry
        Reference arm; geometric parameters are deviations from its D-H rows.
    columns : tuple of int, length K
        Indices of the geometric parameters.
    terms : tuple of EffectTerm
        Effects, with their mean values.
    mean : array, shape (p,)
        Deviations of the K geometric parameters, then values of the effects.
    covariance : array, shape (p, p)
    size : array, shape (p,)
        Standard deviation of each parameter before any calibration.
    is_forgotten : bool
        Whether it contains nothing of a calibration.
    """

    nominal: Geometry
    columns: tuple[int, ...]
    terms: tuple[EffectTerm, ...]
    mean: Array
    covariance: Array
    size: Array
    is_forgotten: bool = False

    @classmethod
    def of(cls, found: Posterior, size: Array) -> Belief:
        """Take the arm's own part of a posterior; ``size`` (q,) is that of all its parameters."""
        own = own_places(found.prior.columns, found.model)
        joints = found.model.geometry.joints
        columns = tuple(column for column in found.prior.columns if is_own(column, joints))
        return cls(
            nominal=found.prior.reference,
            columns=columns,
            terms=tuple(term for term in found.model.effects if EFFECTS[term.slug].arm_bound),
            mean=found.values[own],
            covariance=found.covariance[np.ix_(own, own)],
            size=size[own],
        )

    @cached_property
    def parts(self) -> tuple[SignaturePart, ...]:
        """Part to which each parameter (p,) belongs."""
        found: list[SignaturePart] = ["geometry"] * len(self.columns)
        for term in self.terms:
            part: SignaturePart = "curves" if is_smooth(term) else "effects"
            found += [part] * len(term.names)
        return tuple(found)

    def places(self, part: SignaturePart) -> NDArray[np.intp]:
        """Return the indices of the parameters of a part."""
        return np.flatnonzero([one == part for one in self.parts]).astype(np.intp)

    @cached_property
    def jump_sd(self) -> Array:
        """Standard deviation (p,) of a change with a cause of its own: as large as the parameter may be at all."""
        return np.where(np.isfinite(self.size), self.size, np.maximum(np.abs(self.mean), self._sd))

    @property
    def _sd(self) -> Array:
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), _LEAST_SD**2)))

    def widened(self, variance: Array) -> Belief:
        """Return the belief after changes of each parameter with ``variance`` (p,)."""
        return replace(self, covariance=self.covariance + np.diag(variance))

    def forgotten(self) -> Belief:
        """Return the knowledge of the geometry before any calibration, without effects."""
        size = self.jump_sd[: len(self.columns)]
        return replace(
            self, terms=(), mean=np.zeros_like(size), covariance=np.diag(size**2), size=size, is_forgotten=True
        )

    def geometry(self, start: Geometry) -> Geometry:
        """Return the mean geometry with base and tool of ``start``."""
        vector, columns = start.vector(), list(self.columns)
        vector[columns] = self.nominal.vector()[columns] + self.mean[: len(columns)]
        return start.with_vector(vector)

    def sigma(self) -> dict[str, float]:
        """Return geometric parameter -> standard deviation [m, rad]."""
        names = parameter_names(self.nominal.joints)
        return {names[column]: float(sd) for column, sd in zip(self.columns, self._sd, strict=False)}

    def prior(self, reference: Geometry, day_terms: Array) -> Prior:
        """Return the prior of a fit whose effects are those of the belief, then others with prior standard deviations
        ``day_terms`` (r,), infinite without a prior; deviations are from ``reference``."""
        columns = candidate_columns(reference)
        count = len(columns) + len(self.mean) - len(self.columns)
        own = own_columns(columns, reference.joints)
        own = np.concatenate([own, np.arange(len(columns), count)]).astype(np.intp)
        mean, precision = np.zeros(count + len(day_terms)), np.zeros((count + len(day_terms),) * 2)
        places = list(self.columns)
        shift = self.nominal.vector()[places] - reference.vector()[places]
        mean[own] = self.mean + np.concatenate([shift, np.zeros(len(self.mean) - len(shift))])
        precision[np.ix_(own, own)] = self._precision()
        of_day = np.arange(count, count + len(day_terms))
        precision[of_day, of_day] = 1.0 / np.maximum(day_terms, _LEAST_SD) ** 2
        return Prior(columns, reference, mean, precision)

    def _precision(self) -> Array:
        sd = self._sd
        correlation = self.covariance / sd / sd[:, None] + _RIDGE * np.eye(len(sd))
        factor = np.linalg.inv(np.linalg.cholesky(correlation))
        return np.asarray((factor.T @ factor) / sd / sd[:, None])


def is_own(column: int, joints: int) -> bool:
    """Return whether a geometric parameter belongs to the D-H rows, not to base or tool."""
    return 6 <= column < 6 + 5 * joints


def own_columns(columns: tuple[int, ...], joints: int) -> NDArray[np.intp]:
    """Return the indices of the D-H rows among geometric parameters."""
    return np.array([place for place, column in enumerate(columns) if is_own(column, joints)], dtype=np.intp)


def own_places(columns: tuple[int, ...], model: ArmModel) -> NDArray[np.intp]:
    """Return the indices of the arm's own parameters among geometric parameters and the values of a model's effects."""
    of_terms = np.array([EFFECTS[term.slug].arm_bound for term in model.effects for _ in term.names], dtype=bool)
    own = own_columns(columns, model.geometry.joints)
    return np.concatenate([own, len(columns) + np.flatnonzero(of_terms)]).astype(np.intp)


def is_smooth(term: EffectTerm) -> bool:
    """Return whether the values of a term have a prior, as those of a free function."""
    return term.law.form.is_smooth


def sizes(profile: Profile, model: ArmModel, measured: Quantities) -> Array:
    """Return the standard deviations (p,) of all parameters of a model before any reading, infinite without a prior."""
    columns = candidate_columns(model.geometry)
    of_geometry = geometry_sizes(profile, model, columns)
    if not model.effects:
        return of_geometry
    of_terms = np.array([column.prior_sd for column in term_columns(model, measured.take(np.arange(1)))])
    first = 0
    for term in model.effects:
        last = first + len(term.names)
        if term.modulations:  # the prior of a discrepancy term is not stored: its own size replaces it
            free = slice(last - len(term.modulations), last)
            of_terms[free] = math.sqrt(float(np.mean(term.values[len(term.law_names) :] ** 2))) + _LEAST_SD
        first = last
    return np.concatenate([of_geometry, of_terms])


def geometry_sizes(profile: Profile, model: ArmModel, columns: tuple[int, ...]) -> Array:
    """Return standard deviations (K,) of geometric parameters about nominal: from the profile, else their spread."""
    joints = model.geometry.joints
    stated, typical = prior_sigmas(model.nominal, profile.calibration.priors), typical_spreads(joints)
    deviation = values_of(model.geometry, (), columns, model.nominal)
    names = [all_names(joints)[column] for column in columns]
    found = np.array([stated.get(name, math.inf) for name in names])
    for unit_size in set(typical.values()):
        places = [k for k, name in enumerate(names) if typical.get(name) == unit_size and name not in stated]
        if places:
            found[places] = math.sqrt(PriorSpread(np.array(places), unit_size).square(deviation[places], 0.0))
    return found
