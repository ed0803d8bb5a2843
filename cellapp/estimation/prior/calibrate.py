"""Calibration and discovery with earlier calibrations of the arms as prior.

The search sees the readings without the carried-over effects, at the true joint positions, and the D-H rows with the
belief as prior. Its effects are then fitted together with all carried-over parameters, under the whole prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellapp.estimation.calibration.calibrate import ArmCalibration, CellCalibration, gross_errors_of_model, without
from cellapp.estimation.calibration.identification import Identification
from cellapp.estimation.calibration.least_squares import readings_noise
from cellapp.estimation.calibration.pair_calibration import PairCalibration, calibrate_pair
from cellapp.estimation.calibration.parameters import ParameterSet, candidate_columns, determined_set
from cellapp.estimation.calibration.quantities import (
    ArmReadings,
    Quantities,
    evaluate_quantities,
    measured_orientations,
)
from cellapp.estimation.calibration.records import ArmPriorResult
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.outcome import ArmFound, HeldOut
from cellapp.estimation.discovery.prior_fit import Posterior, Prior, posterior
from cellapp.estimation.prior.belief import Belief, geometry_sizes, is_smooth, sizes
from cellapp.estimation.prior.update import Updated, first_model, update
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNTOLD, JobSteps
from cellapp.ground.results import ModelStage
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions, place_in_words
from cellapp.robot.kinematics.transforms import Array, quaternions_of
from cellapp.robot.model import ArmModel
from cellapp.robot.model.model import PosteriorSamples

# -- Earlier calibration of an arm: its belief and its origin ---------------------------------------------------------


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


def believed(arm: ArmReadings, before: Belief | None = None, since: str = "") -> tuple[Belief, int]:
    """Return the belief about one calibrated arm from all its readings, and their number.

    ``before`` is the belief that served as prior of this calibration, of the day ``since``.
    """
    found, measured = calibration_posterior(arm, before, since)
    return Belief.of(found, sizes(arm.profile, found.model, measured)), len(measured)


def calibration_posterior(
    arm: ArmReadings, before: Belief | None = None, since: str = ""
) -> tuple[Posterior, Quantities]:
    """Return the posterior of one calibrated arm from all its readings, and these without gross errors."""
    arm = arm.take(~gross_errors_of_model(arm.model, arm.quantities()))
    model = replace(arm.model, network=None, posterior=None)
    measured = arm.quantities()
    if measured.angular is None:
        model = model.of_positions()
    if before is None:
        return posterior(model, measured, _first_prior(model, sizes(arm.profile, model, measured))), measured
    carried = {_key(term) for term in before.terms}
    further = tuple(term for term in model.effects if _key(term) not in carried)
    return update(arm, before, since, further).found, measured


def _key(term: EffectTerm) -> tuple[str, str, tuple[str, ...]]:
    """Return the key that identifies a term in a model."""
    return term.slug, term.law.name, term.names


def _first_prior(model: ArmModel, size: Array) -> Prior:
    """Return the prior of an arm before its first calibration."""
    precision = 1.0 / np.maximum(size, 1e-12) ** 2
    return Prior(candidate_columns(model.geometry), model.nominal, np.zeros(len(size)), np.diag(precision))


_SAMPLE_SEED = 0x51D2
"""Combined with the profile's seed, so that the samples of parameters are independent of all other samples."""


def calibrate_with_prior(
    profile: Profile, readings: Mapping[str, Readings], calibration: CellCalibration, earlier: Mapping[str, Earlier]
) -> CellCalibration:
    """Calibrate the arms in ``earlier`` again with their prior, and the pair with them."""
    measured = ArmReadings.of_cell(profile, {name: arm.model for name, arm in calibration.arms.items()}, readings)
    arms, notes = dict(calibration.arms), list(calibration.notes)
    for name, its in earlier.items():
        arms[name] = _calibrated(measured[name], arms[name], its)
        notes += its.notes
        prior = arms[name].prior
        notes += [] if prior is None else [f"arm '{name}': {change.sentence}" for change in prior.changes]
        if prior is not None and not any(part.used for part in prior.parts.values()):
            notes.append(f"arm '{name}': the readings contradict {its.run}; nothing of it was used")
    notes += [
        f"arm '{name}': no earlier calibration; calibrated from these readings alone"
        for name in arms
        if name not in earlier
    ]
    pair = calibration.pair
    good = {name: without(its, arms[name].left_out) for name, its in readings.items()}
    models = {name: arm.model for name, arm in arms.items()}
    with_effects, _ = calibrate_pair(profile, good, models)
    if pair is not None and with_effects is not None:
        pair = PairCalibration({**pair.methods, **with_effects.methods}, {**pair.transforms, **with_effects.transforms})
    model = replace(calibration.model, arms=models, T_R_L=None if pair is None else pair.T_R_L)
    return replace(calibration, model=model, arms=arms, pair=pair, notes=tuple(notes))


def learned(arm: ArmReadings, earlier: Earlier) -> ArmReadings:
    """Return the training readings: the identify and train splits without gross errors."""
    some = arm.take(arm.readings.in_split("identify", "train"))
    measured = some.quantities()
    model = first_model(arm.profile, arm.name, measured, earlier.belief)
    return some.take(~gross_errors_of_model(model, measured))


def updated_arm(arm: ArmReadings, earlier: Earlier) -> Updated:
    """Calibrate one arm from its training readings with its earlier calibration as prior."""
    return update(learned(arm, earlier), earlier.belief, earlier.since)


