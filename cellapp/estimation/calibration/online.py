"""Identification of one arm while its stops are measured: a new estimate and its standard errors after every stop.

Between renewals the measurement model is linear about one geometry, and a new reading is a step of recursive least
squares. A renewal linearises all readings again at the present estimate. Renewals follow a growing schedule, and come
at once if the estimate has left the range in which the linear model holds.

Few readings do not determine all parameters. Priors about the nominal arm then do, as in ``identification``. The
weights are those of ``identification``: stated covariance plus the excess variance from unmodelled physics.
A gross error (a wrong target) gets no weight.

Predictions come from a second model. It adds to the geometry the joints' compliance under gravity and an error of one
cycle a turn in each joint. The first model is what ``calibrate`` identifies; on a UR10, gravity leaves it residuals of
half a millimetre, which hide a loose SMR.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.least_squares import shortened
from cellapp.estimation.calibration.normal_equations import Linearisation, Observations, normal_equations
from cellapp.estimation.calibration.online_model import (
    GROSS,
    LinearModel,
    Residuals,
    StoredReadings,
    excess_of,
    gross_weights,
)
from cellapp.estimation.calibration.parameters import (
    ParameterSet,
    SetName,
    estimated_parameters,
    gram_matrix,
    prior_sds,
    prior_spreads,
    weak_priors,
)
from cellapp.estimation.calibration.weights import RobustName, robust_weights, whitener
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.ground.progress import StopReport
from cellapp.robot.kinematics.chain import TOOL_NAMES, Geometry, JointAngles, frame_poses, jacobian, smr_positions
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import OFF_AXIS, bodies_of, nominal_arm, prior_sigmas, up_in_tracker

_TOOL_PRIOR_M = 20e-3
"""Prior standard deviation of a stated SMR offset: an adapter measured with a ruler."""
_UNKNOWN_TOOL_PRIOR_M = 0.3
"""Prior standard deviation of an offset that the profile calls unknown: any adapter."""
_FIRST_READINGS = 4
"""Number of readings from which the base is found. Three determine it; a fourth shows whether they fit."""
_LEAST_SPREAD_M = 0.05
"""Least rms distance of the first points from their common line: with errors of some millimetres, the base is then
known to 0.1 rad, from where Gauss-Newton steps converge."""
_REGISTERED_AGAIN = (8, 16)
"""Numbers of readings at which the base is registered again: the first four may have been a poor start."""
_GROWTH = 1.2
"""Growth of the number of readings between renewals: 20 renewals up to 400 readings."""
_LINEAR = 1e-3
"""Largest change of a parameter at arm's length [m] for one linearisation; the neglected second order is 1 um, and
standard errors are far larger as long as single readings change the estimate by this much."""
NO_GEOMETRY_M = 2e-3
"""Scatter about the model [m] larger than any arm's and any unmodelled physics: the geometry itself is wrong."""
_STEPS = 20
"""Maximum number of Gauss-Newton steps of a renewal; one is enough after the first readings."""
_FIRST_EXCESS_M = 1e-4
"""Excess standard deviation of a coordinate until it is estimated: what gravity and backlash leave in UR arms."""
_LEAST_FREEDOM = 10.0
"""Degrees of freedom from which the excess variance is estimated."""


@dataclass(frozen=True)
class Prediction:
    """Predicted SMR position.

    Attributes
    ----------
    p_M : array, shape (3,)
        Expected SMR position [m].
    covariance_M : array, shape (3, 3)
        From the parameters alone [m^2].
    scatter_m : float
        Standard deviation of a measured coordinate about the model [m].
    """

    p_M: Array
    covariance_M: Array
    scatter_m: float

    @property
    def sigma_m(self) -> float:
        """Standard uncertainty of the distance between ``p_M`` and the SMR position to be measured [m]."""
        return math.sqrt(float(np.trace(self.covariance_M)) + 3.0 * self.scatter_m**2)


