"""Linear model of some stops of a cell about its calibration.

Let y be the measured minus the expected coordinates of all arms, in the order of the stops:

    y = V b + e,    e ~ N(0, K),    K = X S X^T + R (+ T P T^T)

Expected is the model's prediction and, at a stop of the calibration, a share of its residual there, which no model
explains but which comes again. S is the posterior covariance of all parameters of the calibration, common to all stops,
X their effects, less that share; R the covariance of tracker and repeatability, independent between stops. V are the
effects of changes on y, b their sizes in units of the smallest change to be detected. T are the six motions of a
tracker that was located since, P their covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.calibration.quantities import Quantities, conditions_of_arms
from cellapp.estimation.discovery.prior_fit import design, term_columns
from cellapp.estimation.monitoring.belief import (
    LENGTH_M,
    ROTATION_RAD,
    ArmBelief,
    ChangeKind,
    CheckBelief,
    measured_vectors,
    noise_covariance,
)
from cellapp.estimation.monitoring.records import TRACKER
from cellapp.estimation.prior.belief import is_own, is_smooth
from cellapp.estimation.prior.update import change_names
from cellapp.estimation.readings import Readings
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import all_names, parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array, twist_columns

# -- Changes that a check looks for: of single parameters, of effects, and rigid motions of tracker, bases and SMRs ---

GROWTH = "growth of all links, as by temperature"
_FEWEST_LENGTHS = 2
"""Fewest lengths with which growth of all of them differs from the change of one."""
_TWIST_WORDS = ("along x", "along y", "along z", "about x", "about y", "about z")


@dataclass(frozen=True, eq=False)
class Changing:
    """One quantity that may change, and the size of the change that has to be detected.

    ``places`` are indices of the arm's parameters, or of the six components of the tracker's twist, each of which
    changes by its share; ``step`` is the size in ``unit``.
    """

    arm: str
    kind: ChangeKind
    what: str
    places: tuple[int, ...]
    step: float
    unit: str
    shares: tuple[float, ...] = (1.0,)

    def row_of(self, rows: Array) -> Array:
        """Compute the motion by one step from the motions (p, ...) by a unit of each parameter."""
        return np.asarray(self.step * np.tensordot(np.array(self.shares), rows[list(self.places)], axes=1))


@dataclass(frozen=True, eq=False)
class Alternative:
    """A nameable change: directions that change together, as indices into the list of directions."""

    arm: str
    kind: ChangeKind
    what: str
    members: tuple[int, ...]


def directions_of(belief: CheckBelief) -> list[Changing]:
    """List all directions of change of a cell: the tracker's twist, then those of every arm, parameter by parameter.

    The tracker rotates about the centre of the calibration's points.
    """
    found = [
        Changing(
            TRACKER, "tracker", f"tracker {words}", (k,), LENGTH_M if k < 3 else ROTATION_RAD, "m" if k < 3 else "rad"
        )
        for k, words in enumerate(_TWIST_WORDS)
    ]
    for name, arm in belief.arms.items():
        found += _of_arm(name, arm)
    return found


def alternatives_of(directions: Sequence[Changing]) -> list[Alternative]:
    """List what may have changed, causes that affect most points first: tracker, bases, SMRs, parameters, effects.

    Each parameter is an alternative; so are all values of an effect at one place together.
    """
    rigid, order = {"tracker": "tracker", "base": "base", "smr": "SMR"}, get_args(ChangeKind)
    places = grouped(((one.arm, one.kind, rigid.get(one.kind, one.what)), k) for k, one in enumerate(directions))
    found = [Alternative(*key, tuple(members)) for key, members in places.items()]
    return sorted(found, key=lambda one: order.index(one.kind))


def centre_of(belief: CheckBelief) -> Array:
    """Return the centre (3,) of the points of the calibration [m]."""
    return np.asarray(np.concatenate([arm.positions.readings.p_M for arm in belief.arms.values()]).mean(axis=0))


def _of_arm(name: str, arm: ArmBelief) -> list[Changing]:
    """List geometric parameters, growth, and values of laws, a step of which moves the SMR by 0.05 mm rms over the
    readings of the calibration.

    If orientation is measured, motion and rotation count together, with 50 µrad equal to 0.05 mm.

    Values of free functions are left out (many, and small by their priors), and values whose step is physically
    impossible: a joint without load shows no stiffness.
    """
    joints, columns = arm.model.geometry.joints, term_columns(arm.model, arm.measured)
    names, words = all_names(joints), change_names(joints, arm.columns, arm.model.effects, columns)
    every, found = design(arm.model, arm.measured, arm.columns), []
    for place, column in enumerate(arm.columns):
        kind: ChangeKind = "parameter" if is_own(column, joints) else ("base" if column < 6 else "smr")
        what = words[place] if kind == "parameter" else f"{kind} {names[column]}"
        unit = parameter_unit(names[column])
        found.append(Changing(name, kind, what, (place,), LENGTH_M if unit == "m" else ROTATION_RAD, unit))
    found += _growth(name, arm, every)
    rms = np.sqrt(np.sum(every**2, axis=1) / len(arm.positions))
    terms = [(term, value) for term in arm.model.effects for value in range(len(term.names))]
    for place, ((term, value), own) in enumerate(zip(terms, columns, strict=True), len(arm.columns)):
        if not is_smooth(term) and value < len(term.law_names) and rms[place] * own.upper > LENGTH_M:
            step = LENGTH_M / float(rms[place])
            found.append(Changing(name, "effect", words[place], (place,), step, term.units[value]))
    return found


def _growth(name: str, arm: ArmBelief, rows: Array) -> list[Changing]:
    """Build the direction of proportional growth of all link lengths (temperature) from motions ``rows`` (p, d)."""
    nominal, names = arm.model.nominal.vector(), parameter_names(arm.model.geometry.joints)
    places = [
        place
        for place, column in enumerate(arm.columns)
        if is_own(column, arm.model.geometry.joints) and parameter_unit(names[column]) == "m" and nominal[column]
    ]
    if len(places) < _FEWEST_LENGTHS:
        return []
    shares = nominal[[arm.columns[place] for place in places]]
    rms = math.sqrt(float(np.sum((shares @ rows[places]) ** 2)) / len(arm.positions))
    return [Changing(name, "effect", GROWTH, tuple(places), LENGTH_M / rms, "m/m", tuple(shares.tolist()))]


_SAME_STOP_RAD = 0.01
"""Distance in joint space within which a stop is one of the calibration."""
_SIDE_RAD = 1e-3
"""Distance that a side of approach counts."""
_DEPENDENT = 1e-6
"""Ratio to the largest singular value below which a direction depends on the others."""


@dataclass(frozen=True, eq=False)
class StopRows:
    """Stops in the linear model: n stops, m points, d = 3 m coordinates, C directions of change.

    An orientation is a point too: its coordinates are the rotation vector [rad] from the expected to the measured one.

    Attributes
    ----------
    measured, expected : array, shape (m, 3)
        Positions [m], stop by stop, arm by arm; for an orientation that rotation vector, and zero.
    stop_ends : array, shape (n,)
        Number of coordinates up to and including each stop.
    arm_of : array, shape (m,)
        Index of each point's arm among those of the belief.
    rows : array, shape (C, d)
        Motion of the coordinates by one step of each direction [m].
    factor : array, shape (d, d)
        Lower Cholesky factor of K [m].
    points : array, shape (m,)
        Mask of points that are positions.
    """

    measured: Array
    expected: Array
    stop_ends: NDArray[np.intp]
    arm_of: NDArray[np.intp]
    rows: Array
    factor: Array
    points: NDArray[np.bool_]

    @property
    def residuals(self) -> Array:
        """Residuals (m, 3) [m]: measured minus expected."""
        return np.asarray(self.measured - self.expected)


def conditions_now(belief: CheckBelief, readings: Mapping[str, Readings]) -> dict[str, MeasurementConditions]:
    """Return conditions of stops outside the calibration's run: without its clock, so that time means "now"."""
    found = conditions_of_arms(belief.models, readings)
    return {name: replace(own, time_s=None, order=None, record=None) for name, own in found.items()}


