"""Discovery on arms calibrated with an earlier calibration as prior: effects beside those already known.

The search sees the readings without the carried-over effects, at the true joint positions, and the D-H rows with the
belief as prior. Its effects are then fitted together with all carried-over parameters, under the whole prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.quantities import measured_orientations
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.outcome import Discovery, HeldOut
from cellapp.estimation.prior.calibrate import Earlier, learned, stated_model
from cellapp.estimation.prior.update import update
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Report, ignore_report
from cellapp.robot.effects import EFFECTS, MeasurementConditions, place_in_words
from cellapp.robot.kinematics.transforms import quaternions_of
from cellapp.robot.model import ArmModel

_SEARCHES = 2
"""Most searches, if the first one finds something: until then the carried-over values had to compensate for it."""


@dataclass(frozen=True, eq=False)
class SearchWithPriors:
    """Variant of ``discover_arm`` that keeps the earlier calibrations of some arms."""

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
        """Search one arm; ``model`` is the calibrated arm."""
        its = self.earlier.get(name)
        if its is None:
            return discover_arm(profile, name, model, readings, cancel, conditions=conditions, report=report)
        learn = learned(profile, name, readings, conditions, its)
        if not update(profile, name, *learn, its.belief, its.since).used:
            return discover_arm(profile, name, model, readings, cancel, conditions=conditions, report=report)
        final, terms = model, model.effects[:0]
        for _ in range(_SEARCHES):
            belief = update(profile, name, *learn, its.belief, its.since, terms).belief
            known = replace(final, effects=final.effects[: len(belief.terms)])
            found = discover_arm(
                profile,
                name,
                replace(known, effects=(), network=None, posterior=None, nominal=belief.geometry(model.nominal)),
                without_effects(known, readings, conditions),
                cancel,
                conditions=conditions,
                report=report,
                prior_sigma=belief.sigma(),
            )
            terms = found.terms
            if not terms:
                final = model
                break
            final = stated_model(update(profile, name, *learn, its.belief, its.since, terms).found, profile.seed)
        return _with_final_model(found, final, its, HeldOut.of(readings, conditions))


def _with_final_model(found: Discovery, final: ArmModel, earlier: Earlier, held_out: HeldOut) -> Discovery:
    """Return the outcome of a search with the model that includes all carried-over parameters."""
    return found.with_model(
        final,
        held_out,
        sentence=f"{found.result.sentence}; {since_words(earlier, found)}",
        uncertainty_mm=held_out.predicted_uncertainty_mm(final),
    )


def since_words(earlier: Earlier, found: Discovery) -> str:
    """Return in words what was carried over, and which effects of the arm itself have appeared since."""
    carried = list(dict.fromkeys(EFFECTS[term.slug].title for term in earlier.belief.terms))
    appeared = [
        f"{effect.title} of {place_in_words(effect.where.acts_on)} has appeared"
        for effect in found.result.accepted
        if EFFECTS[effect.effect].arm_bound
    ]
    said = [f"carried over: geometry{''.join(f', {title}' for title in carried)}"]
    return "; ".join([*said, *(f"{words} since {earlier.since}" for words in appeared)])


def without_effects(model: ArmModel, readings: Readings, conditions: MeasurementConditions) -> Readings:
    """Return the readings at the true joint positions, without the shifts and rotations of a model's effects."""
    moved = model.effect_displacement(readings.q, conditions=conditions)
    plain = replace(readings, q=readings.q + moved.joints, p_M=readings.p_M - np.asarray(moved.shift_M))
    if readings.quaternion_M is None:
        return plain
    rows, R_M_S = measured_orientations(readings)
    quaternion = readings.quaternion_M.copy()
    turned = model.turns(readings.q, conditions)[rows].swapaxes(1, 2) @ R_M_S
    quaternion[rows] = quaternions_of(turned)
    return replace(plain, quaternion_M=quaternion)
