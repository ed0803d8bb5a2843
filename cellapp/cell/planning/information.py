"""The information in each candidate stop of an arm: whitened derivatives of its reading by geometry and effects.

The columns are: all geometric parameters with the priors of typical arms; the coefficients of the effects that the
profile lists; and *potential terms*, periodic errors of several cycles per revolution that are not listed, each small
by prior. A design that ignored these would put its stops only where the listed effects are largest, and errors that
discovery finds with free forms would stay hidden (Bayesian designs with potential terms: DuMouchel, Jones,
Technometrics 36 (1994) 37).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.parameters import (
    EXPECTED_SCATTER_M,
    ParameterSet,
    estimated_parameters,
    prior_sds,
    typical_spreads,
)
from cellapp.estimation.discovery.arm_data import (
    TRANSMISSION_ERROR,
    UNKNOWN,
    ModelTerm,
    named_columns,
    whitened_displacements,
    whitening,
)
from cellapp.estimation.discovery.plan_forecast import nominal_model, tracker_covariance
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectContext, Law, MeasurementConditions
from cellapp.robot.kinematics.chain import JointAngles, jacobian
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import prior_sigmas

EXPECTED_EFFECT_M = 1e-4
"""Standard deviation of the rms displacement by each coefficient of an effect: what most effects of the library do to
an arm of this class (10 to 300 um). It matters only for coefficients that hardly any plan determines."""
POTENTIAL_M = 1e-5
"""The same for a potential term. Designed stops then show such errors better than random ones do (standard errors 0.8
of theirs; without potential terms 1.5 in the worst case), and lose 2 % of their information about the rest."""
POTENTIAL_CYCLES = (3, 4, 5, 6)
"""Cycles per revolution of the potential terms of every joint: the next above those of the listed effects. Errors with
more cycles are unrelated to posture: any stops without large gaps show them."""
_MOST_CYCLES = 2
"""Columns of effects with more cycles per revolution are left to the potential terms."""
_REGISTRATION = {"m": 5e-3, "rad": 5e-3}
"""Standard deviation of the parameters of base and SMR that have no prior: as a first registration leaves them."""
_LEAST_EFFECT_M = 1e-6
"""A column is left out if it moves the SMR by less than this even at the bound of its coefficient."""
_INCIDENCE_SCALE = math.radians(10.0)
"""Incidence beyond the range of full accuracy at which the tracker's standard uncertainty has grown by half."""
_INCIDENCE_GROWTH = 0.5
_SECONDS_A_STOP = 15.0
"""Time of a stop with its motion: it only matters for the course of a warm-up relative to the length of the run."""
_REFERENCE_STOPS = 400
"""Number of candidates at which the laws of effects are set up and the sizes of their columns are computed."""
_ROWS_AT_ONCE = 2000
"""Number of candidates whose columns are computed at once: bounds the memory for intermediate arrays."""


@dataclass(frozen=True, eq=False)
class InformationModel:
    """The p columns of one arm and their sizes: first geometry, then effects, then potential terms.

    Attributes
    ----------
    profile, name
        The cell, and the arm in it.
    model : ArmModel
    parameters : ParameterSet
        Geometric parameters.
    parts : tuple
        Columns of effects, and last of potential terms.
    size : array, shape (p,)
        Prior standard deviation of each parameter or coefficient in its unit.
    wanted : int
        Number of columns whose standard errors count: without the potential terms.
    """

    profile: Profile
    name: str
    model: ArmModel
    parameters: ParameterSet
    parts: tuple[ModelTerm, ...]
    size: Array
    wanted: int

    def rows(self, q: Array, conditions: MeasurementConditions, dtype: type = np.float64) -> Array:
        """Compute whitened derivatives (n, 3, p) of readings at ``q`` (n, N) [rad] by parameters in units ``size``."""
        return self._rows(q, conditions, dtype, weighted=True)

    def prediction_rows(self, q: Array, conditions: MeasurementConditions) -> Array:
        """Compute derivatives (n, 3, p) [m] of SMR positions at ``q`` (n, N) [rad] by parameters in units ``size``."""
        return self._rows(q, conditions, weighted=False)

    def _rows(self, q: Array, conditions: MeasurementConditions, dtype: type = np.float64, *, weighted: bool) -> Array:
        found: Array = np.empty((len(q), 3, len(self.size)), dtype=dtype)
        for first in range(0, len(q), _ROWS_AT_ONCE):
            part = np.arange(first, min(first + _ROWS_AT_ONCE, len(q)))
            context = self.model.context(q[part], conditions=conditions.take(part))
            white = whitening(self._covariance(context)) if weighted else _unit(len(part))
            found[part] = self._columns(context, white)
        return found

    def _columns(self, context: EffectContext, white: Array) -> Array:
        """Compute the columns (n, 3, p), whitened by ``white`` (3, 3, n)."""
        size, joints = len(self.parameters.columns), tuple(6 + 5 * j for j in range(context.joints))
        _, J = self.parameters.jacobian(self.model.geometry, JointAngles.of(context.q), more=joints)
        J = np.einsum("acn,ckn->kan", white, J)
        by_joint = J[:-size].swapaxes(0, 1)
        columns = [one for part in self.parts for one in named_columns(context, part.slug, part.law, part.names)]
        of_effects = whitened_displacements(columns, by_joint, white).reshape(len(columns), 3, -1)
        together = np.concatenate([J[-size:], of_effects])
        together *= self.size[:, None, None]
        return together.transpose(2, 1, 0)

    def _covariance(self, context: EffectContext) -> Array:
        """Compute the expected covariance (n, 3, 3) [m^2] of readings: the tracker's, and the scatter of the arm."""
        oblique = np.maximum(incidence(context) - self.profile.plan.incidence, 0.0)
        growth = 1.0 + _INCIDENCE_GROWTH * oblique / _INCIDENCE_SCALE
        covariance = tracker_covariance(self.profile.tracker, context.p_M) * growth[:, None, None] ** 2
        return np.asarray(covariance + EXPECTED_SCATTER_M**2 * np.eye(3))


