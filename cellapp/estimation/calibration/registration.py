"""Where an arm stands and how it counts: its base from known points, and its conventions from recorded readings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm
from cellapp.robot.kinematics.chain import Geometry, flange_poses, nominal_geometry
from cellapp.robot.kinematics.transforms import Array, apply, register, twist_columns
from cellapp.robot.model.nominal import nominal_arm, published_rows

# -- Pose of a robot base in the tracker frame from a few points that are known in both: rigid registration -----------
#
# With points p_B in the base frame and p_M in the tracker frame, minimise sum_i |p_M,i - (R p_B,i + t)|^2 over R, t
# (Kabsch 1976, ``robot.kinematics.transforms.register``). The covariance of t and of a small rotation applied after R
# is s^2 (J^T J)^-1 with J_i = [I, -[R p_B,i]_x], [v]_x w = v x w, and s^2 = sum of squared residuals / (3 n - 6).

FEWEST_POINTS = 3
_LEAST_SPREAD_M = 0.05
"""Least rms distance of the points from their centre: closer ones turn a millimetre of error into over a degree."""
_LEAST_WIDTH = 0.05
"""Least ratio of the points' rms distance from their best line to that from their centre: below it, the angle about the
line is 20 times less certain than the others."""
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
    _check_layout(p_B, p_M)
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


def _check_layout(p_B: Array, p_M: Array) -> None:
    n = len(p_B)
    if n < FEWEST_POINTS:
        raise InputError(f"{n} points do not fix a base; measure at least {FEWEST_POINTS}, better four, far apart")
    for points, frame in ((p_B, "base"), (p_M, "tracker")):
        scales = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        spread = math.hypot(*scales.tolist())
        if spread < _LEAST_SPREAD_M * math.sqrt(n):
            raise InputError(
                f"the points lie within {spread / math.sqrt(n) * 1e3:.0f} mm of one place in the {frame} frame; measure"
                " points that are some 0.5 m apart"
            )
        if math.hypot(*scales[1:].tolist()) < _LEAST_WIDTH * spread:
            raise InputError(
                f"the points lie on one line in the {frame} frame: nothing fixes the turn about it; add a point beside"
                " the line"
            )


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
    spread = float(np.sqrt(np.mean(np.sum((p_M - p_M.mean(axis=0)) ** 2, axis=1))))
    tool = np.zeros(3)
    rest = np.empty_like(p_M)
    for _ in range(_ROUNDS):
        R_M_B = register(p_M, origins + rotations @ tool)[:3, :3]
        turned = R_M_B @ rotations
        columns = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2).reshape(-1, 6)
        wanted = (p_M - origins @ R_M_B.T).reshape(-1)
        solution = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        tool, rest = solution[:3], (wanted - columns @ solution).reshape(-1, 3)
    return Explained(float(np.sqrt(np.mean(np.sum(rest**2, axis=1)))), spread)


def better_reading(nominal: Geometry, q: Array, p_M: Array) -> tuple[str, Explained] | None:
    """Find another joint convention that explains the points, in words; None if none is clearly better.

    Try the signs of all joints, and a third joint that the controller counts from the horizontal.
    """
    now = explained(nominal, q, p_M).rms_m
    tried = [(words, explained(nominal, other, _some(p_M))) for words, other in _readings(_some(q))]
    best = min(one.rms_m for _, one in tried)
    simplest = next(one for one in tried if one[1].rms_m <= _ALIKE * best)
    return simplest if simplest[1].holds and simplest[1].rms_m < _CLEARER * now else None


def factory_doubt(arm: Arm, readings: Readings) -> str:
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
        for turned in itertools.combinations(range(joints), count):
            signs = np.ones(joints)
            signs[list(turned)] = -1.0
            yield f"{', '.join(f'q{one + 1}' for one in turned)} with the opposite sign", q * signs
