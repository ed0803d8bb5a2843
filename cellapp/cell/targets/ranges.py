"""Ranges that the readings of an arm covered: plausible values of conditions that are not stated, and joint ranges.

Additional uncertainty due to a payload that no reading had, from all plausible elastic behaviour of the joints.

The elasticity law that a search accepted is valid for the loads of the readings. For other loads more laws are
plausible: drives are stiffer under load, masses differ from the stated ones, and the compliance of a joint that its own
weight hardly loads is known only to be that of such drives. So all of these are fitted together with all geometry to
the readings as they are:

    dq_j = c_j tau_j + sum_k s_jk clip(tau_j, -T_k, T_k) + h_j (tau_j - clip(tau_j, -T, T)) + sum_i m_ji tau_ji,

where tau_j is the torque about joint j, tau_ji that of body i alone, T the largest one among the readings and T_k
fractions of it [Nm]. c_j has a prior as wide as such drives; the priors of m_ji and s_jk are fractions of the joint's
compliance (m, and r), that of h_j a quarter of r's. r is averaged over some values, weighted by their evidence
(marginal likelihood), so that readings which show straight laws keep straight ones likely for other loads. Beyond that
the readings do not constrain h_j.

From the nearest measured payload m' to m the SMR then moves by the mean of all this, with covariance C. The accepted
law predicts a different motion; the difference d remains as an error of the commands. Therefore the second moment about
the accepted law counts: C + d d^T.

Possible displacement of the SMR because a condition that effects of the model depend on was not stated.

A condition that is not stated is assumed at a default: payload as in the profile, temperatures at the mean of the run,
time at its end, dwell as in the run. A side of approach is chosen and stated with the command: the
effect of another side is reported, but is not an uncertainty. Plausible ranges are

- payload: from the profile's to what the run covered; no unknown if all readings had the profile's payload;
- temperature and time: what the run covered. A stated time that it did not cover is as unknown: what sways or drifts
  does not stay as it was at the end of the run;
- dwell: from zero to the longest of the run, because production may not wait.

The stated size is the largest distance of the SMR from its position at the default; the covariance is the second moment
of that displacement, with conditions distributed uniformly over their ranges.

Working conditions of goals for the model: what targets state, and the state of the other arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.targets.records import UnknownCondition
from cellapp.cell.targets.targets import Target, WorkingConditions
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.estimation.uncertainty.budget import Range, range_of
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.effects import (
    EFFECTS,
    EffectContext,
    EffectTerm,
    InputVariable,
    MeasurementConditions,
    TemperatureRecord,
    displacement,
)
from cellapp.robot.kinematics.chain import JointAngles, jacobian, joint_jacobian
from cellapp.robot.kinematics.inverse import Inverted
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel
from cellapp.robot.model.inverse import invert


def conditions_of(target: Target, arm: str) -> WorkingConditions:
    """Return what a target states for one of its arms."""
    partner = target.partner
    return target.conditions if partner is None or target.arm == arm else partner.conditions


def stated_conditions(profile: Profile, targets: Sequence[Target], arm: str) -> MeasurementConditions:
    """Return what n targets state for ``arm``; NaN, or zero for approach signs, if a target states nothing.

    The centre of mass of a payload is that of the profile's load of this mass. A temperature is that of the air and of
    all joints. The approach that a target states is that of its first arm.
    """
    stated, joints = [conditions_of(target, arm) for target in targets], len(profile.arms[arm].type.joints)
    temperature = _column([one.temperature for one in stated])
    approach = np.zeros((len(targets), joints))
    for row, target in enumerate(targets):
        if target.approach is not None and target.arm == arm:
            approach[row] = target.approach
    return MeasurementConditions(
        approach=approach if approach.any() else None,
        dwell_s=_column([one.dwell for one in stated]),
        time_s=_column([one.time for one in stated]),
        payload_kg=_column([one.payload for one in stated]),
        payload_center_F=load_centers(profile.arms[arm], [one.payload for one in stated]),
        air_c=temperature,
        joints_c=None if temperature is None else np.tile(temperature[:, None], (1, joints)),
    )


def load_centers(arm: Arm, payloads_kg: Sequence[float | None]) -> Array | None:
    """Return centres of mass (n, 3) [m] of listed loads in the flange frame, NaN for others; None if none is listed."""
    if not arm.payloads:
        return None
    listed = [None if mass is None else arm.listed_load(mass) for mass in payloads_kg]
    return np.array([[np.nan] * 3 if one is None else one.center_of_mass for one in listed])


def conditions_payload(conditions: MeasurementConditions, nominal_kg: float, n: int) -> Array:
    """Return the payload (n,) [kg] of n goals: as stated, else the profile's ``nominal_kg``."""
    stated = conditions.payload_kg
    return np.full(n, nominal_kg) if stated is None else np.where(np.isnan(stated), nominal_kg, stated)


