"""Identification of one arm while its stops are measured: a new estimate and its standard errors after every stop.

Between renewals the measurement model is linear about one geometry, and a new reading adds three rows to the normal
equations. A renewal linearises all readings again at the present estimate. Renewals follow a growing schedule, and come
at once where the estimate has left the range in which the linear model holds.

Few readings do not determine all parameters. Weak priors about the nominal arm then do; with many readings they have no
effect. The weights are those of ``identification.identify_with_excess``: stated covariance plus the excess variance
that unmodelled physics leaves. A gross error (a wrong target) gets no weight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.identification import SetName, start_from_nominal
from cellapp.calibration.linear import inverse_psd
from cellapp.calibration.normal_equations import Linearisation, Observations, normal_equations
from cellapp.calibration.parameters import ParameterSet, auto_set, full_set, gram_matrix, paper_set
from cellapp.calibration.weights import MEDIAN_NORM, RobustName, excess_variance, robust_weights, whitener
from cellapp.errors import InputError
from cellapp.kinematics.chain import BASE_NAMES, TOOL_NAMES, Geometry, JointAngles, jacobian
from cellapp.kinematics.transforms import Array
from cellapp.model.nominal import nominal_arm, prior_sigmas
from cellapp.profile import Profile
from cellapp.progress import StopReport

_PRIOR = {"m": 10e-3, "rad": 20e-3}
"""Standard deviation of the arm's own parameters about the nominal ones: ten times what arms of this size show, so that
a few stops are enough to predict, and 100 stops leave no trace of it."""
_TOOL_PRIOR_M = 20e-3
"""Standard deviation of the SMR offset: an adapter measured with a ruler."""
_UNKNOWN_TOOL_PRIOR_M = 0.3
"""The same for an offset that the profile calls unknown: any adapter."""
_FIRST_READINGS = 4
"""Readings from which the base is found. Three determine it; a fourth shows whether they fit."""
_LEAST_SPREAD_M = 0.05
"""Least rms distance of the first points from their common line: with errors of some millimetres, the base is then
known to 0.1 rad, from where Gauss-Newton steps converge."""
_EARLY_READINGS = 12
"""Up to this number the base is registered again for each reading: each changes the estimate by millimetres."""
_GROWTH = 1.2
"""Growth of the number of readings between renewals: 20 renewals up to 400 readings."""
_LINEAR = 3e-4
"""Largest change of a parameter at arm's length [m] for one linearisation; the neglected second order is 0.1 um."""
_STEPS = 4
"""Most Gauss-Newton steps of a renewal; one is enough after the first readings."""
_FIRST_EXCESS_M = 1e-4
"""Excess standard deviation of a coordinate until the readings tell it: what gravity and backlash leave in UR arms."""
_LEAST_FREEDOM = 10.0
"""Degrees of freedom from which the excess is estimated."""
_ANCHOR = 4.0
"""Degrees of freedom with which the scatter is held at the expected one, while there are few readings."""
_GROSS = 12.0
"""Residual beyond which a reading has no weight, in standard uncertainties: far above any of unmodelled physics."""
_GRAM_VALID = 2e-3
"""Largest change of a parameter [m or rad] for one Jacobian of the planned stops; it changes by about as much."""
_LEAST_VARIANCE = 1e-14
"""Variance (0.1 um)^2 of points without stated noise that fit exactly: weights stay finite."""


@dataclass(frozen=True)
class Prediction:
    """Where the model expects an SMR.

    Attributes
    ----------
    p_M : array, shape (3,)
        [m]
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
        """Standard uncertainty of the distance between the SMR that will be measured and ``p_M`` [m]."""
        return math.sqrt(float(np.trace(self.covariance_M)) + 3.0 * self.scatter_m**2)


@dataclass(frozen=True)
class Innovation:
    """A reading against the model that did not know it yet.

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
    freedom : float
        Degrees of freedom from which the scatter was estimated.
    """

    stop: int
    p_M: Array
    off_M: Array
    covariance_M: Array
    R_M_F: Array
    freedom: float


def online_fit(profile: Profile, name: str, planned_q: Array) -> OnlineFit:
    """The fit of an arm as the profile's calibration section asks; ``planned_q`` (n, N) [rad] are the planned stops."""
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
    )


