"""Where the tracker stands after it was moved, where an arm stands, and how its controller counts.

The model predicts each point p_i(T) from the joint positions; T maps the tracker frame of the calibration into the
present one. With measured points m_i, minimise r^T S^-1 r over T, r_i = m_i - p_i(T). S is the covariance of all
coordinates together: noise of the tracker and of the arms, and the model's uncertainty, which the points of one
arm share. A twist (v, w) of the frame moves a predicted point by v + w x p. The gain of the solution is
G = (J^T S^-1 J)^-1 J^T S^-1. One sample d, n of the model's error and of the noise at the points gives one sample of
the station's error, -G (d + n): with it, samples of later predictions keep the correlation of station and model.

One rigid motion of the tracker explains all points of all arms if r^T S^-1 r is as chi-squared with 3 n - 6 degrees of
freedom allows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cellapp.estimation.calibration.least_squares import LeastSquares
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, flange_poses, nominal_geometry
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    invert,
    register,
    rms_length,
    rotation_from_vector,
    rotation_vectors,
    transform,
    twist_columns,
)
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import SAMPLES, relocated
from cellapp.robot.model.nominal import nominal_arm, published_rows

# -- Pose of the tracker ----------------------------------------------------------------------------------------------


FEWEST_POINTS = 3
LEAST_PROBABILITY = 1e-3
"""Probability of a larger chi-squared below which one motion does not explain the points: one false alarm in 1000."""
_LEAST_WIDTH = 0.05
"""Least ratio of the points' spread across their best line to that along it: below, rotation about it is unknown."""
_LEAST_SPREAD_M = 0.05
"""Least rms distance of the points along their best line: closer ones turn noise into more than a milliradian."""
_SMALL_STEP = 1e-9
"""Step size [m, rad] at which the iteration ends, a nanometre."""
_REWEIGHTED = 2
"""Number of times the covariances are computed: at the start, and once more at the solution."""


Points = Mapping[str, Readings]
"""Name of an arm -> its points in the present tracker frame, at least one, each with its covariance; with the joint
positions of the other arm in a cell of two, where known."""


@dataclass(frozen=True, eq=False)
class RoughStation:
    """Prior of a station before it is measured: ``T_new_old`` (4, 4), and the covariance (6, 6) of its twist."""

    T_new_old: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class StationFit:
    """Station that was fitted to n points.

    Attributes
    ----------
    T_new_old : array, shape (4, 4)
        Maps coordinates in the tracker frame of the model into the present tracker frame.
    covariance : array, shape (6, 6)
        Of its twist: shift at the present origin [m], then rotation [rad].
    residuals : mapping
        Arm -> measured minus predicted points (m, 3) [m].
    chi_squared : float
    degrees_of_freedom : int
    twists : array, shape (S, 6)
        Samples of the error of ``T_new_old``, one for each sample of the arms' posteriors.
    """

    T_new_old: Array
    covariance: Array
    residuals: Mapping[str, Array]
    chi_squared: float
    degrees_of_freedom: int
    twists: Array

    @property
    def probability(self) -> float:
        """Probability of a larger chi-squared if the fit holds; 1 without degrees of freedom."""
        return (
            float(scipy.special.chdtrc(self.degrees_of_freedom, self.chi_squared))
            if self.degrees_of_freedom > 0
            else 1.0
        )

    @property
    def explains(self) -> bool:
        """Whether the fit explains all points."""
        return self.probability >= LEAST_PROBABILITY

    @property
    def rms_m(self) -> float:
        """Root mean square length of the residuals [m]."""
        return rms_length(np.concatenate(list(self.residuals.values())))


def predicted_points(model: CellModel, points: Points) -> dict[str, Array]:
    """Predict the points of each arm, (m, 3) [m] in the tracker frame of ``model``."""
    return {
        name: model.arms[name].predict(own.q, beside(model, name, measurement_conditions(own), own.other_q))
        for name, own in points.items()
    }


def beside(
    model: CellModel, name: str, conditions: MeasurementConditions, other_q: Array | None
) -> MeasurementConditions:
    """Return conditions of an arm with the other one of two at ``other_q`` (n, K) [rad], where both are known."""
    other = model.other(name)
    return conditions if other is None or other_q is None else other.beside(conditions, other_q)


