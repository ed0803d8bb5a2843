"""Forecast of what planned stops can show, before any measurement: standard errors, effects, smallest sizes.

The arms have their nominal geometry. The readings are as the plan expects them: its order and steps, expected times,
the uncertainty that the profile states for the tracker. Whether an effect would be seen is decided as in a search: by
the score of its laws beside the geometry, against a threshold from simulated noise (see ``search.scan``). Sizes are
exact if the noise is the tracker's alone; any scatter of the arms adds to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import TooFewReadings, refused_by_arm
from cellapp.estimation.calibration.least_squares import covariance_with_priors, with_excess
from cellapp.estimation.calibration.parameters import (
    EXPECTED_SCATTER_M,
    ParameterSet,
    determined_set,
    estimated_parameters,
    gram_matrix,
    prior_sds,
    typical_spreads,
)
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.design.information import VISIBLE
from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData, whitening
from cellapp.estimation.discovery.joint_fit import fit_terms
from cellapp.estimation.discovery.records import AbsentEffect, PlannedAccuracy, PlannedEffect, SmallestSize
from cellapp.estimation.discovery.search.scan import LawScan, score_threshold, simulate_null_maxima, smallest_detectable
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchResult
from cellapp.estimation.discovery.search.stepwise import LEAST_FREEDOM
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Tracker
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import Geometry, JointAngles, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import OFF_AXIS, nominal_arm, pose_matrix, prior_sigmas

# -- Detectability: effects that the data cannot show, and the smallest detectable size of the others -----------------

_BARELY_VISIBLE = 0.03
"""Visible share below which an effect is reported as invisible under this plan: it would need to be 30 times as large
as an effect that the geometry cannot imitate."""
_MOST_SIZES = 40
"""Most parameters of one effect whose smallest sizes are reported: all joints and axes, but not hundreds of lines."""


def detectability(found: SearchResult, scan: LawScan) -> tuple[tuple[AbsentEffect, ...], tuple[AbsentEffect, ...]]:
    """Return effects that the data cannot show, and effects that were not found with their smallest detectable sizes.

    ``scan`` covers all effects that the final model lacks.
    """
    fit = found.fit if found.fit.terms else found.geometry_only
    noise_mm = 1e3 * (
        1.0 / math.sqrt(float(np.mean(np.einsum("aan->an", fit.white[:, :, fit.identification.positions]) ** 2)))
    )
    needed = found.threshold + SCORE_MARGIN  # score of a name with even odds
    invisible: list[AbsentEffect] = []
    not_found: list[AbsentEffect] = []
    for slug in found.absent:
        if lacking := EFFECTS[slug].missing_data(found.data.context):
            invisible.append(AbsentEffect(effect=slug, reason=f"not testable: {lacking}"))
            continue
        share, sizes, least_rms = _detectable(scan, slug, needed)
        hidden = share <= _BARELY_VISIBLE
        how_much = "all" if share <= VISIBLE else "nearly all"
        (invisible if hidden else not_found).append(
            AbsentEffect(
                effect=slug,
                reason=f"invisible: geometry can follow {how_much} of it under this plan"
                if hidden
                else "not found; it could have been seen from these sizes on",
                visible_share=share,
                smallest_seen=sizes or None,
                smallest_seen_rms_mm=least_rms * noise_mm * math.sqrt(3.0) if math.isfinite(least_rms) else None,
            )
        )
    return tuple(invisible), tuple(not_found)


def _detectable(scan: LawScan, slug: str, needed: float) -> tuple[float, dict[str, SmallestSize], float]:
    """Return the largest visible share of one effect, the smallest size of each parameter, and the least rms
    displacement (whitened), over the laws of its simplest form that the data allow.

    A refined form may be visible although the effect itself is not: a scale error that bends with the range of the
    beam.
    """
    own = [candidate.law.form for candidate in scan.candidates if candidate.slug == slug]
    simplest = next((form for form in EFFECTS[slug].forms if form in own), None)
    sizes: dict[str, SmallestSize] = {}
    share, least_rms = 0.0, math.inf
    for number, candidate in enumerate(scan.candidates):
        if candidate.slug != slug or candidate.law.form != simplest:
            continue
        place = scan.place(number)
        share = max(share, float(scan.visible_share[place].max(initial=0.0)))
        size_of = smallest_detectable(scan, number, needed)
        rms = np.sqrt(np.mean(scan.behind.rows[place] ** 2, axis=1)).tolist()
        for column, displaced in zip(candidate.columns, rms, strict=True):
            size = size_of[column.name]
            if not math.isfinite(size):
                continue
            least_rms = min(least_rms, size * displaced)
            known = sizes.get(column.name)
            if (known is None or size < known.value) and len(sizes) < _MOST_SIZES:
                sizes[column.name] = SmallestSize(value=size, unit=column.unit)
    return share, sizes, least_rms


_SEED = 0xF0CA
"""Combined with the profile's seed, so that the simulated noise is independent of all other samples."""


