"""Identification of one arm while its stops are measured: fitted anew as readings come, from the last result.

Few readings do not determine all parameters. Priors about the nominal arm then do, as in ``identification``. The
weights are the stated covariance plus the excess variance from unmodelled physics. A gross error (a wrong target) is
left out.

Predictions come from a second fit. It adds to the geometry the joints' compliance under gravity and an error of one
cycle a turn in each joint. The first fit is what ``calibrate`` identifies; on a UR10, gravity leaves it residuals of
half a millimetre, which hide a loose SMR.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import Identification, identify, start_from_nominal
from cellapp.estimation.calibration.least_squares import excess_variance, usual_scatter
from cellapp.estimation.calibration.normal_equations import EffectColumns, Observations, linearise
from cellapp.estimation.calibration.parameters import estimated_parameters, gram_matrix, weak_priors
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import StopReport
from cellapp.robot.effects.context import joint_column
from cellapp.robot.kinematics.chain import TOOL_NAMES, Geometry, JointAngles, flange_poses, frame_poses
from cellapp.robot.kinematics.statics import gravity_loads
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
_GROWTH = 1.1
"""Growth of the number of readings between two fits: 45 fits up to 400 readings. In between, the last one predicts."""
NO_GEOMETRY_M = 2e-3
"""Scatter about the model [m] larger than any arm's and any unmodelled physics: the geometry itself is wrong."""
_STEPS = 30
"""Maximum number of steps of a fit; a few are enough after the first readings."""
_STEP_M = 1e-6
"""Step at which a fit ends [m at arm's length]."""
_FIRST_EXCESS_M = 1e-4
"""Excess standard deviation of a coordinate until it is estimated: what gravity and backlash leave in UR arms."""
_LEAST_FREEDOM = 10.0
"""Degrees of freedom from which the excess variance is estimated."""
_ROUNDS, _SETTLED = 6, 0.1
"""Maximum number of fits with the weights of the one before, and relative change of the excess variance that ends them:
the next readings change it as much."""
_LEAST_VARIANCE = 1e-14
"""Least variance, (0.1 um)^2, for points without stated noise that fit exactly: it keeps weights finite."""
_ANCHOR = 4.0
"""Prior degrees of freedom that hold the scatter at the expected one while there are few readings."""
GROSS = 12.0
"""Residual beyond which a reading is left out, in standard uncertainties: far above that of unmodelled physics."""
_COMPLIANCE_SD = 5e-5
"""Prior standard deviation of a joint's compliance about zero [rad/Nm]: gears of such arms have 1e4 to 1e5 Nm/rad."""
_WAVE_SD = 8e-5
"""Prior standard deviation of a joint error of one cycle a turn [rad]: encoder disk 2 um off axis, 25 mm radius."""


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


@dataclass(frozen=True)
class Residuals:
    """Residuals of one arm's readings by a model.

    Attributes
    ----------
    length_m : array, shape (n,)
        Distance of each point from the model's [m].
    sigma_m : array, shape (n,)
        Rms of this distance from stated noise and scatter [m]: the root of the trace of the covariance.
    gross : array, shape (n,)
        Mask of gross errors, which are left out of the fit.
    """

    length_m: Array
    sigma_m: Array
    gross: NDArray[np.bool_]


@dataclass(frozen=True)
class _BatchFit:
    """A fit, the excess variance of a coordinate that follows from it, the mean of the stated variances [m^2], and
    chi-square per degree of freedom."""

    found: Identification
    gross: NDArray[np.bool_]
    excess: float
    mean_stated: float
    variance: float

    @property
    def scatter_m(self) -> float:
        """Standard deviation of a measured coordinate about the model [m]."""
        return math.sqrt(self.variance * (self.excess + self.mean_stated))