def _column(values: Sequence[float | None]) -> Array | None:
    """Return values (n,) with NaN for what is not stated; None if nothing is."""
    if all(value is None for value in values):
        return None
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


_COMPLIANCE = 1e-4
"""Prior standard deviation [rad/Nm]: strain-wave drives of this class have 1e4 to 1e5 Nm/rad (Harmonic Drive, CSG)."""
_KNEES = (0.15, 0.35, 0.65)
"""Fractions of the largest torque below which a joint may be softer."""
_BENT = (0.01, 0.1, 0.5)
"""Values of r, relative to a joint's compliance: catalogues have K3 / K1 up to 2."""
_OF_MASSES = 0.2
"""Value of m: makers' masses are 10 to 30 % off. One load cannot separate a common mass error from compliance."""
_BEYOND = 0.25
"""Fraction of r for torques beyond all measured ones: drives stiffen most at small torques."""
_DEPENDENT = 1e-9
"""Relative singular value below which columns of the geometry count as linearly dependent."""
_ELASTIC = ("joint_compliance", "payload_compliance")


@dataclass(frozen=True, eq=False)
class OpenElasticity:
    """Elastic behaviour of an arm's joints that its readings leave plausible.

    Attributes
    ----------
    values : array, shape (p,)
        Mean of the parameters of ``_columns`` [rad/Nm].
    covariance : array, shape (p, p)
    largest_nm : array, shape (N,)
        Largest torque about each joint among the readings [Nm].
    """

    values: Array
    covariance: Array
    largest_nm: Array

    @classmethod
    def of(cls, arm: ArmModel, readings: Readings) -> OpenElasticity | None:
        """Fit to readings with the model in force; None without a posterior, which has the scatter of the readings, or
        without measured positions."""
        readings = readings.take(np.flatnonzero(np.isfinite(readings.p_M).all(axis=1)))
        if arm.posterior is None or not len(readings):
            return None
        conditions = measurement_conditions(readings)
        context = arm.context(readings.q, conditions=conditions)
        angles, largest_nm = JointAngles.of(readings.q), np.abs(context.torques).max(axis=0)
        _, J = joint_jacobian(arm.geometry, angles)
        _, G = jacobian(arm.geometry, angles, arm.posterior.columns)
        joint, kind, offsets = _columns(context, largest_nm)
        residual = (readings.p_M - arm.predict(readings.q, conditions=conditions)).T
        residual = residual + np.einsum("cjn,nj->cn", J, _by_accepted_laws(arm, context))
        A, y, free = _rows(J[:, joint] * offsets), residual.ravel(), _rows(G)
        basis, sizes, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)
        basis = basis[:, sizes > _DEPENDENT * sizes[0]]
        A, y = A - basis @ (basis.T @ A), y - basis @ (basis.T @ y)
        variance = arm.posterior.noise.m**2
        return cls(*_averaged(A.T @ A / variance, A.T @ y / variance, joint, kind), largest_nm)


