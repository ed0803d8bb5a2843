"""Readings of one arm for discovery, with measurement conditions, effect columns and weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import identify_with_excess
from cellapp.estimation.calibration.least_squares import whitener, with_excess
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.discovery.terms import ModelTerms
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import Groups, repeats, undivided
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, DriverVariable, EffectColumn, EffectContext, Law, MeasurementConditions
from cellapp.robot.effects.law import with_prior_sd
from cellapp.robot.effects.modulation import with_modulations
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

TOLERANCE = 1e-6
"""Step [m at arm's length] at which a fit ends: a twentieth of a tracker's resolution."""
LEAST_SCATTER_M = 1e-7
"""Least scatter of any instrument [m]; the weights of readings computed without noise would be singular by rounding."""


@dataclass(frozen=True, eq=False)
class ArmData:
    """Readings of one arm, their measurement conditions, and the weights in use.

    The parameter set is selected once. If each joint fit selected it again, an effect could make redundant directions
    appear identifiable.

    Attributes
    ----------
    profile, model, readings, known
        ``model`` has geometry only; ``conditions`` are those of the readings.
    stated : array, shape (n,) [m] or (n, 3, 3) [m^2], or None
        Stated uncertainty of the readings; None if they state none.
    sigma : array, shape (n,) [m] or (n, 3, 3) [m^2]
        Uncertainty that defines the weights: stated or estimated, including the scatter beyond it.
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
    readings: Readings
    conditions: MeasurementConditions
    stated: Array | None
    sigma: Array
    parameter_set: ParameterSet
    prior_sigma: Mapping[str, float]
    start: Mapping[tuple[str, str], float] = field(default_factory=dict)
    true_q: Array | None = None
    cache: dict[tuple[str, str, tuple[str, ...] | None], list[EffectColumn]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        profile: Profile,
        model: ArmModel,
        readings: Readings,
        conditions: MeasurementConditions,
        prior_sigma: Mapping[str, float] | None = None,
    ) -> ArmData:
        """Set the weights from the stated uncertainty, and select the geometric parameters.

        ``prior_sigma`` [m, rad] replaces the profile's, about ``robot.model.nominal``.
        """
        geometry_only = replace(model, effects=(), network=None)
        settings = profile.calibration
        its = measured_quantities(readings, conditions)
        readings, conditions, stated = its.readings, its.conditions, its.stated
        found, excess_m = identify_with_excess(
            model.nominal,
            readings.q,
            readings.p_M,
            R_M_S=its.R_M_S,
            sigma=stated,
            parameter_set=settings.parameter_set,
            prior_sigma=prior_sigmas(model.nominal, settings.priors) if prior_sigma is None else prior_sigma,
            tolerance=TOLERANCE,
            tool_unknown=True,
        )
        sigma = np.full(len(readings), max(found.scale, LEAST_SCATTER_M)) if stated is None else stated
        if stated is not None and its.turned is not None:
            sigma = with_excess(stated, excess_m**2, its.turned, found.excess_rad**2)
        geometry_only = replace(geometry_only, geometry=found.geometry)
        return cls(
            profile,
            geometry_only,
            readings,
            conditions,
            stated,
            sigma,
            found.estimated,
            found.prior_sigma,
        )

    def __len__(self) -> int:
        return len(self.readings)

    @cached_property
    def turned(self) -> NDArray[np.bool_] | None:
        """Mask (n,) of the rows that are orientations; None if there are none."""
        return self.conditions.turned

    @property
    def positions(self) -> slice | NDArray[np.bool_]:
        """Mask (n,) of the rows that are positions; a full slice if no orientation was measured."""
        return slice(None) if self.turned is None else ~self.turned

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

    def take(self, rows: NDArray[np.intp]) -> ArmData:
        """Return some of the rows."""
        return replace(
            self,
            readings=self.readings.take(rows),
            conditions=self.conditions.take(rows),
            stated=None if self.stated is None else self.stated[rows],
            sigma=self.sigma[rows],
            true_q=None if self.true_q is None else self.true_q[rows],
            cache={},
        )

    def claiming(self, factor: float) -> ArmData:
        """Return the same data with the stated uncertainty of positions times a factor."""
        if self.stated is None or factor == 1.0:
            return self
        factors = np.full(len(self), factor) if self.turned is None else np.where(self.turned, 1.0, factor)
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
        """Return the columns of the terms in order: for each those of the law, then those of its free part."""
        found: list[EffectColumn] = []
        for term in terms:
            columns = with_modulations(self.columns(term.slug, term.law, term.names), term.modulations, self.context)
            found += columns[: len(term.names)]
            found += map(with_prior_sd, columns[len(term.names) :], term.modulation_sd)
        return tuple(found)


def _depends_on_angles_only(slug: str, columns: Sequence[EffectColumn]) -> bool:
    """Return whether columns are the same at every geometry: joint offsets by measured joint angles only."""
    return EFFECTS[slug].variables == {DriverVariable.JOINT_ANGLE} and all(one.joint is not None for one in columns)


def whitening(sigma: Array) -> Array:
    """Return matrices (3, 3, n) [1/m] that scale errors of n points to units of their standard uncertainty."""
    white = whitener(sigma)
    return np.asarray(np.eye(3)[:, :, None] * white) if white.ndim == 1 else white
