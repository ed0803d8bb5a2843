"""Derive from a stored calibration what a check expects of every arm, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import conditions_of_arms, states_nothing
from cellapp.estimation.calibration.weights import excess_variance, mean_variance, with_excess
from cellapp.estimation.monitoring.check.records import CheckedArm, CheckVerdict, FoundChange
from cellapp.estimation.prior.belief import Measured, Posterior, design, is_smooth
from cellapp.estimation.prior.calibrate import calibration_posterior
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, apply
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import relocated

# -- Data classes of the check: belief of a calibration, power of stops, state of the test, conclusion ----------------
#
# A change is that of a parameter by 0.05 mm or 50 µrad, or of an effect such that the SMR moves by 0.05 mm rms. It is
# *visible* if it moves the SMR, rms over the readings of the calibration, by at least ``VISIBLE`` standard deviations
# of a measured coordinate (of tracker and arm together). The best-fitting motion of the tracker is subtracted first:
# what a motion of the tracker explains as well is no change of an arm. If a probe measures orientation too, its
# rotation by the change counts as well, in its own standard deviations.

LENGTH_M = 5e-5
"""Change of a length that the check has to detect [m]."""
TURN_RAD = 5e-5
"""Change of an angle that the check has to detect [rad]."""
FALSE_ALARM, MISS = 0.01, 0.05
"""Probabilities of a false alarm and of missing a visible change."""
VISIBLE = 1.0
"""Least motion of the SMR by a visible change, in standard deviations of a measured coordinate."""
TRACKER = "tracker"
"""Name that takes the place of an arm's if the tracker moved."""

ChangeKind = Literal["tracker", "base", "smr", "parameter", "effect"]


@dataclass(frozen=True, eq=False)
class ArmBelief:
    """Prediction of one arm by a calibration, with its uncertainty.

    Attributes
    ----------
    model : ArmModel
        Mean of the posterior, without a network. Its last terms are watched effects that the calibration does not
        have: their values are those that explain its readings best.
    columns : tuple of int, length K
        Geometric parameters, as indices into ``parameter_names``: base, D-H rows and tool.
    covariance : array, shape (p, p)
        Posterior covariance of the geometric parameters, then of the values of all terms.
    scatter_m : float
        Standard deviation of a measured coordinate beyond the stated uncertainty of the tracker [m], from held-out
        readings.
    noise_m : float
        Standard deviation of a measured coordinate, of tracker and arm together [m].
    day_m : float
        Rms motion of the SMR by effects of the day of the calibration, such as drift, of which today's are unknown [m].
    promised_m : float
        Root mean square length of the error of a prediction over the readings of the calibration [m].
    measured : Measured
        The readings of the calibration without gross errors, in the frame of ``model``: positions, then orientations
        where the check measures them.
    unexplained : array, shape (n, 3)
        Of the residuals of ``measured``, what a stop that is measured again is expected to show again [m, rad].
    scatter_rad, noise_rad : float
        As ``scatter_m`` and ``noise_m``, of a component of an orientation [rad]; zero where none is measured.
    """

    model: ArmModel
    columns: tuple[int, ...]
    covariance: Array
    scatter_m: float
    noise_m: float
    day_m: float
    promised_m: float
    measured: Measured
    unexplained: Array
    scatter_rad: float = 0.0
    noise_rad: float = 0.0

    @property
    def positions(self) -> Measured:
        """The positions among the readings of the calibration."""
        return self.measured.positions


@dataclass(frozen=True, eq=False)
class CheckBelief:
    """Predictions of a cell by a calibration.

    ``arms`` maps names to beliefs, in the expected frame of the tracker: the earlier one, or the approximate one of a
    new station. ``T_new_old`` (4, 4) maps the earlier frame into that; None if the tracker was not set up anew.
    ``station_free`` is True if it was set up anew, so that its motion is no change.
    """

    arms: Mapping[str, ArmBelief]
    station_free: bool = False
    T_new_old: Array | None = None

    @property
    def models(self) -> dict[str, ArmModel]:
        """Arm -> mean of its posterior."""
        return {name: arm.model for name, arm in self.arms.items()}


