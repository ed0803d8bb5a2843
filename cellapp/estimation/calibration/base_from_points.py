"""Pose of a robot base in the tracker frame from a few points that are known in both: rigid registration.

With points p_B in the base frame and p_M in the tracker frame, minimise sum_i |p_M,i - (R p_B,i + t)|^2 over R, t
(Kabsch 1976, ``robot.kinematics.transforms.register``). The covariance of t and of a small rotation applied after R is
s^2 (J^T J)^-1 with J_i = [I, -[R p_B,i]_x], [v]_x w = v x w, and s^2 = sum of squared residuals / (3 n - 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array, apply, register, twist_columns

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