class OnlineFit:
    """The geometry of one arm, refitted after every stop. It has no model until ``ready``.

    Parameters
    ----------
    arm : str
        Name, for the reports.
    nominal : Geometry
        Nominal chain; its base is not used.
    planned_q : array, shape (n, N)
        Joint positions [rad] over which the uncertainty of a prediction is averaged.
    parameter_set : str
        ``auto``, ``paper`` or ``full``. Redundant parameters of ``full`` are held by the priors.
    prior_sigma : mapping, optional
        Parameter -> standard deviation about the nominal one, instead of the weak ones of this module.
    robust : str
        ``none``, ``huber`` or ``tukey``; these weights are renewed with the linearisation.
    tool_unknown : bool
        Whether the SMR offset is unknown.

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
    ) -> None:
        self.arm = arm
        self.innovation: Innovation | None = None
        """The newest reading against the model before it; None where there was none."""
        self._nominal, self._tool_unknown, self._robust = nominal, tool_unknown, robust
        self._parameters = _parameter_set(arm, parameter_set, nominal, planned_q)
        self._columns = list(self._parameters.columns)
        self._tool = [self._parameters.names.index(name) for name in TOOL_NAMES]
        self._precision = _precision(self._parameters, prior_sigma or {}, tool_unknown=tool_unknown)
        self._planned = _Planned(JointAngles.of(planned_q), self._parameters.columns)
        self._readings = _Readings(nominal.joints)
        self._model: _LinearModel | None = None
        self._next_renewal = 0

    @property
    def count(self) -> int:
        """Number of readings."""
        return self._readings.count

    @property
    def ready(self) -> bool:
        """Whether there is a model: after four readings, if their points are spread."""
        return self._model is not None

    @property
    def geometry(self) -> Geometry | None:
        """The present estimate."""
        return None if self._model is None else self._model.geometry(self._columns)

    @property
    def scatter_m(self) -> float | None:
        """Standard deviation of a measured coordinate about the model [m]."""
        return None if self._model is None else self._model.scatter_m

    def predict(self, q: Array) -> Prediction | None:
        """Where the SMR is expected at ``q`` (N,) [rad]; None without a model."""
        model = self._model
        if model is None:
            return None
        P, J = self._row(model, q)
        return Prediction(P + J @ model.step, J @ model.covariance @ J.T, model.scatter_m)

    def add(self, stop: int, q: Array, p_M: Array, covariance_M: Array | None = None) -> StopReport | None:
        """Refit with one reading: ``q`` (N,) [rad], ``p_M`` (3,) [m], ``covariance_M`` (3, 3) [m^2].

        None while there is no model.
        """
        self._readings.append(q, p_M, covariance_M)
        self.innovation = None
        if self._model is not None:
            self._insert(self._model, stop, q, p_M)
        if self._model is None or self.count <= _EARLY_READINGS:
            self._renew(registered=True)
        elif self.count >= self._next_renewal or self._model.moved > _LINEAR:
            self._renew()
        return self._report(stop, q, p_M)

    def add_all(
        self, stops: Sequence[int], q: Array, p_M: Array, covariance_M: Array | None = None
    ) -> StopReport | None:
        """Refit with stored readings: ``q`` (n, N) [rad], ``p_M`` (n, 3) [m], ``covariance_M`` (n, 3, 3), NaN: none.

        The report is that of the last one.
        """
        if not len(stops):
            return None
        for row in range(len(stops)):
            self._readings.append(q[row], p_M[row], None if covariance_M is None else covariance_M[row])
        self.innovation = None
        self._renew(registered=self._model is None or self.count <= _EARLY_READINGS)
        return self._report(stops[-1], q[-1], p_M[-1])

    def _report(self, stop: int, q: Array, p_M: Array) -> StopReport | None:
        model = self._model
        if model is None:
            return None
        P, J = self._row(model, q)
        errors = np.sqrt(np.diag(model.covariance)).tolist()
        return StopReport(
            stop=stop,
            arm=self.arm,
            residual_mm=1e3 * float(np.linalg.norm(p_M - P - J @ model.step)),
            standard_error_mm=1e3 * self._planned.standard_error(model),
            parameter_errors=dict(zip(self._parameters.names, errors, strict=True)),
        )

    def _row(self, model: _LinearModel, q: Array) -> tuple[Array, Array]:
        """SMR position (3,) and Jacobian (3, k) at the linearisation; those of the last ``q`` are kept."""
        if model.row is None or not np.array_equal(model.row[0], q):
            P, J = jacobian(model.origin, JointAngles.of(q[None]), self._parameters.columns)
            model.row = (q.copy(), P[:, 0], np.ascontiguousarray(J[:, :, 0]))
        return model.row[1], model.row[2]

    def _insert(self, model: _LinearModel, stop: int, q: Array, p_M: Array) -> None:
        """Add the three rows of the newest reading to the linear model."""
        P, J = self._row(model, q)
        noise = self._readings.newest_stated() + model.excess * np.eye(3)
        off = p_M - P
        innovation = off - J @ model.step
        expected = J @ model.covariance @ J.T + model.variance * noise
        self.innovation = Innovation(stop, p_M, innovation, expected, J[:, self._tool], model.freedom)
        if innovation @ np.linalg.solve(expected, innovation) <= _GROSS**2:
            model.add(J, off, noise)
            model.solve(self._precision)

    def _renew(self, *, registered: bool = False) -> None:
        """Linearise all readings at the present estimate, or, ``registered``, from the nominal arm again."""
        start = self._registered() if registered else self.geometry
        if start is None:
            return
        before = self._model
        excess = _FIRST_EXCESS_M**2 if before is None else before.excess
        variance = 1.0 if before is None else before.variance
        for number in range(_STEPS):
            known = None if registered and number == 0 else before
            model = self._linearised(start, known, excess)
            model.variance = variance
            model.solve(self._precision)
            model.solve(self._precision)  # with the scatter that the first solution left
            before, self._model = model, model
            if model.moved <= _LINEAR:
                break
            start, excess, variance = model.geometry(self._columns), model.excess, model.variance
        self._next_renewal = math.ceil(_GROWTH * self.count)

    def _registered(self) -> Geometry | None:
        """The nominal arm with its base at the points; None if they are too few or nearly on one line."""
        q, p_M = self._readings.q, self._readings.p_M
        if len(q) < _FIRST_READINGS:
            return None
        spread = np.linalg.svd(p_M - p_M.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(q))
        if spread < _LEAST_SPREAD_M:
            return None
        return start_from_nominal(self._nominal, q, p_M, tool_unknown=self._tool_unknown)

    def _linearised(self, origin: Geometry, before: _LinearModel | None, excess: float) -> _LinearModel:
        """The model at ``origin``; excess and weights follow from the residuals there if ``before`` was near it."""
        readings, values = self._readings, origin.vector()[self._columns]
        angles = JointAngles.of(readings.q)
        P, J = jacobian(origin, angles, self._parameters.columns)
        residuals = readings.p_M - P.T
        stated, weights = readings.stated(), np.ones(readings.count)
        if before is not None:
            weights = _gross_weights(residuals, stated, excess)
            if before.freedom >= _LEAST_FREEDOM:
                excess = _excess(residuals, stated, weights > 0.0, before.freedom)
        white = whitener(stated + excess * np.eye(3))
        observations = Observations(angles, readings.q, np.ascontiguousarray(readings.p_M.T), white, None)
        if before is not None and self._robust != "none":
            norm = np.linalg.norm(observations.whiten(residuals.T, 0, readings.count), axis=0)
            weights = weights * robust_weights(norm, self._robust)
        linear = Linearisation(P, J, gram_matrix(J))
        normal = normal_equations(origin, observations, self._parameters, values, weights, linear)
        mean = self._nominal.vector()[self._columns]
        mean_stated = float(np.trace(stated, axis1=1, axis2=2).mean()) / 3.0
        return _LinearModel(
            origin,
            normal.A,
            normal.b,
            normal.cost,
            normal.scale,
            int(np.count_nonzero(weights)),
            mean - values,
            excess,
            mean_stated,
        )


@dataclass
class _LinearModel:
    """Normal equations of all readings about ``origin``, and their solution.

    Attributes
    ----------
    origin : Geometry
    A, b, cost : array (k, k), array (k,), float
        ``sum J^T W J``, ``sum J^T W r``, ``sum r^T W r`` at the origin.
    scale : array, shape (k,)
        Parameters to metres at arm's length.
    used : int
        Number of readings with a weight.
    prior_step : array, shape (k,)
        From the origin to the mean of the priors.
    excess, mean_stated : float
        Variance of a coordinate: excess, mean of the stated ones [m^2].
    variance : float
        Chi-square per degree of freedom.
    freedom : float
        Degrees of freedom: coordinates less the parameters that they determine.
    step, covariance : array (k,), array (k, k)
        From the origin to the estimate, and its covariance.
    row : tuple, optional
        The last joint positions, with SMR position and Jacobian there.
    """

    origin: Geometry
    A: Array
    b: Array
    cost: float
    scale: Array
    used: int
    prior_step: Array
    excess: float
    mean_stated: float
    variance: float = 1.0
    freedom: float = 1.0
    step: Array = field(default_factory=lambda: np.zeros(0))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    row: tuple[Array, Array, Array] | None = None

    @property
    def moved(self) -> float:
        """Largest component of ``step`` [m at arm's length]."""
        return float(np.max(np.abs(self.step * self.scale)))

    @property
    def scatter_m(self) -> float:
        """Standard deviation of a measured coordinate about the model [m]."""
        return math.sqrt(self.variance * (self.excess + self.mean_stated))

    def geometry(self, columns: list[int]) -> Geometry:
        """The estimate."""
        vector = self.origin.vector()
        vector[columns] += self.step
        return self.origin.with_vector(vector)

    def add(self, J: Array, off: Array, noise: Array) -> None:
        """Add a reading: Jacobian (3, k), measured minus computed position (3,) at the origin, covariance (3, 3)."""
        weighted = np.linalg.solve(noise, np.column_stack([J, off]))
        added = J.T @ weighted
        self.A += added[:, :-1]
        self.b += added[:, -1]
        self.cost += float(off @ weighted[:, -1])
        self.used += 1

    def solve(self, precision: Array) -> None:
        """Estimate, covariance and scatter, with the prior precision (k,) of each parameter."""
        unit = 1.0 / self.scale
        H = self.A / self.variance
        H.flat[:: len(H) + 1] += precision
        self.covariance = inverse_psd(H * unit * unit[:, None]) * unit * unit[:, None]
        self.step = self.covariance @ (self.b / self.variance + precision * self.prior_step)
        held = float(precision @ np.diag(self.covariance))  # number of parameters that the priors determine
        self.freedom = max(1.0, 3.0 * self.used - len(precision) + held)
        chi_square = self.cost - float(self.step @ (2.0 * self.b - self.A @ self.step))
        self.variance = (max(chi_square, 0.0) + _ANCHOR) / (self.freedom + _ANCHOR)


class _Readings:
    """All readings of the arm, in arrays that grow by doubling."""

    def __init__(self, joints: int) -> None:
        self.count = 0
        self._q, self._p_M, self._stated = np.empty((64, joints)), np.empty((64, 3)), np.empty((64, 3, 3))

    @property
    def q(self) -> Array:
        """Joint positions (n, N) [rad]."""
        return self._q[: self.count]

    @property
    def p_M(self) -> Array:
        """Measured points (n, 3) [m]."""
        return self._p_M[: self.count]

    def append(self, q: Array, p_M: Array, covariance_M: Array | None) -> None:
        """Store one reading."""
        if self.count == len(self._q):
            self._q, self._p_M, self._stated = (
                np.concatenate([old, np.empty_like(old)]) for old in (self._q, self._p_M, self._stated)
            )
        self._q[self.count], self._p_M[self.count] = q, p_M
        self._stated[self.count] = math.nan if covariance_M is None else covariance_M
        self.count += 1

    def stated(self) -> Array:
        """Stated covariances (n, 3, 3) [m^2]: the mean of the others where there is none, zero where none has one."""
        stated = self._stated[: self.count]
        missing = np.isnan(stated).any(axis=(1, 2))
        if not missing.any():
            return stated
        filled = stated.copy()
        filled[missing] = 0.0 if missing.all() else stated[~missing].mean(axis=0)
        return filled

    def newest_stated(self) -> Array:
        """Stated covariance (3, 3) [m^2] of the newest reading."""
        newest = self._stated[self.count - 1]
        return np.asarray(self.stated()[-1] if np.isnan(newest).any() else newest)


class _Planned:
    """The planned stops, and the mean of ``J^T J`` over them, which changes little between renewals."""

    def __init__(self, angles: JointAngles, columns: tuple[int, ...]) -> None:
        self._angles, self._columns = angles, columns
        self._vector: Array | None = None
        self._gram = np.zeros((len(columns), len(columns)))

    def standard_error(self, model: _LinearModel) -> float:
        """Standard uncertainty of a predicted position from the parameters alone, rms over the stops [m]."""
        vector = model.origin.vector()
        if self._vector is None or np.max(np.abs(vector - self._vector)) > _GRAM_VALID:
            _, J = jacobian(model.origin, self._angles, self._columns)
            self._gram, self._vector = gram_matrix(J) / self._angles.count, vector
        return math.sqrt(max(float(np.vdot(self._gram, model.covariance)), 0.0))


def _parameter_set(arm: str, wanted: SetName, nominal: Geometry, planned_q: Array) -> ParameterSet:
    try:
        if wanted == "auto":
            return auto_set(nominal, planned_q)
        return paper_set(nominal) if wanted == "paper" else full_set(nominal)
    except ValueError as error:
        raise InputError(f"arm '{arm}': calibration.parameter_set: {error}") from None


def _precision(parameters: ParameterSet, given: Mapping[str, float], *, tool_unknown: bool) -> Array:
    """Prior precision (k,) of each parameter: zero for the base, which four points determine."""
    tool = _UNKNOWN_TOOL_PRIOR_M if tool_unknown else _TOOL_PRIOR_M
    weak = {name: math.inf for name in BASE_NAMES} | {name: tool for name in TOOL_NAMES}
    sigma = [
        given.get(name, weak.get(name, _PRIOR[unit]))
        for name, unit in zip(parameters.names, parameters.units, strict=True)
    ]
    return 1.0 / np.array(sigma) ** 2


def _gross_weights(residuals: Array, stated: Array, excess: float) -> Array:
    """Weight 0 of readings (n,) whose residual (n, 3) is far above that of most others, else 1."""
    variance = excess + np.trace(stated, axis1=1, axis2=2) / 3.0
    norm = np.sqrt(np.sum(residuals**2, axis=1) / variance)
    return np.where(norm > _GROSS * max(float(np.median(norm)) / MEDIAN_NORM, 1.0), 0.0, 1.0)


def _excess(residuals: Array, stated: Array, used: NDArray[np.bool_], freedom: float) -> float:
    """Excess variance of a coordinate [m^2]; without stated covariances, all of the variance."""
    if not stated.any():
        return max(float(np.sum(residuals[used] ** 2)) / freedom, _LEAST_VARIANCE)
    return excess_variance(residuals[used], stated[used], round(freedom))