@dataclass(frozen=True, eq=False)
class Power:
    """How well some stops show one change of 0.05 mm or 50 µrad.

    ``noncentrality`` is the square of its size over its standard error, beside a station that is unknown where the
    belief says so; ``moved_mm`` the rms motion of the SMR by it over the calibration's readings after the best motion
    of the tracker; ``visible`` as defined above; ``detected`` the size in ``unit`` that is found with 95 %.
    """

    arm: str
    what: str
    kind: ChangeKind
    noncentrality: float
    moved_mm: float
    visible: bool
    unit: str
    detected: float


@dataclass(frozen=True, eq=False)
class ChosenStops:
    """Chosen stops as rows of the candidates, in the order of driving, and what they show when all are measured.

    ``needed`` is the non-centrality at which a change is detected with the asked power at the asked false alarms.
    """

    order: NDArray[np.intp]
    power: tuple[Power, ...]
    needed: float

    @property
    def weakest(self) -> Power | None:
        """The visible change that the stops show least; None if no change is visible."""
        visible = [one for one in self.power if one.visible]
        return min(visible, key=lambda one: one.noncentrality) if visible else None


@dataclass(frozen=True)
class SequentialState:
    """State of the sequential test after some stops.

    Attributes
    ----------
    stops : int
    sure : bool
        Whether the test has ended; nothing more has to be measured.
    changed, valid : bool
        Whether it is sure that something changed, or before the last stop that nothing visible did.
    log_evidence : float
        Log of the ratio of the likelihood of any change to that of none; a change is sure at log(1 / false alarm).
    log_valid : float
        Log of the least ratio of the likelihood of no change to that of a visible one; valid is sure at log(1 / miss).
    p_value : float
        Probability of errors as large if nothing has changed, by chi-squared.
    """

    stops: int
    sure: bool
    changed: bool
    valid: bool
    log_evidence: float
    log_valid: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Conclusion:
    """The outcome of a check, in the words and records of the result of ``check``.

    Attributes
    ----------
    verdict : CheckVerdict
    sure_after : int
        Stops after which the test ended.
    p_value : float
    changes : tuple of FoundChange
        Named changes of arms, bases, SMRs or the tracker, the most evident first, with their rivals.
    arms : mapping
        Arm -> CheckedArm.
    T_new_old : array, shape (4, 4), or None
        Motion of the tracker that was solved for: maps coordinates in its earlier frame into the present one.
    moved_bases : mapping
        Arm -> pose of its base (4, 4) in the tracker's frame, where the base moved.
    smr_offsets_F : mapping
        Arm -> centre of the SMR (3,) in the frame of the last joint [m], where the SMR was remounted.
    weak : tuple of Power
        Visible changes that the measured stops show with less than the asked power.
    notes : tuple of str
    """

    verdict: CheckVerdict
    sure_after: int
    p_value: float
    changes: tuple[FoundChange, ...]
    arms: Mapping[str, CheckedArm]
    T_new_old: Array | None
    moved_bases: Mapping[str, Array]
    smr_offsets_F: Mapping[str, Array]
    weak: tuple[Power, ...]
    notes: tuple[str, ...]

    @property
    def station_shift_mm(self) -> float | None:
        """Motion of what is at the earlier tracker's origin [mm], where a motion was solved for."""
        return None if self.T_new_old is None else float(np.linalg.norm(self.T_new_old[:3, 3])) * 1e3

    @property
    def station_turn_deg(self) -> float | None:
        """Turn of the tracker [deg], where a motion was solved for."""
        if self.T_new_old is None:
            return None
        R = self.T_new_old[:3, :3]
        sine = 0.5 * float(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]))
        return float(np.degrees(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))))


_REPEATS = 0.5
"""Share of the unexplained that a stop shows again: all of what depends on the position, nothing of what on the way."""
_FEWEST_HELD_OUT = 20
"""Fewest held-out readings with which their scatter is estimated."""


