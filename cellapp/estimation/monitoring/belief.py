"""Derive from a stored calibration what a check expects of every arm, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import excess_variance, mean_variance
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import ArmReadings, Quantities, measured_quantities, states_nothing
from cellapp.estimation.discovery.prior_fit import Posterior, design
from cellapp.estimation.monitoring.records import LocateResult
from cellapp.estimation.prior.belief import is_smooth
from cellapp.estimation.prior.calibrate import calibration_posterior
from cellapp.estimation.readings import Readings, covariances_of
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectTerm, InputVariable, MeasurementConditions
from cellapp.robot.kinematics.chain import all_names
from cellapp.robot.kinematics.transforms import Array, apply, rms_length
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.model import relocated

# -- Data classes of the check: belief of a calibration, state of the test --------------------------------------------
#
# A change that has to be detected is *visible*: it moves the SMR, rms over the readings of the calibration, by at least
# ``VISIBLE`` standard deviations of a measured coordinate (of tracker and arm together), and is one of at least 0.05 mm
# or 50 µrad of a parameter, or of an effect such that the SMR moves by 0.05 mm rms. The best-fitting motion of the
# tracker is subtracted first: what a motion of the tracker explains as well is no change of an arm. If a probe measures
# orientation too, its rotation by the change counts as well, in its own standard deviations.

LENGTH_M = 5e-5
"""Least change of a length that the check has to detect [m]."""
ROTATION_RAD = 5e-5
"""Least change of an angle that the check has to detect [rad]."""
FALSE_ALARM, MISS = 0.01, 0.05
"""Probabilities of a false alarm and of missing a visible change."""
VISIBLE = 2.0
"""Least motion of the SMR by a visible change, in standard deviations of a measured coordinate."""
MOST_STEPS = 20.0
"""Size of a visible change at most, in least changes: 1 mm; what would have to be larger is not seen."""

ChangeKind = Literal["tracker", "base", "smr", "parameter", "effect"]


_OF_DAY = {InputVariable.TIME, InputVariable.AIR_TEMPERATURE, InputVariable.JOINT_TEMPERATURE}
UNREPEATED = 3e-5
"""What of an arm's errors may be new at each visit, as a standard deviation [m, rad]: arms of this class state a
repeatability of 0.1 mm by ISO 9283."""


@dataclass(frozen=True)
class KnownSd:
    """Standard deviation of a component of the calibration's residuals: ``whole``, and ``arm`` without the tracker's.

    A stop that is measured again after the same last motion has an unknown share of the arm's part again: at
    least all beyond ``UNREPEATED``. Expected is the mean of the least share and all of it, and the variance is that of
    the least share.
    """

    whole: float = 0.0
    arm: float = 0.0

    @property
    def _least(self) -> float:
        """Least variance that comes again."""
        return max(self.arm**2 - UNREPEATED**2, 0.0)

    @property
    def again(self) -> float:
        """Share of a residual that is expected at the same stop."""
        return 0.5 * (self.arm**2 + self._least) / max(self.whole**2, 1e-300)

    def beyond_tracker(self, again: Array) -> Array:
        """Compute the arm's variance about what is expected with shares ``again`` (n,), 0 at another stop."""
        return np.asarray(self.arm**2 + (again * self.whole) ** 2 - 2.0 * again * self._least)

    def unremembered(self, again: Array) -> Array:
        """Compute the factors (n,) of the model's uncertainty about what is expected with shares ``again`` (n,).

        With f the model's error at a stop, e the error of its reading and a the share, (1 - a) f - a e is left. The fit
        followed e: f and e correlate by minus the covariance of f, but for the share of e that comes again.
        """
        new = again - np.minimum(again, self._least / max(self.whole**2, 1e-300))
        return np.asarray(np.sqrt((1.0 - again) * (1.0 - again + 2.0 * new)))

    @property
    def noise(self) -> float:
        """Standard deviation of a component of a reading at the same stop, of tracker and arm together."""
        tracker = self.whole**2 - self.arm**2
        return math.sqrt(tracker + float(self.beyond_tracker(np.array(self.again))))


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
    of_points, of_rotations : KnownSd
        Scatter of a measured coordinate [m], and of a component of an orientation [rad], about the model.
    day_m : float
        Rms motion of the SMR by effects of the day of the calibration, such as drift, of which today's are unknown [m].
    promised_m : float
        Root mean square length of the error of a prediction over the readings of the calibration [m].
    measured : Quantities
        The readings of the calibration without gross errors, in the frame of ``model``: positions, then orientations
        where the check measures them.
    residuals : array, shape (n, 3)
        Their residuals [m, rad].
    """

    model: ArmModel
    columns: tuple[int, ...]
    covariance: Array
    of_points: KnownSd
    of_rotations: KnownSd
    day_m: float
    promised_m: float
    measured: Quantities
    residuals: Array

    @property
    def positions(self) -> Quantities:
        """The positions among the readings of the calibration."""
        return self.measured.positions

    @cached_property
    def levers(self) -> Array:
        """Covariance (n, 3, 3) of the calibration's vectors from a unit variance of every joint [m^2/rad^2]."""
        return _levers(self.model, self.measured)

    def kinds(self, measured: Quantities) -> list[tuple[NDArray[np.bool_], KnownSd]]:
        """Return the masks (n,) of positions and of orientations, where there are some, each with its scatter."""
        found = ((measured.points, self.of_points), (~measured.points, self.of_rotations))
        return [(rows, scatter) for rows, scatter in found if rows.any()]

    def unremembered(self, measured: Quantities, again: Array) -> Array:
        """Return ``KnownSd.unremembered`` of each vector."""
        found = np.ones(len(measured))
        for rows, scatter in self.kinds(measured):
            found[rows] = scatter.unremembered(again[rows])
        return found