def information_model(
    profile: Profile, name: str, q: Array, conditions: MeasurementConditions, *, potential: bool = True
) -> InformationModel:
    """Choose the columns of an arm from some of its candidates ``q`` (n, N) [rad] under ``conditions``.

    Each effect is represented by the simplest form that a plan can show, by the middle one of its laws (of several
    onsets or time constants), and by those columns of it that are not refinements and have at most two cycles per
    revolution.

    Raises
    ------
    InputError
        If the profile lists an effect that is not in the library or that no plan of this cell can show, its parameter
        set is not for this arm, or it does not describe the cell.
    """
    model = nominal_model(profile, name)
    parameters, priors = geometry_priors(profile, name, model)
    registered = np.array([_REGISTRATION[unit] for unit in parameters.units])
    some = np.arange(min(len(q), _REFERENCE_STOPS))
    context = model.context(q[some], conditions=conditions.take(some))
    of_effects = list(_effect_parts(profile, name, context))
    potential_terms = list(_potential_terms(context)) if potential else []
    parts = (*of_effects, *potential_terms)
    of_geometry = np.where(np.isfinite(priors), priors, registered)
    size = np.concatenate([of_geometry, *(its for _, its in parts)])
    wanted = len(size) - sum(len(its) for _, its in potential_terms)
    return InformationModel(profile, name, model, parameters, tuple(part for part, _ in parts), size, wanted)


def geometry_priors(profile: Profile, name: str, model: ArmModel) -> tuple[ParameterSet, Array]:
    """Return the parameters of an arm's geometry, and the prior standard deviation of each.

    Raise ``InputError`` if the set of the profile is not for this arm.
    """
    stated = prior_sigmas(model.nominal, profile.calibration.priors, profile.arms[name].fixed)
    try:
        parameters, _ = estimated_parameters(profile.calibration.parameter_set, model.nominal, stated)
    except ValueError as error:
        raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None
    return parameters, prior_sds(parameters, {**typical_spreads(model.nominal.joints), **stated})