def check_belief(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    *,
    turned: Collection[str] = (),
    station_free: bool = False,
    T_new_old: Array | None = None,
) -> CheckBelief:
    """Build the belief of a check from a calibration.

    Parameters
    ----------
    profile : Profile
    model : CellModel
        The calibration in force (of ``calibrate`` or ``discover``), in the frame of its readings.
    readings : mapping
        Arm -> the readings that it was calibrated from, of all splits.
    turned : collection of str
        Arms of which the check measures orientation too; used if the calibration measured it.
    station_free : bool
        Whether the tracker was set up anew since, so that its pose is unknown.
    T_new_old : array, shape (4, 4), optional
        Its approximate new station: maps coordinates in its earlier frame into the present one.

    Raises
    ------
    InputError
        If an arm of the model has no readings.
    """
    for name in model.arms:
        if name not in readings or not len(readings[name]):
            raise InputError(f"arm '{name}': the calibration has no readings of it; a check needs them")
    own = {
        name: readings[name] if name in turned else replace(readings[name], quaternion_M=None) for name in model.arms
    }
    conditions = conditions_of_arms(model.arms, own)
    # What the model left unexplained at calibration is no change: the belief expects it where watched effects can.
    bare = {name: replace(arm, network=None) for name, arm in model.arms.items()}
    models = {name: _watching(arm, Measured.of(own[name], conditions[name])) for name, arm in bare.items()}
    learned = {name: its.take(_learned(its)) for name, its in own.items()}
    arms = {
        name: arm_belief(
            *calibration_posterior(profile, name, models, own),
            calibration_posterior(profile, name, models, learned)[0].model,
        )
        for name in own
    }
    if T_new_old is None:
        return CheckBelief(arms, station_free)
    return CheckBelief({name: _relocated(arm, T_new_old) for name, arm in arms.items()}, station_free, T_new_old)


def watched_terms(model: ArmModel, measured: Measured) -> tuple[EffectTerm, ...]:
    """Return terms of value zero for effects of wear that the model lacks, at joints where readings can show them."""
    context = model.context(measured.readings.q, conditions=measured.conditions)
    present = {(term.slug, name) for term in model.effects if not is_smooth(term) for name in term.names}
    found = []
    for slug, effect in EFFECTS.items():
        if not effect.wears or effect.missing_data(context):
            continue
        law = effect.laws(context)[0]
        names = frozenset(one.name for one in effect.columns(context, law) if not one.refines)
        columns = [one for one in effect.columns(context, law, names) if one.name in names]
        columns = [one for one in columns if (slug, one.name) not in present]
        if columns:
            zeros, units = np.zeros(len(columns)), tuple(one.unit for one in columns)
            found.append(EffectTerm(slug, tuple(one.name for one in columns), zeros, zeros, units, law))
    return tuple(found)


def _learned(readings: Readings) -> NDArray[np.intp]:
    """Return the rows that are not held out; all where too few are."""
    rows = np.setdiff1d(np.arange(len(readings)), readings.in_split("validate"))
    return rows if len(readings) - len(rows) >= _FEWEST_HELD_OUT else np.arange(len(readings))


def _watching(model: ArmModel, measured: Measured) -> ArmModel:
    """Return the model with the watched terms that it lacks."""
    return replace(model, effects=(*model.effects, *watched_terms(model, measured)))


def arm_belief(found: Posterior, measured: Measured, learned: ArmModel) -> ArmBelief:
    """Build the belief of one arm from the posterior of its readings, and the model of those that are not held out."""
    model = _watching(found.model, measured)
    added = sum(len(term.names) for term in model.effects) - sum(len(term.names) for term in found.model.effects)
    p = len(found.values)
    covariance = np.zeros((p + added, p + added))
    covariance[:p, :p] = found.covariance
    promised, turned, sigma = _promised(found, measured), measured.turned, found.measured.sigma
    points = measured.points
    excess = _held_out_excess(learned, found, measured, promised, points)
    of_turns = 0.0 if turned is None else _held_out_excess(learned, found, measured, promised, turned)
    return ArmBelief(
        model=model,
        columns=found.prior.columns,
        covariance=covariance,
        scatter_m=math.sqrt(found.scatter_m**2 + excess),
        noise_m=math.sqrt(mean_variance(sigma[points]) + excess),
        day_m=_day_m(found.model, measured.positions),
        promised_m=math.sqrt(float(np.mean(np.trace(promised[points], axis1=1, axis2=2)))),
        measured=measured,
        unexplained=_unexplained(found, excess, of_turns),
        scatter_rad=math.sqrt(found.scatter_rad**2 + of_turns),
        noise_rad=0.0 if turned is None else math.sqrt(mean_variance(sigma[turned]) + of_turns),
    )


def _unexplained(found: Posterior, excess: float, of_turns: float) -> Array:
    """Return what of the residuals (n, 3) is expected again: a share of what is not the tracker's noise."""
    share = np.empty(len(found.measured))
    points, sigma = found.measured.points, found.measured.sigma
    for rows, scatter, more in ((points, found.scatter_m, excess), (~points, found.scatter_rad, of_turns)):
        if rows.any():
            share[rows] = (scatter**2 + more) / (mean_variance(sigma[rows]) + more)
    return np.asarray(_REPEATS * share[:, None] * found.left_M)


