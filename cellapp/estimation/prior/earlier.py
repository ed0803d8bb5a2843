"""Earlier calibration of an arm: its belief and its origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellapp.estimation.calibration.gross_errors import gross_errors_of_model
from cellapp.estimation.calibration.parameters import candidate_columns
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.prior.belief import Belief, sizes
from cellapp.estimation.prior.linear_model import Measured
from cellapp.estimation.prior.posterior import Posterior, Prior, posterior
from cellapp.estimation.prior.update import update
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.results import ModelStage
from cellapp.robot.effects import EffectTerm
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


@dataclass(frozen=True, eq=False)
class Earlier:
    """Earlier calibration of one arm.

    ``digest`` is the SHA-256 of its model and readings, ``since`` the day of its run, ``left_behind`` the effects that
    are not carried over; ``notes`` are for the operator.
    """

    belief: Belief
    run: Path
    stage: ModelStage
    digest: str
    since: str
    readings: int
    controller: str | None
    left_behind: tuple[str, ...]
    notes: tuple[str, ...]


def believed(
    profile: Profile,
    name: str,
    models: Mapping[str, ArmModel],
    readings: Mapping[str, Readings],
    before: Belief | None = None,
    since: str = "",
) -> tuple[Belief, int]:
    """Return the belief about one arm of a calibrated cell from all its readings, and their number.

    ``before`` is the belief that served as prior of this calibration, of the day ``since``.
    """
    found, measured = calibration_posterior(profile, name, models, readings, before, since)
    return Belief.of(found, sizes(profile, found.model, measured)), len(measured)


def calibration_posterior(
    profile: Profile,
    name: str,
    models: Mapping[str, ArmModel],
    readings: Mapping[str, Readings],
    before: Belief | None = None,
    since: str = "",
) -> tuple[Posterior, Measured]:
    """Return the posterior of one arm of a calibrated cell from all its readings, and these without gross errors."""
    model, conditions = models[name], conditions_of_arms(models, readings)[name]
    its = readings[name]
    good = ~gross_errors_of_model(model, its, conditions)
    some, conditions = its.take(good), conditions.take(good)
    model = replace(model, network=None, posterior=None)
    measured = Measured.of(some, conditions)
    if measured.turned is None:
        model = model.of_positions()
    if before is None:
        return posterior(model, measured, _first_prior(model, sizes(profile, model, measured))), measured
    carried = {_key(term) for term in before.terms}
    further = tuple(term for term in model.effects if _key(term) not in carried)
    return update(profile, name, some, conditions, before, since, further).found, measured


def _key(term: EffectTerm) -> tuple[str, str, tuple[str, ...]]:
    """Return the key that identifies a term in a model."""
    return term.slug, term.law.name, term.names


def _first_prior(model: ArmModel, size: Array) -> Prior:
    """Return the prior of an arm before its first calibration."""
    precision = 1.0 / np.maximum(size, 1e-12) ** 2
    return Prior(candidate_columns(model.geometry), model.nominal, np.zeros(len(size)), np.diag(precision))