def fit_station(
    model: CellModel,
    points: Points,
    start: Array,
    *,
    excess_m: Mapping[str, float],
    seed: Sequence[int] = (0,),
    rough: RoughStation | None = None,
) -> StationFit:
    """Fit one motion of the tracker to points of one or more arms.

    Parameters
    ----------
    model : CellModel
        Model in the tracker frame of its calibration.
    points : mapping
    start : array, shape (4, 4)
        Rough ``T_new_old``.
    excess_m : mapping
        Arm -> standard deviation of a coordinate [m] by which readings scatter about the model beyond the covariance
        of the tracker and the model's own uncertainty: the arm's repeatability.
    seed : sequence of int
        Seed of the samples.
    rough : RoughStation or None
        Prior of the station; with it fewer than three points are enough, but the chi-squared test does not hold.

    Raises
    ------
    InputError
        Without ``rough``, if the points are too few, or lie together or on one line.
    NotConverged
    """
    if rough is None:
        measured_M = np.concatenate([own.p_M for own in points.values()] or [np.empty((0, 3))])
        _check_layout(measured_M, "the tracker's station")

    def linearised(station: Array) -> tuple[Array, Array]:
        """Compute residuals (3 n,) and derivatives (3 n, 6) of the predicted coordinates, then those of the prior."""
        expected = predicted_points(relocated(model, station), points)
        r = [(points[name].p_M - p_M).ravel() for name, p_M in expected.items()]
        J = [twist_columns(p_M).reshape(-1, 6) for p_M in expected.values()]
        if rough is not None:
            off = station @ invert(rough.T_new_old)
            r.append(-np.concatenate([off[:3, 3], rotation_vectors(off[None, :3, :3])[0]]))
            J.append(np.eye(6))
        return np.concatenate(r), np.concatenate(J)

    station = start
    of_prior = [] if rough is None else [np.linalg.cholesky(rough.covariance)]
    for _ in range(_REWEIGHTED):
        noise, sampled = _uncertainty(relocated(model, station), points, excess_m)
        L, n = np.linalg.cholesky(noise + sampled.T @ sampled / len(sampled)), len(noise)
        with_prior: Array = np.asarray(scipy.linalg.block_diag(L, *of_prior), dtype=np.float64)
        fit = LeastSquares(linearised, lambda T, step: small_motion(step, np.zeros(3)) @ T, with_prior)
        best = fit.best("fit of the tracker's station", station, tolerance=_SMALL_STEP).point
        station = best.state
    white_r, white_J = best.white
    covariance: Array = np.asarray(np.linalg.inv(white_J.T @ white_J), dtype=np.float64)
    gain = scipy.linalg.solve_triangular(L, white_J[:n], lower=True, trans=1) @ covariance
    rng = np.random.default_rng([*seed, 0x10C])
    sampled_noise = rng.standard_normal((len(sampled), n)) @ np.linalg.cholesky(noise).T
    ends = np.cumsum([len(own) for own in points.values()])
    return StationFit(
        T_new_old=station,
        covariance=covariance,
        residuals=dict(zip(points, np.split(best.r[:n].reshape(-1, 3), ends[:-1]), strict=True)),
        chi_squared=float(white_r[:n] @ white_r[:n]),
        degrees_of_freedom=n - 6,
        twists=-((sampled + sampled_noise) @ gain),
    )


def displacement_m(model: CellModel, points: Points, T_new_old: Array) -> float:
    """Compute the largest motion [m] of a predicted point by ``T_new_old``."""
    expected = np.concatenate(list(predicted_points(model, points).values()))
    return float(np.linalg.norm(apply(T_new_old, expected) - expected, axis=1).max())


# -- inside -----------------------------------------------------------------------------------------------------------


def _uncertainty(model: CellModel, points: Points, excess_m: Mapping[str, float]) -> tuple[Array, Array]:
    """Compute the noise covariance (3 n, 3 n) [m^2] and samples of the model's error (S, 3 n) [m] at the points."""
    noise, sampled = list[Array](), list[Array]()
    for name, own in points.items():
        arm, added = model.arms[name], np.full(len(own), excess_m[name] ** 2)
        assert own.covariance_M is not None
        if arm.network is not None:
            added += np.mean(arm.network.spread(own.q) ** 2, axis=1)
        noise += [*(own.covariance_M + added[:, None, None] * np.eye(3))]
        moved = np.zeros((SAMPLES, len(own), 3))
        if arm.posterior is not None:
            context = arm.context(own.q, beside(model, name, measurement_conditions(own), own.other_q))
            moved = arm.posterior.displacements(arm.geometry, arm.effects, context)
        sampled.append(moved.reshape(len(moved), -1))
    return np.asarray(scipy.linalg.block_diag(*noise), dtype=np.float64), np.concatenate(sampled, axis=1)