@dataclass(frozen=True, eq=False)
class CheckBelief:
    """Predictions of a cell by a calibration.

    ``arms`` maps names to beliefs, in the frame of the tracker's station. ``station`` (6, 6) is the covariance of a
    twist of that frame, shift at its origin [m] and rotation [rad]; None if it is that of the calibration.
    """

    arms: Mapping[str, ArmBelief]
    station: Array | None = None

    @property
    def models(self) -> dict[str, ArmModel]:
        """Arm -> mean of its posterior."""
        return {name: arm.model for name, arm in self.arms.items()}


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
    log_evidence, log_valid : float
        Minus the logarithms of the chances to be wrong in saying that something changed, or that nothing visible did.
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


_INTERPOLATED = 1e-3
"""Least share of its variance by which a fitted reading differs from the measured one."""


def check_belief(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    *,
    angular: Collection[str] = (),
    located: LocateResult | None = None,
) -> CheckBelief:
    """Build the belief of a check from a calibration.

    Parameters
    ----------
    profile : Profile
    model : CellModel
        The calibration in force (of ``calibrate`` or ``discover``), in the frame of its readings.
    readings : mapping
        Arm -> the readings that it was calibrated from, of all splits.
    angular : collection of str
        Arms of which the check measures orientation too; used if the calibration measured it.
    located : LocateResult, optional
        Station where the tracker was located since.

    Raises
    ------
    InputError
        If an arm of the model has no readings.
    """
    for name in model.arms:
        if name not in readings or not len(readings[name]):
            raise InputError(f"arm '{name}': the calibration has no readings of it; a check needs them")
    own = {
        name: readings[name] if name in angular else replace(readings[name], quaternion_M=None) for name in model.arms
    }
    arms = {}
    for name, arm in ArmReadings.of_cell(profile, model.arms, own).items():
        watched = watching(replace(arm.model, network=None), arm.quantities())
        arms[name] = arm_belief(*calibration_posterior(replace(arm, model=watched)))
    if located is None:
        return CheckBelief(arms)
    relocated_arms = {name: _relocated(arm, np.array(located.T_new_old)) for name, arm in arms.items()}
    return CheckBelief(relocated_arms, np.array(located.covariance))


def watching(model: ArmModel, measured: Quantities) -> ArmModel:
    """Return the model with terms of value zero for effects of wear that it lacks, at joints where readings can show
    them."""
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
    return replace(model, effects=(*model.effects, *found))


def arm_belief(found: Posterior, measured: Quantities) -> ArmBelief:
    """Build the belief of one arm from the posterior of its readings."""
    X = design(found.model, measured, found.prior.columns).reshape(-1, 3, len(measured))
    promised = np.einsum("pan,pq,qbn->nab", X, found.covariance, X, optimize=True)
    points = measured.points
    return ArmBelief(
        model=found.model,
        columns=found.prior.columns,
        covariance=found.covariance,
        of_points=_scatter(found, promised, points, found.scatter_m),
        of_rotations=KnownSd() if measured.angular is None else _scatter(found, promised, ~points, found.scatter_rad),
        day_m=_day_m(found.model, measured.positions),
        promised_m=math.sqrt(float(np.mean(np.trace(promised[points], axis1=1, axis2=2)))),
        measured=measured,
        residuals=found.residuals_M,
    )