def expected_readings(
    profile: Profile,
    plan: Mapping[str, Array],
    *,
    time_s: Array,
    dwell_s: Array,
    step: Mapping[str, Array],
    load: NDArray[np.intp],
) -> dict[str, ArmReadings]:
    """Return the readings of nominal arms that are expected from a plan.

    Their noise is simulated, so that fits get realistic weights; no result depends on the sample beyond rounding.

    Parameters
    ----------
    profile : Profile
    plan, step : mapping
        Arm -> joint positions, and last motion of each joint with its sign, (n, N) [rad].
    time_s, dwell_s : array, shape (n,)
        Times since the first motion, and at rest before each measurement [s].
    load : array, shape (n,), int
        Index of the plan's load that the arms carry.

    Raises
    ------
    InputError
        If the profile lacks the pose of an arm's base, of the tracker, or a home position.
    """
    models = {name: nominal_model(profile, name) for name in plan}
    rng = np.random.default_rng([profile.seed, _SEED])
    readings = {}
    for name, q in plan.items():
        arm, p_M = profile.arms[name], smr_positions(models[name].geometry, q)
        covariance = tracker_covariance(profile.tracker, p_M)
        noise = np.einsum("nab,nb->na", np.linalg.cholesky(covariance), rng.standard_normal(p_M.shape))
        carried = [arm.payload_at(number) for number in load.tolist()]
        readings[name] = Readings(
            configuration=np.arange(len(q)),
            time_s=time_s,
            q=q,
            approach=np.sign(step[name]).astype(np.int8),
            p_M=p_M + noise,
            payload_kg=np.array([one.mass for one in carried]),
            payload_center_F=np.array([one.center_of_mass for one in carried]),
            step=step[name],
            dwell_s=dwell_s,
            covariance_M=covariance,
        )
    return ArmReadings.of_cell(profile, models, readings)


def nominal_model(profile: Profile, name: str) -> ArmModel:
    """Return the published arm, with its base from the profile, in the tracker frame.

    Raises
    ------
    InputError
        If the profile lacks the pose of the arm's base, of the tracker, or a home position.
    """
    arm, tracker = profile.arms[name], profile.tracker
    if arm.base is None or tracker.pose is None or arm.home is None:
        raise InputError(
            f"profile {profile.name}: arms.{name}.base, .home and tracker.pose are needed to foresee a plan"
        )
    nominal = nominal_arm(arm).with_T_M_B(np.linalg.inv(pose_matrix(tracker.pose)) @ pose_matrix(arm.base))
    if arm.smr.offset == "unknown":
        nominal = replace(nominal, tool=OFF_AXIS)
    return ArmModel.of(profile, name, nominal, nominal)


def tracker_covariance(tracker: Tracker, p_M: Array) -> Array:
    """Return covariances (n, 3, 3) [m^2] of points ``p_M`` (n, 3) [m]: sigma is half of each maximum permissible
    error."""
    distance = np.linalg.norm(p_M, axis=1)
    beam = p_M / distance[:, None]
    across, along = (
        0.5 * (error.constant + error.proportional * distance) for error in (tracker.transverse, tracker.range)
    )
    dyads = beam[:, :, None] * beam[:, None, :]
    return np.asarray(across[:, None, None] ** 2 * (np.eye(3) - dyads) + along[:, None, None] ** 2 * dyads)


def planned_data(arm: ArmReadings) -> ArmData:
    """Return ``expected_readings`` of an arm as data of a search, with priors of typical arms, not estimated ones.

    Raise ``InputError`` if the parameter set is wrong.
    """
    profile, model, its = arm.profile, arm.model, arm.quantities()
    stated = prior_sigmas(model.nominal, profile.calibration.priors, profile.arms[arm.name].fixed)
    with refused_by_arm(arm.name):
        estimated, _ = estimated_parameters(profile.calibration.parameter_set, model.nominal, stated)
    # without typical spreads, parameters of "full" that the stops cannot distinguish would have no standard error
    priors = {**typical_spreads(model.nominal.joints), **stated}
    weighed = {**vars(its), "sigma": its.stated}
    return ArmData(**weighed, profile=profile, model=model, parameter_set=estimated, prior_sigma=priors)