def _check_layout(points: Array, fixed: str, frame: str = "") -> None:
    """Raise ``InputError`` if points (n, 3) [m], given in a ``frame``, do not fix what is ``fixed`` by them."""
    n = len(points)
    if n < FEWEST_POINTS:
        raise InputError(f"{n} points do not fix {fixed}; measure at least {FEWEST_POINTS}, better four, far apart")
    along, *across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False).tolist()
    if along < _LEAST_SPREAD_M * math.sqrt(n):
        near = f"{along / math.sqrt(n) * 1e3:.0f} mm of one place{frame}"
        raise InputError(f"the points lie within {near}; measure points that are some 0.5 m apart")
    if math.hypot(*across) < _LEAST_WIDTH * along:
        raise InputError(
            f"the points lie on one line{frame}: nothing fixes the rotation about it; add a point beside the line"
        )


def small_motion(twist: Array, centre: Array) -> Array:
    """A small motion (4, 4) by a twist about a centre."""
    rotation = rotation_from_vector(twist[3:])
    return transform(rotation, centre - rotation @ centre + twist[:3])


# -- Poses of tracker stations in the frame of the first one, from reference nests, all in one fit --------------------
#
# The unknowns are the nest positions x (3 each) in the frame of the first station and the pose T of every other
# station. A nest that a station measured at p gives x - T p = 0, whitened by the uncertainty of p. The fit starts from
# pairwise ones.

FEWEST_NESTS = 3
"""Least number of common nests that fix a station's pose, if they are not on one line."""

_Places = tuple[dict[str, Array], Array]
"""Poses (4, 4) of all stations, and nests (k, 3) [m] in the first frame."""


@dataclass(frozen=True, eq=False)
class NestPoint:
    """A reference nest as one station measured it: position (3,) in its frame and standard uncertainty [m]."""

    station: str
    nest: str
    p: Array
    sigma_m: float


@dataclass(frozen=True, eq=False)
class StationTie:
    """Pose of a station in the frame of the first one.

    Attributes
    ----------
    T : array, shape (4, 4)
        Maps points of this station's frame into that of the first one.
    covariance : array, shape (6, 6)
        Covariance of its shift [m] and its rotation about the axes of the first frame at that frame's origin [rad].
    nests : tuple of str
        Nests that this and another station measured.
    residual_m : array, shape (n,)
        Distance of each of these nests from its fitted position [m].
    """

    station: str
    T: Array
    covariance: Array
    nests: tuple[str, ...]
    residual_m: Array

    def uncertainty(self, p_M: Array) -> Array:
        """Return the coordinate standard deviation (n,) that the tie adds to points (n, 3) in the first frame [m]."""
        J = twist_columns(p_M)
        return np.asarray(np.sqrt(np.einsum("nai,ij,naj->n", J, self.covariance, J) / 3.0))


class TooFewNests(ValueError):
    """Error for a station that cannot be tied to the first one; ``station`` is its name."""

    def __init__(self, station: str) -> None:
        super().__init__(f"station {station} shares fewer than {FEWEST_NESTS} nests with stations that are tied")
        self.station = station