@dataclass(frozen=True)
class Innovation:
    """Difference of a reading from the prediction by the model before it.

    Attributes
    ----------
    stop : int
    p_M : array, shape (3,)
        Measured SMR position [m].
    off_M : array, shape (3,)
        Measured minus predicted position [m].
    covariance_M : array, shape (3, 3)
        Of ``off_M``: parameters, stated noise, excess scatter [m^2].
    R_M_F : array, shape (3, 3)
        Rotation of the flange.
    scatter_m : float
        Standard deviation of a coordinate about the model [m].
    freedom : float
        Degrees of freedom from which the scatter was estimated.
    """

    stop: int
    p_M: Array
    off_M: Array
    covariance_M: Array
    R_M_F: Array
    scatter_m: float
    freedom: float


def online_fit(profile: Profile, name: str, planned_q: Array) -> OnlineFit:
    """Create an arm's fit by the profile's calibration section; ``planned_q`` (n, N) [rad] are the planned stops."""
    arm, settings = profile.arms[name], profile.calibration
    nominal = nominal_arm(arm)
    return OnlineFit(
        name,
        nominal,
        planned_q,
        parameter_set=settings.parameter_set,
        prior_sigma=prior_sigmas(nominal, settings.priors),
        robust=settings.robust,
        tool_unknown=arm.smr.offset == "unknown",
        gravity=Gravity(bodies_of(arm), up_in_tracker(profile)),
    )