def payload_covariance(
    arm: ArmModel,
    q: Array,
    conditions: MeasurementConditions,
    near: MeasurementConditions,
    open_: OpenElasticity | None,
) -> Array:
    """Return the covariance (n, 3, 3) [m^2] at ``q`` (n, N) [rad] for ``conditions`` whose payload was not measured.

    ``near`` has the nearest measured payload. If both have a measured orientation, it is that of the rotation [rad^2].
    """
    if open_ is None or near is conditions:
        return np.zeros((len(q), 3, 3))
    asked, known = (arm.context(q, conditions=one) for one in (conditions, near))
    joint, _, offsets = _columns(asked, open_.largest_nm)
    more = offsets - _columns(known, open_.largest_nm)[2]
    _, J = joint_jacobian(arm.geometry, JointAngles.of(q, conditions.R_M_S))
    moved = (J[:, joint] * more).transpose(2, 0, 1)
    C = moved @ open_.covariance @ moved.transpose(0, 2, 1)
    accepted = _by_accepted_laws(arm, asked) - _by_accepted_laws(arm, known)
    d = moved @ open_.values - np.einsum("cjn,nj->nc", J, accepted)
    return np.asarray(C + d[:, :, None] * d[:, None])


def _columns(context: EffectContext, largest_nm: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return each parameter's joint (p,), kind (p,) (0 compliance, 1 bend of the law, 2 mass) and offsets (p, n)."""
    torque, N = context.torques.T, context.joints
    clipped = [np.clip(torque, -share * largest_nm[:, None], share * largest_nm[:, None]) for share in (*_KNEES, 1.0)]
    bodies = [(j, context.loads.torques_of(i)[:, j]) for i in range(N) for j in range(i + 1)]
    straight = [torque, *clipped[:-1], _BEYOND * (torque - clipped[-1])]
    joint = np.concatenate([np.tile(np.arange(N), len(straight)), [j for j, _ in bodies]]).astype(np.intp)
    kind = np.repeat([0, 1, 2], [N, N * (len(straight) - 1), len(bodies)])
    return joint, kind, np.concatenate([*straight, np.array([one for _, one in bodies])])


def _averaged(gram: Array, moment: Array, joint: NDArray[np.intp], kind: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return mean and covariance of the parameters over all values of r, weighted by their evidence."""
    first = kind == 0
    of_joint = np.linalg.inv(gram[np.ix_(first, first)] + np.eye(int(first.sum())) / _COMPLIANCE**2)
    size = np.sqrt(np.diag(of_joint) + (of_joint @ moment[first]) ** 2)
    logs, means, covariances = [], [], []
    for bent in _BENT:
        sd = np.select([first, kind == 1], [_COMPLIANCE, bent * size[joint]], _OF_MASSES * size[joint])
        inner = sd[:, None] * gram * sd + np.eye(len(sd))
        covariances.append(sd[:, None] * np.linalg.inv(inner) * sd)
        means.append(covariances[-1] @ moment)
        logs.append(0.5 * float(moment @ means[-1]) - 0.5 * float(np.linalg.slogdet(inner)[1]))
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    off = np.array(means) - mean
    return mean, np.einsum("g,gab->ab", weights, np.array(covariances)) + (weights * off.T) @ off


def _by_accepted_laws(arm: ArmModel, context: EffectContext) -> Array:
    """Return joint offsets (n, N) [rad] by the elastic joints of the model."""
    elastic = [term for term in arm.effects if term.slug in _ELASTIC]
    return displacement(elastic, EFFECTS, context).joints


def _rows(columns: Array) -> Array:
    """Reshape derivatives (3, k, n) into one column per parameter: (3 n, k)."""
    return np.asarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1]))


# -- Measuring noise at any point: with the shape that the tracker states and the size of the readings' scatter -------
#
# A laser tracker measures distances better than directions; both errors grow with the distance. The repeatability of
# the arm is isotropic.


@dataclass(frozen=True)
class MeasuringNoise:
    """Standard uncertainties that the tracker states: a constant [m] and a part proportional to distance [m/m].

    ``along`` and ``across`` are relative to the beam; ``typical`` is their mean square [m^2] over the readings.
    """

    along: tuple[float, float]
    across: tuple[float, float]
    typical: float

    @classmethod
    def of(cls, readings: Readings) -> MeasuringNoise | None:
        """Fit to the covariances that an arm's readings state; None if they state none."""
        stated = readings.covariance_M
        if stated is None or not np.isfinite(stated).all():
            return None
        distance = np.linalg.norm(readings.p_M, axis=1)
        beam = readings.p_M / distance[:, None]
        along = np.einsum("na,nab,nb->n", beam, stated, beam)
        whole = np.trace(stated, axis1=1, axis2=2)
        across = np.sqrt(np.maximum(0.5 * (whole - along), 0.0))
        return cls(_line(distance, np.sqrt(along)), _line(distance, across), float(np.mean(whole)) / 3.0)

    def excess(self, noise_m: Array) -> Array:
        """Return the variance (n,) [m^2] of a coordinate by which readings scatter more than the tracker states.

        It is repeatability or a deficiency of the model: the SMR itself deviates by as much.
        """
        return np.asarray(np.maximum(noise_m**2 - self.typical, 0.0))

    def covariance(self, p_M: Array, noise_m: Array) -> Array:
        """Return the covariance (n, 3, 3) [m^2] of readings at ``p_M`` (n, 3) [m] that scatter by ``noise_m`` (n,).

        Scatter beyond what the tracker states is added isotropically.
        """
        distance = np.linalg.norm(p_M, axis=1)
        beam = p_M / distance[:, None]
        along, across = (
            (constant + proportional * distance)[:, None, None] ** 2
            for constant, proportional in (self.along, self.across)
        )
        outer = beam[:, :, None] * beam[:, None]
        stated = along * outer + across * (np.eye(3) - outer)
        less = np.minimum(noise_m**2 / self.typical, 1.0)
        return np.asarray(stated * less[:, None, None] + np.multiply.outer(self.excess(noise_m), np.eye(3)))


def _line(distance: Array, sigma: Array) -> tuple[float, float]:
    """Fit constant and proportional part of standard uncertainties (n,) [m]; a constant if distances hardly differ."""
    if np.ptp(distance) < 0.1 * distance.mean():
        return float(sigma.mean()), 0.0
    slope, constant = np.polyfit(distance, sigma, 1)
    return float(constant), float(slope)


MARGIN = np.radians(2.0)
"""Margin [rad] of the joint ranges without extrapolation: model corrections vary over tens of degrees."""


@dataclass(frozen=True, eq=False)
class ConditionRanges:
    """Ranges over the readings of one arm; None for what they do not state.

    Attributes
    ----------
    q : array, shape (2, N), or None
        Lowest and highest joint positions [rad].
    step : array, shape (N,), or None
        Median size of each joint's last motion [rad].
    payload_kg, dwell_s, time_s, air_c : pair or None
    payload_centers_F : array, shape (2, 3)
        Centres of mass of the lightest and of the heaviest payload [m]; NaN for the nominal one.
    joints_c : array, shape (2, N), or None
        Lowest and highest temperature of each joint [degC].
    stops : int
        Number of readings, in the order of measurement.
    record : TemperatureRecord or None
        Temperatures of the whole run, for effects with a time lag.
    noise : MeasuringNoise or None
        Noise that the tracker stated.
    elasticity : OpenElasticity or None
        Plausible elastic behaviour under payloads that no reading had.
    """

    q: Array | None = None
    step: Array | None = None
    payload_kg: Range | None = None
    payload_centers_F: Array = field(default_factory=lambda: np.full((2, 3), np.nan))
    dwell_s: Range | None = None
    time_s: Range | None = None
    air_c: Range | None = None
    joints_c: Array | None = None
    stops: int = 0
    record: TemperatureRecord | None = None
    noise: MeasuringNoise | None = None
    elasticity: OpenElasticity | None = None

    @classmethod
    def of(cls, readings: Readings, arm: ArmModel | None = None) -> ConditionRanges:
        """Return the ranges of an arm's readings; ``elasticity`` only if its model is given."""
        if not len(readings):
            return cls()
        known = measurement_conditions(readings)
        joints_c = known.joints_c
        return cls(
            q=np.stack([readings.q.min(axis=0), readings.q.max(axis=0)]),
            step=None if known.step is None else np.nan_to_num(np.nanmedian(np.abs(known.step), axis=0)),
            payload_kg=range_of(known.payload_kg),
            payload_centers_F=_centers_of_ends(known),
            dwell_s=range_of(known.dwell_s),
            time_s=range_of(known.time_s),
            air_c=range_of(known.air_c),
            joints_c=None
            if joints_c is None or not np.isfinite(joints_c).all()
            else np.stack([joints_c.min(axis=0), joints_c.max(axis=0)]),
            stops=len(readings),
            record=known.record,
            noise=MeasuringNoise.of(readings),
            elasticity=None if arm is None else OpenElasticity.of(arm, readings),
        )

    def nearest_loaded(self, arm: ArmModel, q: Array, conditions: MeasurementConditions) -> MeasurementConditions:
        """Return ``conditions`` at ``q`` (n, N) [rad] with the nearest measured payload and its centre of mass.

        Readings without payloads had the arm's usual one. If ``elasticity`` is unknown, the conditions are unchanged.
        """
        if self.elasticity is None:
            return conditions
        low, high = self.payload_kg or (arm.bodies.payload_mass, arm.bodies.payload_mass)
        asked_kg = conditions_payload(conditions, arm.bodies.payload_mass, len(q))
        if bool(np.all((low <= asked_kg) & (asked_kg <= high))):
            return conditions
        center_F = np.tile(np.full(3, np.nan), (len(q), 1))
        if conditions.payload_center_F is not None:
            center_F = conditions.payload_center_F.copy()
        for beyond, its in zip((asked_kg < low, asked_kg > high), self.payload_centers_F, strict=True):
            center_F[beyond] = its
        return replace(conditions, payload_kg=np.clip(asked_kg, low, high), payload_center_F=center_F)

    def nearest_measured(self, q: Array) -> Array:
        """Return the configurations nearest to ``q`` (n, N) [rad] within the joint ranges of readings, plus 2 deg."""
        if self.q is None:
            return q
        return np.clip(q, self.q[0] - MARGIN, self.q[1] + MARGIN)


def _centers_of_ends(known: MeasurementConditions) -> Array:
    """Return the centres of mass (2, 3) [m] of the lightest and of the heaviest payload."""
    if known.payload_kg is None or known.payload_center_F is None or not np.isfinite(known.payload_kg).any():
        return np.full((2, 3), np.nan)
    return known.payload_center_F[[np.nanargmin(known.payload_kg), np.nanargmax(known.payload_kg)]]


_POINTS = np.linspace(0.0, 1.0, 5)
"""Relative positions in a range where effects are evaluated: effects are monotonic or slow in their conditions."""
_MATTERS_M = 1e-6
"""Smallest displacement [m] that matters: a command may miss its target by a micrometre anyway."""


@dataclass(frozen=True, eq=False)
class OneUnknown:
    """Effect of one unknown condition at n commands.

    Attributes
    ----------
    condition : str
    effects : tuple of str
        Slugs of the effects that depend on it.
    largest_m : array, shape (n,)
        Largest distance of the SMR from its position at the default [m]; zero if the condition is stated.
    covariance : array, shape (n, 3, 3)
        Second moment of that displacement [m^2].
    """

    condition: str
    effects: tuple[str, ...]
    largest_m: Array
    covariance: Array

    def take(self, rows: NDArray[np.intp]) -> OneUnknown:
        """Return the same for some of the commands."""
        return replace(self, largest_m=self.largest_m[rows], covariance=self.covariance[rows])


def unknown_conditions(
    arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges
) -> list[OneUnknown]:
    """Return the conditions, except the approach, that are not stated for some of n commands ``q`` (n, N) [rad] and
    that matter there."""
    found = [_over_range(condition, arm, q, conditions, spans) for condition, spans in _spans(arm, ranges).items()]
    found.append(_dwell(arm, q, conditions, ranges))
    return [one for one in found if one is not None and one.largest_m.max(initial=0.0) >= _MATTERS_M]


def unknown_records(found: Sequence[OneUnknown], row: int) -> tuple[UnknownCondition, ...]:
    """Return the conditions that matter to one command, for its result."""
    return tuple(
        UnknownCondition(condition=one.condition, effects=one.effects, mm=float(one.largest_m[row]) * 1e3)
        for one in found
        if one.largest_m[row] >= _MATTERS_M
    )


# -- inside -----------------------------------------------------------------------------------------------------------

_Spans = Mapping[str, tuple[float, float] | Array | None]
"""Field of ``MeasurementConditions`` -> its lowest and highest value; None: unknown."""

_DEPENDENT_ON_CONDITIONS = {
    "approach": frozenset({InputVariable.APPROACH, InputVariable.STEP}),
    "payload": frozenset({InputVariable.PAYLOAD, InputVariable.TORQUE}),
    "temperature": frozenset({InputVariable.AIR_TEMPERATURE, InputVariable.JOINT_TEMPERATURE}),
    "time": frozenset({InputVariable.TIME}),
    "dwell": frozenset({InputVariable.DWELL}),
}
_STATED = {"payload": "payload_kg", "temperature": "air_c", "time": "time_s", "dwell": "dwell_s"}


def _dependent(arm: ArmModel, condition: str) -> tuple[EffectTerm, ...]:
    """Return the model's effects that depend on a condition."""
    return tuple(term for term in arm.effects if _variables(term) & _DEPENDENT_ON_CONDITIONS[condition])


def _variables(term: EffectTerm) -> frozenset[InputVariable]:
    own = term.law.form.variables or EFFECTS[term.slug].variables
    return own | {one.variable.quantity.input for one in term.modulations if one.variable is not None}


def _unstated(conditions: MeasurementConditions, condition: str, n: int, spans: _Spans) -> NDArray[np.bool_]:
    """Return the rows (n,) that state no value, or a time outside of its span."""
    values = getattr(conditions, _STATED[condition])
    low, high = spans.get("time_s") or (-np.inf, np.inf)
    return np.ones(n, dtype=bool) if values is None else ~((low <= values) & (values <= high))


def _shift_by(
    arm: ArmModel, terms: tuple[EffectTerm, ...], q: Array, R_M_S: Array | None
) -> Callable[[MeasurementConditions], Array]:
    """Return the function conditions -> displacement (n, 3) [m] of the SMR by some effects at ``q`` (n, N) [rad], to
    first order in the joint offsets."""
    _, by_joint = joint_jacobian(arm.geometry, JointAngles.of(q, R_M_S))
    only = replace(arm, effects=terms, network=None, posterior=None)

    def shift(conditions: MeasurementConditions) -> Array:
        moved = only.effect_displacement(q, conditions=conditions)
        return np.asarray(moved.shift_M + np.einsum("cjn,nj->nc", by_joint, moved.joints))

    return shift


def _slugs(terms: Sequence[EffectTerm]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(term.slug for term in terms))


def _driven(
    conditions: MeasurementConditions, stated: Array, joint: int, side: float, ranges: ConditionRanges
) -> MeasurementConditions:
    """Return the conditions with one joint arriving from one side, with the run's usual step size if known."""
    approach = stated.copy()
    approach[:, joint] = side
    return replace(conditions, approach=approach, step=None if ranges.step is None else approach * ranges.step)


def _dwell(arm: ArmModel, q: Array, conditions: MeasurementConditions, ranges: ConditionRanges) -> OneUnknown | None:
    """Return the effect of a shorter rest: more of each joint's last motion remains, for either side."""
    terms = _dependent(arm, "dwell")
    if not terms or ranges.dwell_s is None or ranges.step is None:
        return None
    shift, n = _shift_by(arm, terms, q, conditions.R_M_S), len(q)
    rows = _unstated(conditions, "dwell", n, {})
    each = []
    for joint in range(q.shape[1]):
        driven = _driven(conditions, np.zeros(q.shape), joint, 1.0, ranges)
        default = shift(driven)
        each.append(
            [shift(replace(driven, dwell_s=np.full(n, place * ranges.dwell_s[1]))) - default for place in _POINTS]
        )
    moved = np.where(rows[:, None, None], np.array(each).transpose(1, 2, 0, 3), 0.0)
    largest = np.max([_largest_sum(one) for one in moved], axis=0)
    covariance = np.mean([_second_moment(one) for one in moved], axis=0)
    return OneUnknown("dwell", _slugs(terms), largest, covariance)


def _over_range(
    condition: str, arm: ArmModel, q: Array, conditions: MeasurementConditions, spans: _Spans
) -> OneUnknown | None:
    """Return the effect of a condition that moves the SMR along one curve over its range."""
    terms = _dependent(arm, condition)
    if not terms:
        return None
    shift, n = _shift_by(arm, terms, q, conditions.R_M_S), len(q)

    def at(place: float) -> MeasurementConditions:
        values: dict[str, Any] = {
            key: None if span is None else np.full((n, *np.shape(span)[1:]), span[0] + place * (span[1] - span[0]))
            for key, span in spans.items()
        }
        return replace(conditions, **values)

    default = shift(conditions)
    moved = np.array([shift(at(place)) - default for place in _POINTS.tolist()])
    moved = np.where(_unstated(conditions, condition, n, spans)[:, None], moved, 0.0)
    largest = np.linalg.norm(moved, axis=2).max(axis=0)
    covariance = np.einsum("pna,pnb->nab", moved, moved) / len(moved)
    return OneUnknown(condition, _slugs(terms), largest, covariance)


def _spans(arm: ArmModel, ranges: ConditionRanges) -> dict[str, _Spans]:
    """Return the plausible range of each condition that has one: what the run covered, and the usual payload."""
    found, usual_kg = dict[str, _Spans](), arm.bodies.payload_mass
    low, high = ranges.payload_kg or (usual_kg, usual_kg)
    if low != usual_kg or high != usual_kg:
        found["payload"] = {"payload_kg": (min(low, usual_kg), max(high, usual_kg))}
    if ranges.air_c is not None or ranges.joints_c is not None:
        found["temperature"] = {"air_c": ranges.air_c, "joints_c": ranges.joints_c}
    if ranges.time_s is not None or ranges.stops > 1:
        found["time"] = {"time_s": ranges.time_s or (np.nan, np.nan), "order": (0.0, ranges.stops - 1.0)}
    return found


def _largest_sum(vectors: Array) -> Array:
    """Return the largest length (n,) of the sum of vectors (n, N, 3), each with either sign."""
    signs = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=vectors.shape[1] - 1)])
    return np.asarray(np.linalg.norm(np.einsum("sj,njc->nsc", signs, vectors), axis=2).max(axis=1))


