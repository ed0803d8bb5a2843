"""Identification of an arm from a ball in sockets.

The points are unknown, so the data do not determine the base: it stays where the profile puts it. Parameters that act
like a motion of the base (theta1 and d1) stay nominal too. The noise of a coordinate is estimated with the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.gross_errors import gross_errors
from cellapp.estimation.calibration.identification import Identification, identify
from cellapp.estimation.calibration.normal_equations import parameter_scale
from cellapp.estimation.calibration.parameters import (
    ParameterSet,
    SetName,
    determined_set,
    estimated_parameters,
    prior_sds,
)
from cellapp.estimation.calibration.socket_points import PointColumns
from cellapp.estimation.calibration.weights import RobustName
from cellapp.estimation.readings import Readings
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.robot.kinematics.chain import TOOL_NAMES, Geometry, parameter_names, smr_positions

_ROUNDS = 12
"""Maximum rounds of identification, noise and directions of known distances; they settle in four to six."""
_SETTLED = 1e-3
"""Relative change of the noise at which the rounds end."""
_FIRST_NOISE_M = 1e-3
"""Noise of a coordinate before the first round: the error of a nominal arm."""
_LEAST_NOISE_M = 1e-9
"""Lower bound of the noise, for simulated readings without any."""
LIKE_THE_BASE = ("theta1", "d1")
"""Parameters of the arm that act exactly like a motion of its base."""

OF_THE_TRACKER = frozenset({"tracker_scale", "tracker_distance_offset", "tracker_angle_error", "target_incidence"})
"""Effects that only a tracker's beam can have."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Fit of an arm from sockets.

    Attributes
    ----------
    identification : Identification
        Its effect values are the parameters of the points.
    points : PointColumns
        Linearised at the solution.
    noise_m : float
        Standard deviation of a coordinate of the ball's centre in its socket [m].
    """

    identification: Identification
    points: PointColumns
    noise_m: float

    @property
    def geometry(self) -> Geometry:
        """Identified geometry."""
        return self.identification.geometry

    def tabulated(self, prior_sigma: Mapping[str, float], nominal: Geometry) -> Identification:
        """Return the identification with a table of the parameters that the readings determine, with points unknown."""
        found, estimated = self.identification, self.identification.estimated
        size = len(estimated.columns)
        covariance = found.estimated_covariance[:size, :size]
        prior_sd = prior_sds(estimated, prior_sigma)
        unit = np.sqrt(np.diag(covariance))
        information = np.linalg.inv(covariance / (unit * unit[:, None])) / (unit * unit[:, None])
        information[np.diag_indices(size)] -= prior_sd**-2.0
        chosen = determined_set(estimated, information, prior_sd) if estimated.name == "auto" else estimated
        to_table, kept = chosen.from_estimated(estimated)
        in_table = to_table @ covariance @ to_table.T
        mean = nominal.vector()[list(estimated.columns)]
        gram = information[kept[:, None], kept] * self.noise_m**2
        scale = parameter_scale(np.maximum(np.diag(gram), 0.0), len(found.residuals), chosen)
        return replace(
            found,
            estimated_covariance=covariance,
            parameter_set=chosen,
            names=chosen.names,
            units=chosen.units,
            values=mean[kept] + to_table @ (self.geometry.vector()[list(estimated.columns)] - mean),
            standard_errors=np.sqrt(np.diag(in_table)),
            covariance=in_table,
            effect_values=np.zeros(0),
            gram=gram / (scale * scale[:, None]) / len(found.residuals),
        )


def estimated_in_sockets(
    wanted: SetName, geometry: Geometry, prior_sigma: Mapping[str, float]
) -> tuple[ParameterSet, dict[str, float]]:
    """Return the parameters that sockets can determine, and the standard deviations of their priors [m, rad]."""
    whole, priors = estimated_parameters(wanted, geometry, prior_sigma)
    names = parameter_names(geometry.joints)
    unseen = {*names[:6], *LIKE_THE_BASE}
    columns = tuple(column for column in whole.columns if names[column] not in unseen)
    return ParameterSet(whole.name, geometry.joints, columns), {n: s for n, s in priors.items() if n not in unseen}


def identify_in_sockets(
    start: Geometry,
    readings: Readings,
    parameters: ParameterSet,
    prior_sigma: Mapping[str, float],
    *,
    prior_mean: Geometry | None = None,
    robust: RobustName = "none",
    tolerance: float = 1e-8,
    max_iterations: int = 50,
) -> Fit:
    """Identify ``parameters`` of an arm from readings in sockets; arguments are otherwise those of ``identify``.

    Raises
    ------
    TooFewReadings
        If there are fewer coordinates than parameters and not enough priors.
    """
    contacts, q = Contacts.of(readings), readings.q
    geometry, noise, weights, steps = start, _FIRST_NOISE_M, None, 0
    for _ in range(_ROUNDS):
        points = PointColumns.near(contacts, contacts.centres(smr_positions(geometry, q), weights))
        found = identify(
            geometry,
            q,
            points.measured,
            sigma=np.full(len(q), noise),
            parameter_set=parameters,
            prior_sigma=prior_sigma,
            prior_mean=prior_mean or start,
            robust=robust,
            effects=points.after(None),
            tolerance=tolerance,
            max_iterations=max_iterations,
        )
        geometry, steps = found.geometry, steps + found.iterations
        weights = np.maximum(found.weights, 1e-9)
        change, noise = abs(found.scale - 1.0), max(noise * found.scale, _LEAST_NOISE_M)
        if change <= _SETTLED or noise <= _LEAST_NOISE_M:
            break
    return Fit(replace(found, iterations=steps, scale=noise), points, noise)


def start_in_sockets(nominal: Geometry, readings: Readings, *, tool_unknown: bool) -> Geometry:
    """Return the nominal arm; if the ball's offset is unknown, fit it, beginning at the last frame's origin."""
    if not tool_unknown:
        return nominal
    names = parameter_names(nominal.joints)
    tool = ParameterSet("ball", nominal.joints, tuple(names.index(name) for name in TOOL_NAMES))
    at_origin = replace(nominal, tool=np.zeros(3))
    alone = replace(readings, distances=())
    return identify_in_sockets(at_origin, alone, tool, {}, tolerance=1e-6).geometry


def gross_errors_in_sockets(start: Geometry, nominal: Geometry, readings: Readings) -> np.ndarray:
    """Return a mask (n,) of the readings that are gross errors by a robust fit, which gives them no weight."""
    parameters, priors = estimated_in_sockets("auto", nominal, {})
    alone = replace(readings, distances=())
    fit = identify_in_sockets(start, alone, parameters, priors, prior_mean=nominal, robust="tukey", tolerance=1e-6)
    return gross_errors(fit.identification.residuals)


def scale_spread(fit: Fit, prior_sigma: Mapping[str, float], nominal: Geometry) -> tuple[float, float]:
    """Compute the relative standard deviation of the distance between the two points furthest apart, and that of the
    common scale of all lengths by the priors alone, infinite without priors."""
    points, estimated = fit.points, fit.identification.estimated
    away = np.linalg.norm(points.at[:, None] - points.at, axis=2)
    a, b = np.unravel_index(int(np.argmax(away)), away.shape)
    along = np.zeros_like(points.at)
    along[a], along[b] = points.at[a] - points.at[b], points.at[b] - points.at[a]
    direction = points.basis.T @ along.ravel() / max(float(away[a, b]) ** 2, 1e-18)
    covariance = fit.identification.estimated_covariance[len(estimated.columns) :, len(estimated.columns) :]
    lengths = np.where(np.array(estimated.units) == "m", nominal.vector()[list(estimated.columns)], 0.0)
    of_priors = float(lengths**2 @ prior_sds(estimated, prior_sigma) ** -2.0)
    spread = math.sqrt(float(direction @ covariance @ direction))
    return spread, math.inf if of_priors == 0.0 else of_priors**-0.5