def _with_scatter(data: ArmData, scatter_m: float) -> ArmData:
    """Return planned data with a scatter of every coordinate [m] beside the tracker's noise."""
    assert data.stated is not None
    return replace(data, sigma=with_excess(data.stated, scatter_m**2))


def planned_accuracy(data: ArmData, scatter_m: float) -> PlannedAccuracy:
    """Compute standard errors of predicted SMR positions at the stops, and of the determined parameters.

    ``scatter_m`` [m] is a scatter of every coordinate beside the tracker's noise.
    """
    data = _with_scatter(data, scatter_m)
    parameters, priors = data.parameter_set, prior_sds(data.parameter_set, data.prior_sigma)
    _, J = parameters.jacobian(data.model.geometry, JointAngles.of(data.readings.q))
    white = whitening(data.sigma)
    information = gram_matrix(np.einsum("acn,ckn->akn", white, J))
    return accuracy_of(data.model.nominal, parameters, priors, information, J, scatter_m)


def accuracy_of(
    nominal: Geometry, estimated: ParameterSet, priors: Array, information: Array, J: Array, scatter_m: float
) -> PlannedAccuracy:
    """Compute standard errors from ``information`` (k, k) on the ``estimated`` parameters and their ``priors`` (k,): of
    SMR positions with the columns ``J`` (3, k, n), and of the parameters as the result table lists them."""
    covariance = covariance_with_priors(information, priors)
    variance = np.einsum("ckn,kl,cln->n", J, covariance, J)
    chosen = determined_set(estimated, information, priors) if estimated.name == "auto" else estimated
    to_table, _ = chosen.from_estimated(estimated)
    errors = np.sqrt(np.maximum(np.diag(to_table @ covariance @ to_table.T), 0.0))
    values = nominal.vector()[list(chosen.columns)]
    return PlannedAccuracy(
        scatter_mm=1e3 * scatter_m,
        standard_error_mm=1e3 * math.sqrt(float(np.mean(variance))),
        largest_mm=1e3 * math.sqrt(float(np.max(variance))),
        parameters=Estimate.by_name(chosen.names, values.tolist(), errors.tolist(), chosen.units),
    )


def planned_effects(data: ArmData) -> tuple[PlannedEffect, ...]:
    """Return for each effect of the library whether the stops can show it, and from which sizes on.

    Raises
    ------
    InputError
        If the stops are too few to look for any effect beside the geometry.
    """
    scattered = {one.effect: one.smallest_seen_rms_mm for _, one in _absent(_with_scatter(data, EXPECTED_SCATTER_M))}
    return tuple(
        PlannedEffect.like(
            one,
            visible=visible,
            reason="" if visible else one.reason,
            smallest_seen=one.smallest_seen or {},
            with_scatter_rms_mm=scattered.get(one.effect),
        )
        for visible, one in _absent(data)
    )


def _absent(data: ArmData) -> list[tuple[bool, AbsentEffect]]:
    """Return whether each effect could be seen, and its smallest sizes, in the order of the library."""
    settings = data.profile.discovery
    too_few = f"{counted(len(data), 'stop is', 'stops are')} too few to look for effects beside the geometry; plan more"
    try:
        fit = fit_terms(data, ())
    except TooFewReadings:
        raise InputError(too_few) from None
    if len(fit.residual) - fit.projector.effective_parameters < LEAST_FREEDOM:
        raise InputError(too_few)
    scan = LawScan.of(fit.candidates(data, [slug for slug in EFFECTS if slug != UNKNOWN]), fit.projector)
    null_maxima = simulate_null_maxima(scan, fit.projector, settings.null_simulations, (data.profile.seed, _SEED))
    threshold = score_threshold(null_maxima, settings.false_alarm)
    nothing_found = SearchResult(data, fit, fit, (), (), (), threshold)
    invisible, visible = detectability(nothing_found, scan)
    found = {one.effect: (True, one) for one in visible} | {one.effect: (False, one) for one in invisible}
    return [found[slug] for slug in EFFECTS if slug in found]