def tie_stations(first: str, points: Sequence[NestPoint]) -> dict[str, StationTie]:
    """Fit the pose of every station but the first. Raise ``TooFewNests`` if one cannot be tied, or ``NotConverged``."""
    stations = [first, *(one for one in dict.fromkeys(p.station for p in points) if one != first)]
    T = _pairwise(stations, points)
    nests = list(dict.fromkeys(one.nest for one in points))
    placed = [apply(T[one.station], one.p[None])[0] for one in points]
    x: Array = np.array(
        [np.mean([p for one, p in zip(points, placed, strict=True) if one.nest == n], axis=0) for n in nests]
    )
    free = 6 * (len(stations) - 1)

    def linearised(one: _Places) -> tuple[Array, Array]:
        return _equations(stations, nests, points, *one)

    def after(one: _Places, step: Array) -> _Places:
        twists = step[:free].reshape(-1, 6)
        moved = {n: small_motion(own, np.zeros(3)) @ one[0][n] for n, own in zip(stations[1:], twists)}
        return {**one[0], **moved}, one[1] + step[free:].reshape(-1, 3)

    best = LeastSquares(linearised, after).best("fit of the tracker's stations to reference nests", (T, x)).point
    (T, x), b, A = best.state, best.r, best.A
    freedom = len(b) - A.shape[1]
    scatter = max(1.0, math.sqrt(float(b @ b) / freedom)) if freedom > 0 else 1.0
    covariance: Array = np.asarray(np.linalg.inv(A.T @ A) * scatter**2, dtype=np.float64)
    places: dict[str, Array] = {nest: np.asarray(at, dtype=np.float64) for nest, at in zip(nests, x, strict=True)}
    return {
        name: _tie(name, T[name], covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], points, places)
        for k, name in enumerate(stations[1:])
    }


def _pairwise(stations: Sequence[str], points: Sequence[NestPoint]) -> dict[str, Array]:
    """Register the stations one by one, each by the nests that it shares with those already registered."""
    T: dict[str, Array] = {stations[0]: np.eye(4)}
    remaining = list(stations[1:])
    while remaining:
        known = {one.nest: apply(T[one.station], one.p[None])[0] for one in points if one.station in T}
        for name in remaining:
            own = [one for one in points if one.station == name and one.nest in known]
            if len(own) >= FEWEST_NESTS and _spans(np.array([one.p for one in own])):
                T[name] = register(np.array([known[one.nest] for one in own]), np.array([one.p for one in own]))
                remaining.remove(name)
                break
        else:
            raise TooFewNests(remaining[0])
    return T


def _spans(p: Array) -> bool:
    """Return whether points (n, 3) are not on one line."""
    singular = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    return bool(singular[1] > 1e-3 * singular[0])


def _equations(
    stations: Sequence[str], nests: Sequence[str], points: Sequence[NestPoint], T: dict[str, Array], x: Array
) -> tuple[Array, Array]:
    """Compute the whitened residuals (3 m,) of m points and their derivatives (3 m, k)."""
    free = 6 * (len(stations) - 1)
    A = np.zeros((len(points), 3, free + 3 * len(nests)))
    b = np.zeros((len(points), 3))
    for row, one in enumerate(points):
        place = apply(T[one.station], one.p[None])[0]
        at = free + 3 * nests.index(one.nest)
        A[row, :, at : at + 3] = -np.eye(3)
        if one.station != stations[0]:
            k = 6 * (stations.index(one.station) - 1)
            A[row, :, k : k + 6] = twist_columns(place)
        b[row] = x[nests.index(one.nest)] - place
        A[row], b[row] = A[row] / one.sigma_m, b[row] / one.sigma_m
    return b.ravel(), A.reshape(-1, A.shape[2])


def _tie(name: str, T: Array, covariance: Array, points: Sequence[NestPoint], x: dict[str, Array]) -> StationTie:
    elsewhere = {one.nest for one in points if one.station != name}
    own = [one for one in points if one.station == name and one.nest in elsewhere]
    residual = [float(np.linalg.norm(apply(T, one.p[None])[0] - x[one.nest])) for one in own]
    return StationTie(name, T, covariance, tuple(one.nest for one in own), np.array(residual))


# -- Base and conventions of an arm -----------------------------------------------------------------------------------


# -- Pose of a robot base in the tracker frame from a few points that are known in both: rigid registration -----------
#
# With points p_B in the base frame and p_M in the tracker frame, minimise sum_i |p_M,i - (R p_B,i + t)|^2 over R, t
# (Kabsch 1976, ``robot.kinematics.transforms.register``). The covariance of t and of a small rotation applied after R
# is s^2 (J^T J)^-1 with J_i = [I, -[R p_B,i]_x], [v]_x w = v x w, and s^2 = sum of squared residuals / (3 n - 6).

_GOOD_M = 1e-3
"""Rms residual up to which a fit is good: the nominal geometry is then wrong by less than a millimetre."""
_USABLE_M = 10e-3
"""Rms residual up to which a plan still keeps its usual clearance of 50 mm and the tracker still finds the SMR."""
_MOST_M = 50e-3
"""Rms residual above which a point must be mistaken: errors of arm and tracker are smaller."""