def _second_moment(vectors: Array) -> Array:
    """Return the covariance (n, 3, 3) of the sum of vectors (n, N, 3), each with a random sign."""
    return np.asarray(np.einsum("nja,njb->nab", vectors, vectors))


# -- Sides of approach: the side from which each joint arrives at a command, which is valid for it and states it ------
#
# Backlash, hysteresis and friction make the SMR depend on where a joint came from. A target may state the side. If it
# does not, and the side matters to the model, the command is for the way from home; its signs are stated wherever the
# command is written, so that an operator can drive accordingly.


def sided_commands(
    arm: ArmModel,
    position_M: Array,
    rotation_M: Array,
    found: Inverted,
    conditions: MeasurementConditions,
    home: Array,
    ranges: ConditionRanges,
) -> tuple[Inverted, MeasurementConditions, Array, OneUnknown | None]:
    """Invert the model again for the sides of arrival, starting from n commands ``found`` for the middle of both sides.

    ``position_M`` (n, 3) and ``rotation_M`` (n, 3, 3) are as in ``invert``; the way begins at ``home`` (N,) [rad].

    Returns
    -------
    found : Inverted
        Commands for the sides.
    conditions : MeasurementConditions
        Conditions that these are for: as stated by the targets, and the sides.
    signs : array, shape (n, N)
        Sign of each joint's last motion, as stated or as on the way from home; 0 if it does not matter.
    others : OneUnknown or None
        Effect of other sides; None if no effect depends on them.
    """
    q, terms = found.q, _dependent(arm, "approach")
    stated = np.zeros(q.shape) if conditions.approach is None else np.asarray(conditions.approach, dtype=np.float64)
    if not terms or not len(q):
        return found, conditions, stated, None
    vectors, step = _side_vectors(arm, terms, q, conditions, stated, ranges), q - home
    offered = np.where(step < 0.0, -1.0, 1.0) * (np.linalg.norm(vectors, axis=2) >= _MATTERS_M)
    signs = np.where(stated != 0.0, stated, offered)
    rows = np.flatnonzero(offered.any(axis=1))
    if not len(rows):
        return found, conditions, signs, _other_sides(terms, vectors, signs)
    usual = np.full(q.shape[1], np.nan) if ranges.step is None else ranges.step
    sizes = np.where(stated != 0.0, usual, np.abs(step))
    made = replace(conditions, approach=signs, step=sizes * signs)
    again = invert(arm, position_M[rows], rotation_M[rows], q[rows], made.take(rows))
    kept = found.take(np.arange(len(q)))
    kept.put(rows[again.reached], again, again.reached)
    lost = np.setdiff1d(rows, rows[again.reached])  # such a command stays at the middle, without a side
    signs[lost] = stated[lost]
    if len(lost):
        made = replace(made, approach=signs, step=np.where(signs == 0.0, np.nan, sizes * signs))
    return kept, made, signs, _other_sides(terms, vectors, signs)