def _calibrated(arm: ArmReadings, alone: ArmCalibration, earlier: Earlier) -> ArmCalibration:
    outcome = updated_arm(arm, earlier)
    if not outcome.used:
        return replace(alone, prior=prior_result(arm.name, earlier, outcome))
    model = stated_model(outcome.found, arm.profile.seed)
    rows = arm.readings.in_split("validate")
    held_out = arm.take(rows[~np.isin(arm.readings.configuration[rows], alone.left_out)]).quantities()
    return replace(
        alone,
        model=model,
        identification=_identification(arm.profile, alone.identification, outcome.found),
        validate={**alone.validate, "effects": evaluate_quantities(held_out, held_out.predicted(model))},
        prior=prior_result(arm.name, earlier, outcome),
    )


def prior_result(name: str, earlier: Earlier, outcome: Updated) -> ArmPriorResult:
    """Return the stored result of a prior and of the calibration with it."""
    return ArmPriorResult.like(
        earlier,
        run=str(earlier.run),
        arm=name,
        sha256=earlier.digest,
        parts=outcome.parts,
        effects=tuple(dict.fromkeys(term.slug for term in earlier.belief.terms)),
        scatter_mm=outcome.scatter_m * 1e3,
        scatter_mrad=None if outcome.scatter_rad is None else outcome.scatter_rad * 1e3,
        tested=outcome.tested,
        changes=outcome.changes,
    )


def stated_model(found: Posterior, seed: int) -> ArmModel:
    """Return the model of a posterior with standard errors, covariance and samples."""
    model, count = found.model, len(found.prior.columns)
    errors = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    names = list(ParameterSet("", model.geometry.joints, found.prior.columns).names)
    kept, first, effects = list(range(count)), count, []
    for term in model.effects:
        here = slice(first, first + len(term.names))
        effects.append(replace(term, standard_errors=errors[here]))
        if not is_smooth(term):
            kept += range(here.start, here.start + len(term.law_names))
            names += term.law_names
        first = here.stop
    samples = PosteriorSamples.of_covariance(
        columns=found.prior.columns,
        sizes=[len(term.names) for term in model.effects],
        covariance=found.covariance,
        noise=readings_noise(found.measured.sigma, found.measured.angular),
        seed=(seed, _SAMPLE_SEED),
    )
    return replace(
        model,
        effects=tuple(effects),
        identified=tuple(names),
        covariance=found.covariance[np.ix_(kept, kept)],
        posterior=samples,
    )


def _identification(profile: Profile, alone: Identification, found: Posterior) -> Identification:
    """Return the identification with the values and standard errors that follow with the prior."""
    columns, joints = found.prior.columns, found.model.geometry.joints
    count = len(columns)
    covariance = found.covariance[:count, :count]
    size = geometry_sizes(profile, found.model, columns)
    scale = np.sqrt(np.diag(covariance))
    information = np.linalg.pinv(covariance / scale / scale[:, None], hermitian=True) / scale / scale[:, None]
    information = information - np.diag(1.0 / size**2)
    estimated = ParameterSet(alone.estimated.name, joints, columns)
    chosen = determined_set(estimated, information, size)
    to_table, kept = chosen.from_estimated(estimated)
    in_table: Array = to_table @ covariance @ to_table.T
    reference = found.prior.reference.vector()[list(columns)]
    return replace(
        alone,
        geometry=found.model.geometry,
        estimated=estimated,
        estimated_covariance=covariance,
        parameter_set=chosen,
        names=chosen.names,
        units=chosen.units,
        values=reference[kept] + to_table @ found.values[:count],
        covariance=in_table,
        mean=found.prior.mean[:count],
        precision=np.diag(found.prior.precision)[:count],
        residuals=found.residuals_M,
        angular=found.measured.angular,
        excess_rad=found.scatter_rad,
    )


# -- Discovery --------------------------------------------------------------------------------------------------------


_SEARCHES = 2
"""Most searches, if the first one finds something: until then the carried-over values had to compensate for it."""


@dataclass(frozen=True, eq=False)
class SearchWithPriors:
    """Variant of ``discover_arm`` that keeps the earlier calibrations of some arms."""

    earlier: Mapping[str, Earlier]

    def __call__(self, arm: ArmReadings, steps: JobSteps = UNTOLD) -> ArmFound:
        """Search one arm."""
        its, model = self.earlier.get(arm.name), arm.model
        if its is None:
            return discover_arm(arm, steps)
        learn = learned(arm, its)
        if not update(learn, its.belief, its.since).used:
            return discover_arm(arm, steps)
        final, terms = model, model.effects[:0]
        for _ in range(_SEARCHES):
            belief = update(learn, its.belief, its.since, terms).belief
            known = replace(final, effects=final.effects[: len(belief.terms)])
            bare = replace(known, effects=(), network=None, posterior=None, nominal=belief.geometry(model.nominal))
            adjusted = without_effects(known, arm.readings, arm.conditions)
            found = discover_arm(replace(arm, model=bare, readings=adjusted), steps, belief.sigma())
            terms = found.terms
            if not terms:
                final = model
                break
            final = stated_model(update(learn, its.belief, its.since, terms).found, arm.profile.seed)
        held_out = HeldOut.of(arm)
        sentence = f"{found.result.sentence}; {since_words(its, found)}"
        uncertainty_mm = held_out.predicted_uncertainty_mm(final)
        return found.with_model(final, held_out, sentence=sentence, uncertainty_mm=uncertainty_mm)


def since_words(earlier: Earlier, found: ArmFound) -> str:
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
    rotated = model.rotations(readings.q, conditions)[rows].swapaxes(1, 2) @ R_M_S
    quaternion[rows] = quaternions_of(rotated)
    return replace(plain, quaternion_M=quaternion)