@dataclass(frozen=True)
class BaseFit:
    """A registered base.

    Attributes
    ----------
    T_M_B : array, shape (4, 4)
        Maps base coordinates into the tracker frame.
    residuals : array, shape (n, 3)
        Measured minus fitted points in the tracker frame [m].
    rms : float
        Root mean square of the residuals' lengths [m].
    position_error : float
        Standard uncertainty of the base's origin [m]: the root of the sum of the variances of its coordinates.
    angle_error : float
        Standard uncertainty of the rotation [rad]: likewise of its three small angles.
    """

    T_M_B: Array
    residuals: Array
    rms: float
    position_error: float
    angle_error: float

    @property
    def worst(self) -> int:
        """Index of the point with the largest residual."""
        return int(np.argmax(np.linalg.norm(self.residuals, axis=1)))

    @property
    def sentence(self) -> str:
        """Quality of the fit in words."""
        figures = (
            f"{counted(len(self.residuals), 'point fits', 'points fit')} to {self.rms * 1e3:.2f} mm rms: the base"
            " is known to"
            f" {self.position_error * 1e3:.2f} mm and {math.degrees(self.angle_error):.3f} deg (one standard deviation)"
        )
        if self.rms <= _GOOD_M:
            return f"{figures}; good"
        largest = float(np.linalg.norm(self.residuals[self.worst]))
        if self.rms <= _USABLE_M:
            return f"{figures}; good enough to plan with, point {self.worst + 1} is off by {largest * 1e3:.1f} mm"
        return f"{figures}; poor: check point {self.worst + 1}, off by {largest * 1e3:.1f} mm, and the SMR offset"


def base_from_points(p_B: Array, p_M: Array) -> BaseFit:
    """Register a base from three or more points that are not on one line; with four or more, a mistaken one shows.

    Parameters
    ----------
    p_B : array, shape (n, 3)
        Points in the base frame [m].
    p_M : array, shape (n, 3)
        The same points in the tracker frame [m].

    Raises
    ------
    InputError
        If there are too few points, they lie together or on one line, or they do not fit at all.
    """
    _check_layout(p_B, "a base", " in the base frame")
    _check_layout(p_M, "a base", " in the tracker frame")
    T_M_B = register(p_M, p_B)
    residuals = p_M - apply(T_M_B, p_B)
    sum_of_squares = float(np.sum(residuals**2))
    fit = BaseFit(T_M_B, residuals, math.sqrt(sum_of_squares / len(p_B)), *_errors(T_M_B, p_B, sum_of_squares))
    if fit.rms > _MOST_M:
        raise InputError(
            f"the points fit to {fit.rms * 1e3:.0f} mm rms only; check units, the order of the points, and point"
            f" {fit.worst + 1}, which is off most"
        )
    return fit


def _errors(T_M_B: Array, p_B: Array, sum_of_squares: float) -> tuple[float, float]:
    """Compute the standard uncertainty of the base's origin [m] and of its rotation [rad]."""
    n = len(p_B)
    J = twist_columns(p_B @ T_M_B[:3, :3].T)
    normal = np.einsum("nai,naj->ij", J, J)
    variances = np.diag(np.linalg.inv(normal)) * sum_of_squares / (3 * n - 6)
    return math.sqrt(float(variances[:3].sum())), math.sqrt(float(variances[3:].sum()))


# -- Check whether an arm's published geometry explains recorded readings: units, order and signs of joints. No I/O ---
#
# A published arm misses measured points by some millimetres; with wrong joint conventions it misses them by
# decimetres. Base and tool are unknown, so the best ones are found for each convention: with the base's rotation
# given, tool and base position are a linear problem; with the tool given, the base is the rigid alignment of two sets
# of points (Arun, Huang, Blostein, IEEE PAMI 9 (1987) 698).