def _side_vectors(
    arm: ArmModel,
    terms: tuple[EffectTerm, ...],
    q: Array,
    conditions: MeasurementConditions,
    stated: Array,
    ranges: ConditionRanges,
) -> Array:
    """Return the displacement (n, N, 3) [m] of the SMR by each joint's positive side from the middle of both sides.

    It is zero for the sides ``stated`` (n, N).
    """
    shift = _shift_by(arm, terms, q, conditions.R_M_S)
    vectors = []
    for joint in range(q.shape[1]):
        plus, minus = (shift(_driven(conditions, stated, joint, side, ranges)) for side in (1.0, -1.0))
        vectors.append(np.where(stated[:, joint, None] == 0.0, 0.5 * (plus - minus), 0.0))
    return np.stack(vectors, axis=1)


def _other_sides(terms: Sequence[EffectTerm], vectors: Array, signs: Array) -> OneUnknown:
    """Return the effect of other sides than ``signs`` (n, N), for which the commands were computed.

    ``vectors`` are ``_side_vectors``. This is no uncertainty, because a command states its sides. A command without
    sides is computed for the middle; then either side is equally likely.
    """
    sided = np.any(signs != 0.0, axis=1)
    taken = 2.0 * signs[:, :, None] * vectors  # from the chosen side of a joint to the other one
    away = np.einsum("sj,njc->nsc", np.array(list(product((0.0, 1.0), repeat=taken.shape[1]))), taken)
    largest = np.linalg.norm(away, axis=2).max(axis=1)
    covariance = np.where(sided[:, None, None], 0.0, _second_moment(vectors))
    return OneUnknown("approach", _slugs(terms), np.where(sided, largest, _largest_sum(vectors)), covariance)


def signs_words(signs: Sequence[int]) -> str:
    """Format signs of last motions as in columns: ``-1 +1 0``."""
    return " ".join(f"{sign:+d}" if sign else "0" for sign in signs)


def from_home(conditions: MeasurementConditions, q: Array, home: Array) -> MeasurementConditions:
    """Return the conditions with joints of unknown approach arriving straight from home."""
    step = q - home
    approach = np.sign(step)
    if conditions.approach is not None:
        stated = np.asarray(conditions.approach, dtype=np.float64)
        approach = np.where(stated == 0.0, approach, stated)
    return replace(conditions, approach=approach, step=np.abs(step) * approach)