class OnlineFit:
    """Geometry of one arm, fitted while its stops are measured. There is no model until ``ready``.

    Where a fit does not converge, there is no model, and nothing is predicted or reported, until one with further
    readings does.

    Parameters
    ----------
    profile : Profile
        Its calibration section says what is fitted; priors hold the redundant parameters of the set ``full``.
    arm : str
        Name.
    planned_q : array, shape (n, N)
        Joint positions [rad] of the planned stops, over which the uncertainty of a prediction is averaged.

    Raises
    ------
    InputError
        If the parameter set is not for this arm.
    """

    def __init__(self, profile: Profile, arm: str, planned_q: Array) -> None:
        self.arm = arm
        self.innovation: Innovation | None = None
        """Innovation of the newest reading; None if there was no model before it."""
        its, settings = profile.arms[arm], profile.calibration
        nominal, self._tool_unknown = nominal_arm(its), its.smr.offset == "unknown"
        self._nominal, self._bodies, self._up_M = nominal, bodies_of(its), up_in_tracker(profile)
        self._planned = JointAngles.of(planned_q)
        typical = replace(nominal, tool=OFF_AXIS) if self._tool_unknown else nominal
        stated = prior_sigmas(nominal, settings.priors, its.fixed)
        try:
            parameters, _ = estimated_parameters(settings.parameter_set, typical, stated)
        except ValueError as error:
            raise InputError(f"arm '{arm}': calibration.parameter_set: {error}") from None
        # The base has no prior: four points determine it.
        priors = dict.fromkeys(TOOL_NAMES, _UNKNOWN_TOOL_PRIOR_M if self._tool_unknown else _TOOL_PRIOR_M)
        if settings.parameter_set != "auto":
            priors |= weak_priors(nominal.joints)
        self._identify = partial(
            identify,
            parameter_set="auto" if settings.parameter_set == "auto" else parameters,
            prior_sigma=priors | stated,
            prior_mean=nominal,
            robust=settings.robust,
            tolerance=_STEP_M,
        )
        self._q, self._p_M = np.empty((0, nominal.joints)), np.empty((0, 3))
        self._covariance_M = np.empty((0, 3, 3))
        self._fits: tuple[_BatchFit, _BatchFit] | None = None
        """By the geometry alone, and with the joint errors."""
        self._next = 0

    @property
    def count(self) -> int:
        """Number of readings."""
        return len(self._q)

    @property
    def ready(self) -> bool:
        """Whether there is a model: after four readings, if their points are spread out and the fit converged."""
        return self._fits is not None and all(fit.found.converged for fit in self._fits)

    @property
    def _model(self) -> tuple[_BatchFit, _BatchFit] | None:
        return self._fits if self.ready else None

    @property
    def geometry(self) -> Geometry | None:
        """Present estimate, without compliance; None without a model."""
        return None if self._model is None else self._model[0].found.geometry

    def add(self, stops: Sequence[int], q: Array, p_M: Array, covariance_M: Array | None = None) -> StopReport | None:
        """Add readings: ``q`` (n, N) [rad], ``p_M`` (n, 3) [m], ``covariance_M`` (n, 3, 3) [m^2], NaN: none; fit if it
        is time to.

        Return the report of the last one; None without readings or model.
        """
        if not len(stops):
            return None
        given = np.full((len(q), 3, 3), math.nan) if covariance_M is None else covariance_M
        self._q, self._p_M = np.concatenate([self._q, q]), np.concatenate([self._p_M, p_M])
        self._covariance_M = np.concatenate([self._covariance_M, given])
        self.innovation = self._innovation(stops[-1], q[-1], p_M[-1])
        if not self.ready or self.count >= self._next or self.count in _REGISTERED_AGAIN:
            self.refit()
        return self.report(stops[-1], q[-1], p_M[-1])

    def refit(self) -> None:
        """Fit all readings from the last result; at first, and again with a few more readings, from the nominal arm."""
        start = None if self.count in _REGISTERED_AGAIN else self.geometry
        before: Sequence[_BatchFit | None] = (None, None) if start is None or self._fits is None else self._fits
        start = self._registered() if start is None else start
        if start is None:
            return
        geometry = self._fitted(start, before[0], with_errors=False)
        self._fits = geometry, self._fitted(geometry.found.geometry, before[1], with_errors=True)
        self._next = math.ceil(_GROWTH * self.count)

    def residuals(self) -> Residuals | None:
        """Compute the residuals of all readings by the geometry alone, in order of arrival; None without a model."""
        if self._model is None:
            return None
        fit, stated = self._model[0], self._stated()
        residuals_M = self._residuals_M(fit.found, self._q, self._p_M)
        variance = fit.variance * (np.trace(stated, axis1=1, axis2=2) + 3.0 * fit.excess)
        gross = _gross(residuals_M, stated, fit.excess)
        return Residuals(np.linalg.norm(residuals_M, axis=1), np.sqrt(variance), gross)

    def lengths_m(self, q: Array, p_M: Array) -> Array | None:
        """Compute residual lengths (n,) [m] of points ``p_M`` (n, 3) [m] at ``q`` (n, N) [rad]; None if not ready."""
        return None if self._model is None else np.linalg.norm(self._residuals_M(self._model[0].found, q, p_M), axis=1)

    def _stated(self) -> Array:
        """Return stated covariances (n, 3, 3) [m^2]; a missing one is the mean of the others, zero without any."""
        missing = np.isnan(self._covariance_M.sum(axis=(1, 2)))
        usual = np.zeros((3, 3)) if missing.all() else self._covariance_M[~missing].mean(axis=0)
        return np.where(missing[:, None, None], usual, self._covariance_M)

    def _innovation(self, stop: int, q: Array, p_M: Array) -> Innovation | None:
        """Compare a reading with the last fit. One that did not converge says nothing about it, unless no geometry fits
        the readings at all."""
        if self._fits is None or not (self.ready or self._fits[1].scatter_m > NO_GEOMETRY_M):
            return None
        fit = self._fits[1]
        P, J = self._rows(fit.found, q[None])
        J, noise = J[:, :, 0], self._stated()[-1] + fit.excess * np.eye(3)
        covariance = fit.variance * (J @ fit.found.estimated_covariance @ J.T + noise)
        R_M_F = flange_poses(fit.found.geometry, q[None])[0][0]
        freedom = float(fit.found.degrees_of_freedom)
        return Innovation(stop, p_M, p_M - P[:, 0], covariance, R_M_F, fit.scatter_m, freedom)

    def report(self, stop: int, q: Array, p_M: Array) -> StopReport | None:
        """Report a stop by the last fit; None without a model."""
        if self._model is None:
            return None
        found = self._model[0].found
        _, J = found.estimated.jacobian(found.geometry, self._planned)
        mean_square = float(np.vdot(gram_matrix(J), found.estimated_covariance)) / self._planned.count
        residual_m = float(np.linalg.norm(self._residuals_M(found, q[None], p_M[None])))
        return StopReport(
            stop=stop, arm=self.arm, residual_mm=1e3 * residual_m, standard_error_mm=1e3 * math.sqrt(mean_square)
        )

    def _residuals_M(self, found: Identification, q: Array, p_M: Array) -> Array:
        """Compute the residuals (n, 3) [m] of points."""
        return np.asarray(p_M - self._rows(found, q)[0].T)

    def _rows(self, found: Identification, q: Array) -> tuple[Array, Array]:
        """Compute SMR positions and their derivatives at ``q`` (n, N) [rad] by the parameters of a fit."""
        effects = self._errors(q) if len(found.effect_values) else None
        observations = Observations(JointAngles.of(q), q, np.zeros((3, len(q))), None, effects)
        return linearise(found.geometry, observations, found.estimated, found.effect_values, 0, len(q))

    def _errors(self, q: Array) -> EffectColumns:
        """Return the joint errors at ``q`` (n, N) [rad]: a cosine and a sine of the joint angle, and the compliance
        under gravity. What they leave in the geometry is alike at neighbouring stops, and would look like a fault."""
        loads = gravity_loads(frame_poses(self._nominal, q), self._bodies, self._up_M)
        kinds = (np.cos(q), _WAVE_SD), (np.sin(q), _WAVE_SD), (loads.joint_torques(), _COMPLIANCE_SD)
        columns = [
            joint_column(f"error {joint + 1}", "", joint, offsets[:, joint], -math.inf, math.inf, prior_sd=sd)
            for offsets, sd in kinds
            for joint in range(q.shape[1])
        ]
        return EffectColumns.of(columns, len(q), np.zeros(len(columns)))

    def _registered(self) -> Geometry | None:
        """Register the nominal arm to the points; None if they are too few or nearly on one line."""
        q, p_M = self._q, self._p_M
        if len(q) < _FIRST_READINGS:
            return None
        spread = np.linalg.svd(p_M - p_M.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(q))
        if spread < _LEAST_SPREAD_M:
            return None
        return start_from_nominal(self._nominal, q, p_M, tool_unknown=self._tool_unknown)

    def _fitted(self, start: Geometry, before: _BatchFit | None, *, with_errors: bool) -> _BatchFit:
        """Fit until the excess variance of the residuals is that of the weights, without gross errors."""
        stated = self._stated()
        excess = _FIRST_EXCESS_M**2 if before is None else before.excess
        gross = np.zeros(self.count, dtype=np.bool_)
        if before is not None:
            gross = _gross(self._residuals_M(before.found, self._q, self._p_M), stated, excess)
        effects = self._errors(self._q) if with_errors else None
        for _ in range(_ROUNDS):
            rows = np.flatnonzero(~gross)
            sigma = stated[rows] + excess * np.eye(3)
            its = None if effects is None else effects.take(rows)
            found = self._identify(
                start, self._q[rows], self._p_M[rows], sigma=sigma, effects=its, max_iterations=_STEPS
            )
            start, cost = found.geometry, found.scale**2 * found.degrees_of_freedom
            variance = (cost + _ANCHOR) / (found.degrees_of_freedom + _ANCHOR)
            fit = _BatchFit(found, gross, excess, float(np.trace(stated, axis1=1, axis2=2).mean()) / 3.0, variance)
            if found.degrees_of_freedom >= _LEAST_FREEDOM:
                excess = _excess_of(found, stated[rows])
            # A gross error among the readings of a fit raises their excess: against that alone it would not stand out.
            gross = _gross(self._residuals_M(found, self._q, self._p_M), stated, min(excess, fit.excess))
            if abs(excess - fit.excess) <= _SETTLED * excess and np.array_equal(gross, fit.gross):
                break
        return fit


def _gross(residuals_M: Array, stated: Array, excess: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the readings whose residual (n, 3) [m] is far above that of most others."""
    norm = np.sqrt(np.sum(residuals_M**2, axis=1) / (excess + np.trace(stated, axis1=1, axis2=2) / 3.0))
    return np.asarray(norm > GROSS * usual_scatter(norm, 1.0))


def _excess_of(found: Identification, stated: Array) -> float:
    """Estimate the excess variance of a coordinate [m^2]; it is the whole variance if no covariance is stated."""
    if not stated.any():
        return max(float(np.sum(found.residuals**2)) / found.degrees_of_freedom, _LEAST_VARIANCE)
    return excess_variance(found.residuals, stated, found.degrees_of_freedom)