_ROUNDS = 12
_MOST_ROWS = 120
"""Maximum number of rows that are used; more cost time and tell no more about signs."""
_EXPLAINED = 0.02
"""Largest residual, as a share of the points' spread, under the right convention; a wrong one leaves a third."""
_COMPUTED_M = 5e-6
"""Largest residual of points that a controller computed; real arms miss their published geometry by tenths of a mm."""
COMPUTED = (
    "computed, not measured, as no real arm is that exact: are these the controller's own positions? Give those of the"
    " tracker"
)
_ALIKE = 1.2
"""Ratio of residuals up to which conventions are equal: the last joint's sign may not matter. The simplest is named."""
_WORSE = 1.05
"""Ratio of residuals from which a factory calibration explains the readings worse: an arm's own does it better."""
_FEWEST_ROWS = 10
"""Least number of readings that judge a factory calibration: base and tool alone follow fewer."""
_CLEARER = 0.3
"""Share of the present residuals that another convention must stay below to be named."""


@dataclass(frozen=True)
class Explained:
    """Rms residual [m] of the published geometry with the best base and tool, and the spread of the points [m]."""

    rms_m: float
    spread_m: float

    @property
    def computed(self) -> bool:
        """Whether it explains them better than any real arm: the points are computed with this geometry."""
        return self.rms_m <= _COMPUTED_M

    @property
    def holds(self) -> bool:
        """Whether the geometry, with this joint convention, explains the readings."""
        return self.rms_m <= _EXPLAINED * self.spread_m


def explained(nominal: Geometry, q: Array, p_M: Array) -> Explained:
    """Compute how well a chain with free base and tool explains points ``p_M`` (n, 3) [m] at ``q`` (n, N) [rad]."""
    q, p_M = _some(q), _some(p_M)
    rotations, origins = flange_poses(nominal, q)
    spread = rms_length(p_M - p_M.mean(axis=0))
    tool = np.zeros(3)
    rest = np.empty_like(p_M)
    for _ in range(_ROUNDS):
        R_M_B = register(p_M, origins + rotations @ tool)[:3, :3]
        rotated = R_M_B @ rotations
        columns = np.concatenate([rotated, np.broadcast_to(np.eye(3), rotated.shape)], axis=2).reshape(-1, 6)
        wanted = (p_M - origins @ R_M_B.T).reshape(-1)
        solution = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        tool, rest = solution[:3], (wanted - columns @ solution).reshape(-1, 3)
    return Explained(rms_length(rest), spread)


def better_reading(nominal: Geometry, q: Array, p_M: Array) -> tuple[str, Explained] | None:
    """Find another joint convention that explains the points, in words; None if none is clearly better.

    Try the signs of all joints, and a third joint that the controller counts from the horizontal.
    """
    now = explained(nominal, q, p_M).rms_m
    tried = [(words, explained(nominal, other, _some(p_M))) for words, other in _readings(_some(q))]
    best = min(one.rms_m for _, one in tried)
    simplest = next(one for one in tried if one[1].rms_m <= _ALIKE * best)
    return simplest if simplest[1].holds and simplest[1].rms_m < _CLEARER * now else None


def wrong_factory(arm: Arm, readings: Readings) -> str:
    """Say that the factory calibration of an arm explains its readings worse than the published rows; else empty."""
    if arm.factory is None or readings.station is not None or len(readings) < _FEWEST_ROWS:
        return ""
    published = nominal_geometry(published_rows(arm), np.zeros(3))
    own, plain = (explained(one, readings.q, readings.p_M).rms_m for one in (nominal_arm(arm), published))
    if own <= _WORSE * plain:
        return ""
    return (
        f"the calibration in factory explains the points worse ({1e3 * own:.2f} mm rms) than the published table"
        f" ({1e3 * plain:.2f} mm): it seems to be that of another arm"
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _some(rows: Array) -> Array:
    """Return evenly spread rows, at most ``_MOST_ROWS``."""
    return rows[:: max(1, -(-len(rows) // _MOST_ROWS))]


def _readings(q: Array) -> Iterator[tuple[str, Array]]:
    joints = q.shape[1]
    if joints > 2:
        for sign, words in ((1.0, "+"), (-1.0, "-")):
            coupled = q.copy()
            coupled[:, 2] += sign * q[:, 1]
            yield f"q3 {words} q2 in place of q3", coupled
    for count in range(1, joints + 1):
        for flipped in itertools.combinations(range(joints), count):
            signs = np.ones(joints)
            signs[list(flipped)] = -1.0
            yield f"{', '.join(f'q{one + 1}' for one in flipped)} with the opposite sign", q * signs