def _scatter(found: Posterior, promised: Array, rows: NDArray[np.bool_], arm: float) -> KnownSd:
    """Estimate the scatter of some readings from the errors of their predictions by all others.

    Residuals are too small where free functions follow the readings: with R the covariance of a reading and P that
    of its fitted value, the reading left out has the residual R (R - P)^-1 r, with covariance R (R - P)^-1 R.
    """
    sigma = found.measured.sigma[rows]
    R = covariances_of(sigma)
    gain = R @ np.linalg.inv((1.0 + _INTERPOLATED) * R - promised[rows])
    excess = excess_variance(np.einsum("nab,nb->na", gain, found.residuals_M[rows]), gain @ R, 3 * len(R))
    return KnownSd(math.sqrt(mean_variance(sigma) + excess), math.sqrt(arm**2 + excess))


def _day_m(model: ArmModel, measured: Quantities) -> float:
    """Compute the rms motion [m] of the SMR over the calibration's readings by effects of that day, such as drift."""
    rest = replace(model, effects=tuple(term for term in model.effects if not _is_of_day(term)))
    if len(rest.effects) == len(model.effects):
        return 0.0
    moved = measured.predicted(model) - measured.predicted(rest)
    return rms_length(moved)


def _is_of_day(term: EffectTerm) -> bool:
    """Return whether a term depends on the time or on temperatures."""
    return bool((term.law.form.variables or EFFECTS[term.slug].variables) & _OF_DAY)


def measured_vectors(arm: ArmBelief, readings: Readings, conditions: MeasurementConditions) -> Quantities:
    """Collect measured positions of an arm, then the orientations that its belief can predict."""
    if arm.model.geometry.probe is None:
        readings = replace(readings, quaternion_M=None)
    return measured_quantities(readings, conditions)


def noise_covariance(arm: ArmBelief, measured: Quantities, again: Array) -> Array:
    """Compute the covariance (n, 3, 3) [m^2, rad^2] of measured vectors: stated uncertainty plus the arm's scatter
    about what is expected with shares ``again`` (n,) of the calibration's residuals.

    The arm scatters at least as in the mean of the calibration, more where and across which its joints have longer
    levers. Positions or orientations without a stated uncertainty get that of the calibration.
    """
    whole: Array = np.empty((len(measured), 3, 3))
    levers = _levers(arm.model, measured)
    for (rows, scatter), (known, _) in zip(arm.kinds(measured), arm.kinds(arm.measured), strict=False):
        stated = None if measured.stated is None else measured.stated[rows]
        if stated is None or states_nothing(stated):
            stated = np.full(int(rows.sum()), math.sqrt(scatter.whole**2 - scatter.arm**2))
        mean = float(np.mean(np.trace(arm.levers[known], axis1=1, axis2=2))) / 3.0
        squares, axes = np.linalg.eigh(levers[rows] / mean)
        squares = np.maximum(squares, 1.0) * scatter.beyond_tracker(again[rows])[:, None]
        whole[rows] = covariances_of(stated) + np.einsum("nab,nb,ncb->nac", axes, squares, axes)
    return whole


def _levers(model: ArmModel, measured: Quantities) -> Array:
    """Compute the covariance (n, 3, 3) of measured vectors from a unit variance of every joint [m^2/rad^2]."""
    names = all_names(model.geometry.joints)
    joints = tuple(names.index(f"theta{joint + 1}") for joint in range(model.geometry.joints))
    rows = design(model, measured, joints)[: len(joints)].reshape(len(joints), 3, len(measured))
    return np.asarray(np.einsum("jan,jbn->nab", rows, rows))


def _relocated(arm: ArmBelief, T: Array) -> ArmBelief:
    """Return the belief in the frame of another station of the tracker."""
    names = ParameterSet("", arm.model.geometry.joints, arm.columns).names
    terms = tuple(f"{k}" for k in range(len(arm.covariance) - len(names)))
    model = replace(arm.model, posterior=None, identified=(*names, *terms), covariance=arm.covariance)
    model = relocated(CellModel({"": model}), T).arms[""]
    assert model.covariance is not None
    its, R = arm.measured, T[:3, :3]
    R_M_S = its.conditions.R_M_S
    p_M = apply(T, its.readings.p_M)
    if its.angular is not None:
        p_M[its.angular] = 0.0
    stated = its.stated if its.stated is None or its.stated.ndim == 1 else R @ its.stated @ R.T
    return replace(
        arm,
        model=model,
        covariance=model.covariance,
        residuals=arm.residuals @ R.T,
        measured=replace(
            its,
            readings=replace(its.readings, p_M=p_M),
            conditions=replace(its.conditions, R_M_S=None if R_M_S is None else R @ R_M_S),
            stated=stated,
        ),
    )