def _promised(found: Posterior, measured: Measured) -> Array:
    """Compute the covariance (n, 3, 3) [m^2, rad^2] of predictions at the readings of the calibration."""
    X = design(found.model, measured, found.prior.columns).reshape(-1, 3, len(measured))
    return np.asarray(np.einsum("pan,pq,qbn->nab", X, found.covariance, X, optimize=True))


def _held_out_excess(
    learned: ArmModel, found: Posterior, measured: Measured, promised: Array, kind: NDArray[np.bool_]
) -> float:
    """Estimate the excess variance [m^2, rad^2] of a coordinate of held-out readings beyond ``promised``.

    ``kind`` (n,) masks positions or orientations. Residuals of readings that the model was fitted to are too small.
    """
    rows = measured.readings.in_split("validate")
    rows = rows[kind[rows]]
    if len(rows) < _FEWEST_HELD_OUT:
        return 0.0
    held_out = measured.take(rows)
    left_M = held_out.left(learned)
    sigma = found.measured.sigma[rows]
    noise = sigma if sigma.ndim == 3 else sigma[:, None, None] ** 2 * np.eye(3)
    return excess_variance(left_M, noise + promised[rows], 3 * len(rows))


def _day_m(model: ArmModel, measured: Measured) -> float:
    """Compute the rms motion [m] of the SMR over the calibration's readings by effects of that day, such as drift."""
    terms = tuple(term for term in model.effects if not EFFECTS[term.slug].arm_bound)
    if not terms:
        return 0.0
    q, conditions = measured.readings.q, measured.conditions
    rest = replace(model, effects=tuple(term for term in model.effects if EFFECTS[term.slug].arm_bound))
    moved = model.predict(q, conditions=conditions) - rest.predict(q, conditions=conditions)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))


def measured_vectors(arm: ArmBelief, readings: Readings, conditions: MeasurementConditions) -> Measured:
    """Collect measured positions of an arm, then the orientations that its belief can predict."""
    if arm.model.geometry.probe is None:
        readings = replace(readings, quaternion_M=None)
    return Measured.of(readings, conditions)


def noise_covariance(arm: ArmBelief, measured: Measured) -> Array:
    """Compute the covariance (n, 3, 3) [m^2, rad^2] of measured vectors: stated uncertainty plus the arm's scatter.

    Positions or orientations without a stated uncertainty get that of the calibration.
    """
    whole: Array = np.empty((len(measured), 3, 3))
    points = measured.points
    for rows, noise, scatter in ((points, arm.noise_m, arm.scatter_m), (~points, arm.noise_rad, arm.scatter_rad)):
        if not rows.any():
            continue
        stated = None if measured.stated is None else measured.stated[rows]
        if stated is None or states_nothing(stated):
            whole[rows] = noise**2 * np.eye(3)
        else:
            own = with_excess(stated, scatter**2)
            whole[rows] = own if own.ndim == 3 else own[:, None, None] ** 2 * np.eye(3)
    return whole


def _relocated(arm: ArmBelief, T: Array) -> ArmBelief:
    """Return the belief in the frame of a tracker that was set up anew."""
    names = ParameterSet("", arm.model.geometry.joints, arm.columns).names
    terms = tuple(f"{k}" for k in range(len(arm.covariance) - len(names)))
    model = replace(arm.model, posterior=None, identified=(*names, *terms), covariance=arm.covariance)
    model = relocated(CellModel({"": model}), T).arms[""]
    assert model.covariance is not None
    its, R = arm.measured, T[:3, :3]
    R_M_S = its.conditions.R_M_S
    p_M = apply(T, its.readings.p_M)
    if its.turned is not None:
        p_M[its.turned] = 0.0
    stated = its.stated if its.stated is None or its.stated.ndim == 1 else R @ its.stated @ R.T
    return replace(
        arm,
        model=model,
        covariance=model.covariance,
        measured=replace(
            its,
            readings=replace(its.readings, p_M=p_M),
            conditions=replace(its.conditions, R_M_S=None if R_M_S is None else R @ R_M_S),
            stated=stated,
        ),
    )