class OnlineFit:
    """Geometry of one arm, refitted after every stop. There is no model until ``ready``.

    No step of a renewal raises the weighted sum of squares, priors included. Where its steps do not end, there is no
    model, and nothing is predicted or reported, until a renewal with further readings ends.

    Parameters
    ----------
    arm : str
        Name, for the reports.
    nominal : Geometry
        Nominal chain; its base is not used.
    planned_q : array, shape (n, N)
        Joint positions [rad] of the planned stops, over which the uncertainty of a prediction is averaged.
    parameter_set : str
        ``auto``, ``paper`` or ``full``. Priors hold the redundant parameters of ``full``.
    prior_sigma : mapping, optional
        Parameter -> standard deviation about its nominal value, instead of those of ``estimated_parameters``.
    robust : str
        ``none``, ``huber`` or ``tukey``; these weights are renewed with the linearisation.
    tool_unknown : bool
        Whether the SMR offset is unknown.
    gravity : Gravity, optional
        Masses and direction of gravity; without them, predictions ignore joint compliance.

    Raises
    ------
    InputError
        If the parameter set is not for this arm.
    """

    def __init__(
        self,
        arm: str,
        nominal: Geometry,
        planned_q: Array,
        *,
        parameter_set: SetName = "auto",
        prior_sigma: Mapping[str, float] | None = None,
        robust: RobustName = "none",
        tool_unknown: bool = False,
        gravity: Gravity | None = None,
    ) -> None:
        self.arm = arm
        self.innovation: Innovation | None = None
        """Innovation of the newest reading; None if there was no model before it."""
        self._nominal, self._tool_unknown, self._robust = nominal, tool_unknown, robust
        typical = replace(nominal, tool=OFF_AXIS) if tool_unknown else nominal
        given = prior_sigma or {}
        try:
            self._parameters, priors = estimated_parameters(parameter_set, typical, given)
        except ValueError as error:
            raise InputError(f"arm '{arm}': calibration.parameter_set: {error}") from None
        # The base has no prior: four points determine it.
        tool = dict.fromkeys(TOOL_NAMES, _UNKNOWN_TOOL_PRIOR_M if tool_unknown else _TOOL_PRIOR_M)
        weak = {**weak_priors(nominal.joints), **tool}
        self._precision = 1.0 / prior_sds(self._parameters, weak | dict(priors)) ** 2
        self._spreads = prior_spreads(self._parameters, set(priors) - set(given))
        self._rows = Rows(self._parameters, planned_q, gravity)
        self._readings = StoredReadings(nominal.joints)
        self._models: _Models | None = None
        self._settled = False
        self._next_renewal = 0

    @property
    def count(self) -> int:
        """Number of readings."""
        return self._readings.count

    @property
    def ready(self) -> bool:
        """Whether there is a model: after four readings, if their points are spread out and the fit converged."""
        return self._ready is not None

    @property
    def _ready(self) -> _Models | None:
        return self._models if self._settled else None

    @property
    def geometry(self) -> Geometry | None:
        """Present estimate, without compliance; None without a model."""
        return None if self._ready is None else self._estimate(self._ready)

    @property
    def scatter_m(self) -> float | None:
        """Standard deviation of a measured coordinate about the geometry alone [m]; None without a model."""
        return None if self._ready is None else self._ready.geometry.scatter_m

    def predict(self, stop: int, q: Array) -> Prediction | None:
        """Predict the SMR position at ``q`` (N,) [rad], at or near a planned stop; None without a model."""
        if self._ready is None:
            return None
        model = self._ready.predicting
        row = self._rows.at(self._ready.origin, stop, q)
        return Prediction(row.P + row.J @ model.step, row.J @ model.covariance @ row.J.T, model.scatter_m)

    def add(self, stop: int, q: Array, p_M: Array, covariance_M: Array | None = None) -> StopReport | None:
        """Refit with one reading: ``q`` (N,) [rad], ``p_M`` (3,) [m], ``covariance_M`` (3, 3) [m^2].

        Return None while there is no model.
        """
        self._readings.append(q, p_M, covariance_M)
        self.innovation = None
        if self._models is not None:
            self._insert(self._models, stop, q, p_M)
        if self._models is None or self.count in _REGISTERED_AGAIN:
            self._renew(registered=True)
        elif self.count >= self._next_renewal or self._models.geometry.moved > _LINEAR:
            self._renew()
        return self._report(stop, q, p_M)

    def add_all(
        self, stops: Sequence[int], q: Array, p_M: Array, covariance_M: Array | None = None
    ) -> StopReport | None:
        """Refit with stored readings: ``q`` (n, N) [rad], ``p_M`` (n, 3) [m], ``covariance_M`` (n, 3, 3), NaN: none.

        Return the report of the last one; None without readings or model.
        """
        if not len(stops):
            return None
        for row in range(len(stops)):
            self._readings.append(q[row], p_M[row], None if covariance_M is None else covariance_M[row])
        self.innovation = None
        self._renew(registered=True)
        return self._report(stops[-1], q[-1], p_M[-1])

    def _report(self, stop: int, q: Array, p_M: Array) -> StopReport | None:
        if self._ready is None:
            return None
        origin, model = self._ready.origin, self._ready.geometry
        row = self._rows.at(origin, stop, q)
        residual = p_M - row.P - row.J[:, : len(model.step)] @ model.step
        mean_square = max(float(np.vdot(self._rows.planned_gram(origin), model.covariance)), 0.0)
        return StopReport(
            stop=stop,
            arm=self.arm,
            residual_mm=1e3 * float(np.linalg.norm(residual)),
            standard_error_mm=1e3 * math.sqrt(mean_square),
        )

    def residuals(self) -> Residuals | None:
        """Compute the residuals of all readings by the geometry alone, in order of arrival; None without a model."""
        if self._ready is None:
            return None
        readings = self._readings
        return Residuals.of(
            self._left_M(self._ready, readings.q, readings.p_M), readings.stated(), self._ready.geometry
        )

    def lengths_m(self, q: Array, p_M: Array) -> Array | None:
        """Compute residual lengths (n,) [m] of points ``p_M`` (n, 3) [m] at ``q`` (n, N) [rad]; None if not ready."""
        return None if self._ready is None else np.linalg.norm(self._left_M(self._ready, q, p_M), axis=1)

    def _left_M(self, models: _Models, q: Array, p_M: Array) -> Array:
        """Compute the residuals (n, 3) [m] of points by the geometry alone."""
        step = models.geometry.step
        P, J = self._rows.of(models.origin, q)
        left_M: Array = p_M - P.T - (J[:, : len(step)].transpose(2, 0, 1) @ step)
        return left_M

    def _estimate(self, models: _Models, step: Array | None = None) -> Geometry:
        vector = models.origin.vector()
        vector[list(self._parameters.columns)] += models.geometry.step if step is None else step
        return models.origin.with_vector(vector)

    def _loss(self, models: _Models, step: Array) -> float:
        """Compute what the geometry's step minimises, after a ``step`` (k,) from the origin."""
        readings, model = self._readings, models.geometry
        left = (readings.p_M - smr_positions(self._estimate(models, step), readings.q)).T
        white = np.einsum("ijn,jn->in", whitener(readings.stated() + model.excess * np.eye(3)), left)
        return model.loss(float(np.sum(models.weights * white**2)), step)

    def _insert(self, models: _Models, stop: int, q: Array, p_M: Array) -> None:
        """Add the newest reading to both models, unless it is a gross error."""
        row = self._rows.at(models.origin, stop, q)
        J, off, stated, model = row.J, p_M - row.P, self._readings.newest_stated(), models.predicting
        innovation, expected = model.innovation(J, off, stated)
        # a fit on its way says nothing about the reading, unless no geometry fits the readings at all
        if self._settled or model.scatter_m > NO_GEOMETRY_M:
            self.innovation = Innovation(stop, p_M, innovation, expected, row.R_M_F, model.scatter_m, model.freedom)
        if innovation @ np.linalg.solve(expected, innovation) <= GROSS**2:
            model.add(J, off, stated)
            models.geometry.add(J[:, : len(self._precision)], off, stated)

    def _renew(self, *, registered: bool = False) -> None:
        """Linearise all readings at the present estimate; if ``registered``, start from the nominal arm again."""
        start = self._registered() if registered else self.geometry
        if start is None:
            return
        before = None if registered else self._models
        for _ in range(_STEPS):
            self._models = before = self._linearised(start, before)
            self._settled = before.geometry.moved <= _LINEAR
            if self._settled:
                break
            try:
                step = shortened("fit of an arm", before.geometry.step, partial(self._loss, before))
            except NotConverged:  # try again with further readings
                break
            start = self._estimate(before, step)
        self._next_renewal = math.ceil(_GROWTH * self.count)

    def _registered(self) -> Geometry | None:
        """Register the nominal arm to the points; None if they are too few or nearly on one line."""
        q, p_M = self._readings.q, self._readings.p_M
        if len(q) < _FIRST_READINGS:
            return None
        spread = np.linalg.svd(p_M - p_M.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(q))
        if spread < _LEAST_SPREAD_M:
            return None
        return start_from_nominal(self._nominal, q, p_M, tool_unknown=self._tool_unknown)

    def _linearised(self, origin: Geometry, before: _Models | None) -> _Models:
        """Linearise both models at ``origin``; their weights follow from the residuals of the models ``before``."""
        readings, k = self._readings, len(self._precision)
        P, J = self._rows.of(origin, readings.q)
        off, stated = readings.p_M - P.T, readings.stated()
        both, weights = [], []
        for which, columns in enumerate((J[:, :k], J)):
            weighting = _Weighting(np.ones(readings.count), _FIRST_EXCESS_M**2, 1.0)
            if before is not None:
                model = (before.geometry, before.predicting)[which]
                step = model.step.copy()
                step[:k] += (before.origin.vector() - origin.vector())[list(self._parameters.columns)]
                weighting = self._weighting(model, off - columns.transpose(2, 0, 1) @ step, stated)
            both.append(self._solved(origin, P, columns, weighting))
            weights.append(weighting.weights)
        return _Models(origin, both[0], both[1], weights[0])

    def _weighting(self, model: LinearModel, residuals: Array, stated: Array) -> _Weighting:
        """Compute the weights of the readings from the residuals (n, 3) [m] of ``model``."""
        weights, excess = gross_weights(residuals, stated, model.excess), model.excess
        if model.freedom >= _LEAST_FREEDOM:
            excess = excess_of(residuals, stated, weights, model.freedom)
        if self._robust != "none":
            white = whitener(stated + excess * np.eye(3))
            weights = weights * robust_weights(
                np.linalg.norm(np.einsum("ijn,nj->ni", white, residuals), axis=1), self._robust
            )
        return _Weighting(weights, excess, model.variance)

    def _solved(self, origin: Geometry, P: Array, J: Array, weighting: _Weighting) -> LinearModel:
        """Solve for the model with Jacobian ``J`` (3, k + m, n): columns of the geometry, then of joint errors."""
        readings, k = self._readings, len(self._precision)
        stated = readings.stated()
        white = whitener(stated + weighting.excess * np.eye(3))
        observations = Observations(JointAngles.of(readings.q), readings.q, readings.p_M.T, white, None)
        extra = J.shape[1] - k
        columns = list(self._parameters.columns)
        values = np.concatenate([origin.vector()[columns], np.zeros(extra)])
        linear = Linearisation(P, J)
        normal = normal_equations(origin, observations, self._parameters, values, weighting.weights, linear)
        model = LinearModel(
            A=normal.A,
            b=normal.b,
            cost=normal.cost,
            scale=normal.scale,
            precision=np.concatenate([self._precision, self._rows.added_sds[:extra] ** -2.0]),
            prior_step=np.concatenate([self._nominal.vector()[columns], np.zeros(extra)]) - values,
            used=int(np.count_nonzero(weighting.weights)),
            excess=weighting.excess,
            mean_stated=float(np.trace(stated, axis1=1, axis2=2).mean()) / 3.0,
            variance=weighting.variance,
        )
        model.solve()
        deviations, by_priors = model.step - model.prior_step, model.precision * np.diag(model.covariance)
        for spread in self._spreads:
            square = spread.square(deviations[spread.places], float(by_priors[spread.places].sum()))
            model.precision[spread.places] = 1.0 / square
        model.solve()  # with the scatter and the prior spread that follow from the first solution
        return model


