"""Discovery on arms that were calibrated with an earlier calibration as prior: what has come beside what was known.

The search sees the readings without the effects that were carried over, at the true joint positions, and the D-H rows
with the belief as prior. What it finds is then fitted together with all that was carried over, under the whole prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.discovery.discover import discover_arm
from cellapp.discovery.held_out import HeldOut
from cellapp.discovery.outcome import Discovery
from cellapp.effects import EFFECTS, MeasurementConditions
from cellapp.model import ArmModel
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Report, ignore_report
from cellapp.run import Readings
from cellapp.signature.calibrate import learned, stated_model
from cellapp.signature.earlier import Earlier
from cellapp.signature.update import update


@dataclass(frozen=True, eq=False)
class SearchWithPriors:
    """``discover_arm`` that keeps the earlier calibrations of some arms."""

    earlier: Mapping[str, Earlier]

    def __call__(
        self,
        profile: Profile,
        name: str,
        model: ArmModel,
        readings: Readings,
        cancel: CancelToken | None = None,
        *,
        conditions: MeasurementConditions,
        report: Report = ignore_report,
    ) -> Discovery:
        """Search one arm; ``model`` is the calibrated one."""
        its = self.earlier.get(name)
        if its is None:
            return discover_arm(profile, name, model, readings, cancel, conditions=conditions, report=report)
        learn, learn_conditions = learned(profile, name, readings, conditions, its)
        known = update(profile, name, learn, learn_conditions, its.belief, its.since)
        bare = replace(model, effects=(), network=None, posterior=None, nominal=known.belief.geometry(model.nominal))
        found = discover_arm(
            profile,
            name,
            bare,
            without_effects(model, readings, conditions),
            cancel,
            conditions=conditions,
            report=report,
            prior_sigma=known.belief.sigma(),
        )
        if not found.accepted:
            final = model
        else:
            terms = tuple(effect.term for effect in found.accepted)
            again = update(profile, name, learn, learn_conditions, its.belief, its.since, terms)
            final = stated_model(again.found, profile.seed)
        held_out = HeldOut.of(readings, conditions)
        carried = ", ".join(dict.fromkeys(EFFECTS[term.slug].title for term in its.belief.terms))
        return replace(
            found,
            sentence=f"{found.sentence}; carried over from {its.since}: {carried or 'geometry alone'}",
            model=final,
            after=held_out.position_mm(final),
            stage=held_out.evaluate(final),
            uncertainty_mm=held_out.predicted_uncertainty_mm(final),
        )


def without_effects(model: ArmModel, readings: Readings, conditions: MeasurementConditions) -> Readings:
    """The readings at the true joint positions and without the shifts of a model's effects."""
    moved = model.effect_displacement(readings.q, conditions=conditions)
    return replace(readings, q=readings.q + moved.joints, p_M=readings.p_M - np.asarray(moved.shift_M))