def _remembered(arm: ArmBelief, its: Quantities) -> tuple[Array, Array]:
    """Return the calibration's residuals (n, 3) at the same stops, and the shares (n,) of them that are expected."""
    residuals, again = np.zeros((len(its), 3)), np.zeros(len(its))
    known = arm.measured
    for (asked, scatter), (kind, _) in zip(arm.kinds(its), arm.kinds(known), strict=False):
        distance, nearest = scipy.spatial.KDTree(_sided(known, kind)).query(_sided(its, asked))
        residuals[asked] = arm.residuals[kind][nearest]
        again[asked] = np.where(distance < _SAME_STOP_RAD, scatter.again, 0.0)
    return residuals, again


def _sided(its: Quantities, rows: NDArray[np.bool_]) -> Array:
    """Return joint positions, then sides of approach as far less than a stop: of equal stops, that of this side."""
    return np.hstack([its.readings.q[rows], _SIDE_RAD * its.readings.approach[rows]])


def stop_rows(belief: CheckBelief, readings: Mapping[str, Readings], directions: Sequence[Changing]) -> StopRows:
    """Build the linear model of stops; rows of several arms with the same ``configuration`` are one stop; these
    numbers are in the order of measurement."""
    conditions = conditions_now(belief, readings)
    names = [name for name in belief.arms if name in readings]
    vectors = {name: measured_vectors(belief.arms[name], readings[name], conditions[name]) for name in names}
    arm_of = np.concatenate([np.full(len(vectors[name]), list(belief.arms).index(name)) for name in names])
    places = np.concatenate([vectors[name].readings.configuration for name in names])
    p_M = np.concatenate([its.predicted(belief.arms[name].model) for name, its in vectors.items()])
    angular = np.concatenate([~its.points for its in vectors.values()])
    total = 3 * len(places)
    station = twists(p_M - centre_of(belief), angular).reshape(total, 6).T
    rows, K, first = np.zeros((len(directions), total)), np.zeros((total, total)), 0
    for name in names:
        arm, its = belief.arms[name], vectors[name]
        here = slice(first, first + 3 * len(its))
        X = design(arm.model, its, arm.columns)
        X = X.reshape(-1, 3, len(its)).transpose(0, 2, 1).reshape(len(X), -1)
        residuals, again = _remembered(arm, its)
        p_M[here.start // 3 : here.stop // 3] += again[:, None] * residuals
        uncertain = X * np.repeat(arm.unremembered(its, again), 3)
        K[here, here] = uncertain.T @ arm.covariance @ uncertain
        if arm.day_m:
            at = slice(first // 3, here.stop // 3)
            drift = twists(p_M[at] - arm_centre(arm), angular[at]).reshape(-1, 6) * _day_sizes(arm)
            K[here, here] += drift @ drift.T
        rows[:, here] = _moved(directions, name, X, station[:, here])
        K[here, here] += scipy.linalg.block_diag(*noise_covariance(arm, its, again))
        first = here.stop
    if belief.station is not None:
        T = twists(p_M, angular).reshape(total, 6)
        K += T @ belief.station @ T.T
    order = np.argsort(places, kind="stable")
    coordinates = (3 * order[:, None] + np.arange(3)).ravel()
    measured = np.concatenate([its.readings.p_M for its in vectors.values()])
    measured[angular], p_M[angular] = -p_M[angular], 0.0
    return StopRows(
        measured=measured[order],
        expected=p_M[order],
        stop_ends=3 * (np.flatnonzero(np.diff(places[order], append=-1)) + 1).astype(np.intp),
        arm_of=arm_of[order],
        rows=rows[:, coordinates],
        factor=scipy.linalg.cholesky(K[np.ix_(coordinates, coordinates)], lower=True),
        points=~angular[order],
    )


def twists(p_M: Array, angular: NDArray[np.bool_]) -> Array:
    """Compute the motion (m, 3, 6) of positions (m, 3), or orientations where ``angular``, by a common small twist."""
    columns = twist_columns(p_M)
    columns[angular] = np.concatenate([np.zeros((3, 3)), np.eye(3)], axis=1)
    return columns


@dataclass(frozen=True, eq=False)
class Moments:
    """Whitened stops: ``white`` (d,) is L^-1 y with K = L L^T, ``directions`` (C, d) the rows V^T L^-T.

    ``fitted`` (r, d) are orthonormal directions in which the stops have no residual, because it was fitted.
    """

    white: Array
    directions: Array
    fitted: Array

    @classmethod
    def of(cls, stops: StopRows) -> Moments:
        """Whiten stops by the factor of K."""
        columns = np.column_stack([stops.residuals.ravel(), stops.rows.T])
        solved = scipy.linalg.solve_triangular(stops.factor, columns, lower=True)
        directions = np.ascontiguousarray(solved[:, 1:].T)
        return cls(solved[:, 0], directions, directions[:0])

    @property
    def information(self) -> Array:
        """Non-centrality (C,) of one step of each direction."""
        return np.asarray(np.sum(self.directions**2, axis=1))

    @property
    def moment(self) -> Array:
        """V^T K^-1 y (C,)."""
        return np.asarray(self.directions @ self.white)

    @property
    def degrees(self) -> int:
        """Degrees of freedom of chi-squared: coordinates minus fitted directions."""
        return max(len(self.white) - len(self.fitted), 0)


def spanned(rows: Array) -> Array:
    """Compute orthonormal rows of the same span; drop dependent ones."""
    if not len(rows):
        return rows
    _, values, vectors = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(vectors[values > _DEPENDENT * max(values[0], 1e-300)])


def arm_centre(arm: ArmBelief) -> Array:
    """Return the centre (3,) of the points of an arm's calibration [m]."""
    return np.asarray(arm.positions.readings.p_M.mean(axis=0))


def _day_sizes(arm: ArmBelief) -> Array:
    """Compute standard deviations (6,) [m, rad] of a base drift that moves the SMR as far as on calibration day.

    Shift and rotation contribute half of the mean square each.
    """
    p_M = arm.positions.readings.p_M - arm_centre(arm)
    by_rotation = float(np.sqrt(np.mean(np.sum(twist_columns(p_M)[:, :, 3:] ** 2, axis=(1, 2)))))
    return arm.day_m * math.sqrt(0.5) * np.repeat([1.0 / math.sqrt(3.0), 1.0 / by_rotation], 3)


# -- How far a change moves the SMR at the calibration's readings, of which its visible size follows ------------------


def motions(belief: CheckBelief, name: str, measured: Quantities, directions: Sequence[Changing]) -> Array:
    """Compute the motion (C, n, 3) [m, rad] of n measured vectors of an arm by one step of each direction."""
    arm = belief.arms[name]
    X = design(arm.model, measured, arm.columns).reshape(-1, 3, len(measured)).transpose(0, 2, 1)
    p_M = measured.predicted(arm.model)
    station = twists(p_M - centre_of(belief), ~measured.points).transpose(2, 0, 1)
    return _moved(directions, name, X, station)


def _moved(directions: Sequence[Changing], name: str, X: Array, station: Array) -> Array:
    """Compute the motion (C, ...) of an arm's coordinates by one step of each direction, from the motions by a unit of
    its parameters, ``X`` (p, ...), and of a twist of the ``station`` (6, ...)."""
    found = np.zeros((len(directions), *X.shape[1:]))
    for k, one in enumerate(directions):
        if one.arm in (name, TRACKER):
            found[k] = one.row_of(X if one.arm == name else station)
    return found


def visibility(belief: CheckBelief, directions: Sequence[Changing], moved: Mapping[str, Array]) -> tuple[Array, Array]:
    """Compute the rms motion (C,) of the SMR by one step of each direction, in [m] and in units of the noise.

    Motions are judged by the noise of a position, rotations of a probe by that of an orientation. The best-fitting
    motion of the tracker is subtracted, see ``check.belief``, except from the tracker's own directions. ``moved`` are
    the motions at the calibration's readings.
    """
    rows = np.concatenate([_as_points(arm, moved[name]) for name, arm in belief.arms.items()], axis=1)
    points = np.concatenate([np.repeat(arm.measured.points, 3) for arm in belief.arms.values()])
    own = np.array([one.arm == TRACKER for one in directions])
    basis = np.linalg.qr(rows[own].T)[0]
    unexplained = np.where(own[:, None], rows, rows - (rows @ basis) @ basis.T)
    counts = {name: len(arm.positions) for name, arm in belief.arms.items()}
    noise = {name: arm.of_points.noise for name, arm in belief.arms.items()}
    counts[TRACKER], noise[TRACKER] = sum(counts.values()), max(noise.values())
    of_arm = np.array([counts[one.arm] for one in directions])
    shown = np.sqrt(np.sum(unexplained**2, axis=1) / of_arm) / np.array([noise[one.arm] for one in directions])
    return np.sqrt(np.sum(unexplained[:, points] ** 2, axis=1) / of_arm), shown


def _as_points(arm: ArmBelief, moved: Array) -> Array:
    """Return motions (C, 3 n) [m] of an arm's vectors; rotations are scaled to equal standard deviations of a point."""
    scale = np.where(arm.measured.points, 1.0, arm.of_points.noise / max(arm.of_rotations.noise, 1e-12))
    return np.asarray((moved * scale[:, None]).reshape(len(moved), -1))