@dataclass(frozen=True)
class _Models:
    """Model of the geometry alone, and one with joint errors for predictions; both linear about ``origin``.

    ``weights`` (n,) are those of the readings in the former.
    """

    origin: Geometry
    geometry: LinearModel
    predicting: LinearModel
    weights: Array


@dataclass(frozen=True)
class _Weighting:
    """Weights (n,) of the readings, excess variance of a coordinate [m^2], chi-square per degree of freedom."""

    weights: Array
    excess: float
    variance: float


# -- SMR positions and Jacobians of one arm at its stops, for ``online`` ----------------------------------------------


_GRAM_VALID = 2e-3
"""Change of a parameter [m or rad] up to which the Jacobian of the planned stops is reused; it changes as much."""
_COMPLIANCE_SD = 5e-5
"""Prior standard deviation of a joint's compliance about zero [rad/Nm]: gears of such arms have 1e4 to 1e5 Nm/rad."""
_WAVE_SD = 8e-5
"""Prior standard deviation of a joint error of one cycle a turn [rad]: encoder disk 2 um off axis, 25 mm radius."""
_PLANNED_RAD = 0.01
"""Distance from the planned joint positions up to which their gravity torques are reused: they differ by a percent."""


@dataclass(frozen=True)
class Gravity:
    """Masses of the arm and the direction (3,) against gravity in the tracker frame, for its joint compliance."""

    bodies: Bodies
    up_M: Array