def _effect_parts(profile: Profile, name: str, context: EffectContext) -> Iterator[tuple[ModelTerm, Array]]:
    """Yield the wanted effects of an arm, each with the sizes of its coefficients."""
    listed = profile.plan.effects
    unknown = [slug for slug in listed or () if slug not in EFFECTS or slug == UNKNOWN]
    if unknown:
        known = ", ".join(slug for slug in EFFECTS if slug != UNKNOWN)
        refusal = f"; {why}" if (why := EFFECTS.refusal(unknown[0])) else ""
        raise InputError(f"plan.effects: '{unknown[0]}' is no effect of the library; known are: {known}{refusal}")
    for slug in EFFECTS if listed is None else dict.fromkeys(listed):
        if slug == UNKNOWN:
            continue
        lacking = EFFECTS[slug].missing_data(context)
        laws = [] if lacking else EFFECTS[slug].laws(context)
        if laws:
            simplest = [law for law in laws if law.form == laws[0].form]
            yield from _sized(slug, simplest[len(simplest) // 2], context, EXPECTED_EFFECT_M)
        elif listed is not None:
            raise InputError(
                f"plan.effects: '{slug}': no plan of this cell can show it in arm {name} ({lacking}); remove it"
            )


def _potential_terms(context: EffectContext) -> Iterator[tuple[ModelTerm, Array]]:
    """Yield periodic errors of several cycles per revolution of each joint that moves the SMR; nothing without any."""
    joints = range(1, context.joints + 1)
    waves = frozenset(f"{wave}{n}q{j}" for j in joints for n in POTENTIAL_CYCLES for wave in ("cos", "sin"))
    law = EFFECTS[TRANSMISSION_ERROR].law("lines")
    return _sized(TRANSMISSION_ERROR, law, context, POTENTIAL_M, waves)


def _sized(
    slug: str, law: Law, context: EffectContext, expected_m: float, names: frozenset[str] | None = None
) -> Iterator[tuple[ModelTerm, Array]]:
    """Yield the columns of a law that move the SMR, with coefficients that displace it by ``expected_m`` rms."""
    chosen, sizes = [], []
    columns, joints = EFFECTS[slug].columns(context, law, names), tuple(6 + 5 * j for j in range(context.joints))
    displaced = whitened_displacements(
        columns, jacobian(context.geometry, JointAngles.of(context.q), joints)[1], _unit(len(context))
    )
    rms_m = np.sqrt(np.einsum("md,md->m", displaced, displaced) / len(context))
    for column, rms in zip(columns, rms_m.tolist(), strict=True):
        bound = max(abs(column.lower), abs(column.upper))
        refines = column.refines or (names is None and (column.cycles or 0) > _MOST_CYCLES)
        if not refines and rms * min(bound, 1.0) > _LEAST_EFFECT_M:
            chosen.append(column.name)
            sizes.append(min(expected_m / rms, bound))
    if chosen:
        yield ModelTerm(slug, law, tuple(chosen)), np.array(sizes)


def _unit(n: int) -> Array:
    """Return the identity as whitening (3, 3, n)."""
    return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))


def incidence(context: EffectContext) -> Array:
    """Compute the angle (n,) [rad] between the beam and the SMR's viewing direction; 0 where this is not known."""
    if context.smr_normal is None:
        return np.zeros(len(context))
    normal = context.frames[0][-1] @ context.smr_normal
    return np.asarray(np.arccos(np.clip(-np.einsum("na,na->n", normal, context.beam[1]), -1.0, 1.0)))


def even_conditions(
    profile: Profile, name: str, q: Array, every: Mapping[str, Array], rng: np.random.Generator
) -> MeasurementConditions:
    """Sample conditions as ``sampled_conditions`` does, but equally informative at all stops: only signs are sampled.

    Steps have their rms size, times their rms distance from the middle of the run. Otherwise the choice would prefer
    stops with large steps at the beginning or the end of the run, which the plan then changes.
    """
    sampled = sampled_conditions(profile, name, q, every, rng)
    half = 0.5 * _SECONDS_A_STOP * profile.plan.stops
    time_s = half * (1.0 + rng.choice((-1.0, 1.0), len(q)) / math.sqrt(3.0))
    step = sampled.step
    if profile.plan.steps and step is not None:
        step = np.sign(step) * math.sqrt(float(np.mean(np.square(profile.plan.steps))))
    return replace(sampled, step=step, time_s=time_s, order=_places(time_s))


def sampled_conditions(
    profile: Profile, name: str, q: Array, every: Mapping[str, Array], rng: np.random.Generator
) -> MeasurementConditions:
    """Sample independent conditions of readings at ``q`` (n, N) [rad], for factors of a plan that are not decided yet.

    ``every`` are configurations of all arms; from them the pose of the only other arm at each stop is sampled.
    """
    n, plan = len(q), profile.plan
    if plan.steps:
        step = rng.choice(plan.steps, q.shape) * rng.choice((-1.0, 1.0), q.shape)
    else:  # straight from another stop
        step = q - q[rng.permutation(n)]
    time_s = rng.uniform(0.0, _SECONDS_A_STOP * plan.stops, n)
    moment, other_q = None, None
    others = [other for other in every if other != name]
    if len(others) == 1:
        model, its = nominal_model(profile, others[0]), every[others[0]]
        other_q = its[rng.integers(0, len(its), n)]
        moment = base_moment(model.geometry, model.bodies, other_q, model.up_M)
    return MeasurementConditions(
        approach=np.sign(step),
        step=step,
        dwell_s=rng.choice(plan.dwell, n),
        time_s=time_s,
        order=_places(time_s),
        payload_kg=np.full(n, profile.arms[name].payload.mass),
        other_moment_M=moment,
        other_q=other_q,
    )


def _places(time_s: Array) -> Array:
    """Return ranks (n,) in the order of time, from 0."""
    return np.argsort(np.argsort(time_s, kind="stable")).astype(np.float64)