@dataclass(frozen=True)
class Row:
    """SMR position (3,), its derivatives (3, k + m) and the rotation of the flange (3, 3) at one stop."""

    origin: Geometry
    q: Array
    P: Array
    J: Array
    R_M_F: Array


class Rows:
    """SMR positions and their derivatives by the parameters (k), then by the joint errors (m).

    Joint errors are the compliance under gravity, if that is known, and a cosine and a sine of the joint angle. The
    residuals that they leave in the geometry are alike at neighbouring stops, and would look like a fault.
    """

    def __init__(self, parameters: ParameterSet, planned_q: Array, gravity: Gravity | None) -> None:
        self._gravity, self._planned_q, self._planned = gravity, planned_q, JointAngles.of(planned_q)
        joints, k = parameters.joints, len(parameters.columns)
        of_joints = [6 + 5 * joint for joint in range(joints)]
        of_tool = list(range(6 + 5 * joints, 9 + 5 * joints))
        missing = [column for column in of_joints + of_tool if column not in parameters.columns]
        self._columns, self._k = (*parameters.columns, *missing), k
        self.added_sds = np.full(2 * joints, _WAVE_SD)
        """Prior standard deviations (m,) of the joint errors about zero."""
        if gravity is not None:
            self.added_sds = np.concatenate([np.full(joints, _COMPLIANCE_SD), self.added_sds])
        self._joints, self._tool = ([self._columns.index(c) for c in group] for group in (of_joints, of_tool))
        self._gram_at: Array | None = None
        self._gram, self._torques = np.zeros((k, k)), np.zeros((0, joints))
        self._last: Row | None = None

    def of(self, origin: Geometry, q: Array) -> tuple[Array, Array]:
        """Compute SMR positions (3, n) [m] and derivatives (3, k + m, n) at joint positions ``q`` (n, N) [rad]."""
        P, J = jacobian(origin, JointAngles.of(q), self._columns)
        return P, self._with_added(J, q, None if self._gravity is None else self._torques_of(origin, q))

    def at(self, origin: Geometry, stop: int, q: Array) -> Row:
        """Compute the same at one stop; the last result is cached."""
        last = self._last
        if last is None or last.origin is not origin or not np.array_equal(last.q, q):
            P, J = jacobian(origin, JointAngles.of(q[None]), self._columns)
            torques = None
            if self._gravity is not None:
                planned = 0 <= stop < len(self._torques) and np.abs(self._planned_q[stop] - q).max() < _PLANNED_RAD
                torques = self._torques[stop : stop + 1] if planned else self._torques_of(origin, q[None])
            row = self._with_added(J, q[None], torques)[:, :, 0]
            self._last = last = Row(origin, q.copy(), P[:, 0], np.ascontiguousarray(row), J[:, self._tool, 0])
        return last

    def _with_added(self, J: Array, q: Array, torques: Array | None) -> Array:
        """Append to the parameters' columns those of the joint errors at ``q`` (n, N) [rad]; ``torques`` (n, N) [Nm],
        None if unknown."""
        own = J[:, self._joints]
        added = [own * np.cos(q).T, own * np.sin(q).T]
        if torques is not None:
            added.insert(0, own * torques.T)
        return np.concatenate([J[:, : self._k], *added], axis=1)

    def planned_gram(self, origin: Geometry) -> Array:
        """Return the mean of ``J^T J`` (k, k) over the planned stops; computed anew if the geometry changed much."""
        vector = origin.vector()
        if self._gram_at is None or np.max(np.abs(vector - self._gram_at)) > _GRAM_VALID:
            _, J = jacobian(origin, self._planned, self._columns[: self._k])
            self._gram, self._gram_at = gram_matrix(J) / self._planned.count, vector
            if self._gravity is not None:
                self._torques = self._torques_of(origin, self._planned_q)
        return self._gram

    def _torques_of(self, origin: Geometry, q: Array) -> Array:
        """Compute the gravity torques (n, N) [Nm]."""
        assert self._gravity is not None
        return gravity_loads(frame_poses(origin, q), self._gravity.bodies, self._gravity.up_M).joint_torques()
