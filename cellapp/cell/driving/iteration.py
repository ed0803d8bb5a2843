"""Correcting a command by measuring: the next command from the measured error, and when to stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.driving.verification import Rest, distance_error_m, rms_error_m
from cellapp.cell.targets.invert import invert_model
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

FARTHEST_M = 0.01
"""Largest distance of a corrected command from the model's own: an uncalibrated arm does better."""
_FARTHEST_RAD = 0.1
"""Largest change of a joint: beyond it the command would be on another branch, or the arm next to a singularity."""
_POSE = 6
"""Coordinates of a pose: an arm of fewer joints cannot keep its rotation where the position changes."""
REPEATS = 3
"""Fresh measurements of a target before a correction and after one: the one that raised the doubt does not count, as it
was looked at because it was large."""
_NOISE_95 = 7.815
"""95 % point of the chi-squared distribution with three degrees of freedom: what exceeds it is measured again."""
_NOISE_99 = 11.345
"""99 % point: beyond it the mean of fresh measurements is corrected."""
_NORMAL_95 = 1.960
"""95 % of normal errors are within this many standard deviations."""
_NORMAL_99 = 2.576
"""The same for 99 %."""
_ONE_SIDED_95 = 1.645
"""95 % of normal errors are below this many standard deviations."""
_FINEST_M = 1e-6
"""Least standard deviation of a coordinate: no arm positions more finely, and a covariance of zero stays regular."""


class CorrectionRefused(InputError):
    """A correction that would be wrong; nothing has moved."""


def corrected_command(arm: ArmModel, q: Array, error_M: Array, first_q: Array) -> Array:
    """Command (N,) [rad] that moves the SMR by ``-error_M`` (3,) [m] from where it is with the command ``q`` (N,).

    The calibrated model is inverted at the aim shifted by the error, in the same branch and with the same rotation of
    the flange; an arm that cannot keep it, as one of five joints, moves its joints as little as possible. ``first_q``
    (N,) is the command of the model alone.

    Raises
    ------
    CorrectionRefused
        If the model does not reach the shifted aim, or the command leads too far from the model's own.
    """
    rotation_M, _ = arm.flange(q[None])
    aim_M = arm.predict(q[None]) - error_M
    corrected, reached = invert_model(arm, aim_M, rotation_M, q[None])
    if not reached[0] and arm.geometry.joints < _POSE:
        corrected, reached = invert_model(arm, aim_M, np.full((1, 3, 3), np.nan), q[None])
    if not reached[0]:
        raise CorrectionRefused("correction refused: the calibrated model does not reach the corrected position")
    far_m = float(np.linalg.norm(np.diff(arm.predict(np.stack([first_q, corrected[0]])), axis=0)))
    far_rad = float(np.abs(corrected[0] - first_q).max())
    if not (far_m <= FARTHEST_M and far_rad <= _FARTHEST_RAD):
        raise CorrectionRefused(
            f"correction refused: it leads {far_m * 1e3:.1f} mm and {np.degrees(far_rad):.1f} deg from the model's"
            f" command, at most {FARTHEST_M * 1e3:.0f} mm and {np.degrees(_FARTHEST_RAD):.1f} deg are allowed; look at"
            " the SMR, its mount and the tracker"
        )
    return np.asarray(corrected[0])


def not_explained(rest: Rest, before_M: Mapping[str, Array]) -> list[str]:
    """The arms to correct: those whose error noise does not explain; both where only their distance shows an error.

    ``before_M`` has the covariance (3, 3) [m^2] of the measurement from which an arm's command was corrected.
    """
    noise_M = {name: one.noise_M + before_M.get(name, 0.0) for name, one in rest.items()}
    names = [name for name, one in rest.items() if not explained_by_noise(one.error_M, noise_M[name])]
    if names or len(rest) != 2:
        return names
    first, second = rest.values()
    line_M = second.wanted_M - first.wanted_M
    off_m = distance_error_m(first, second)
    return [] if distance_explained_by_noise(off_m, line_M, sum(noise_M.values(), np.zeros((3, 3)))) else list(rest)


def significant(rest: Rest, names: Sequence[str]) -> list[str]:
    """The arms among ``names`` whose error is significant at the 1 % level; else both, if that of their distance is.

    ``rest`` has the means of fresh measurements.
    """
    own = [name for name in names if not explained_by_noise(rest[name].error_M, rest[name].noise_M, _NOISE_99)]
    if own or len(rest) != 2:
        return own
    first, second = rest.values()
    line_M, noise_M = second.wanted_M - first.wanted_M, first.noise_M + second.noise_M
    clear = not distance_explained_by_noise(distance_error_m(first, second), line_M, noise_M, _NORMAL_99)
    return list(names) if clear else []


def is_better(now: Rest, before: Rest) -> bool:
    """Whether a correction made the error smaller than before, by more than noise explains (95 %)."""
    noise_M = [one.noise_M for rest in (now, before) for one in rest.values()]
    sigma_m = float(np.sqrt(sum(np.linalg.eigvalsh(one)[-1] for one in noise_M) / len(now)))
    return rms_error_m(before) - rms_error_m(now) > _ONE_SIDED_95 * sigma_m


def explained_by_noise(error_M: Array, covariance_M: Array, limit: float = _NOISE_95) -> bool:
    """Whether ``error_M`` (3,) [m] lies within the region of 95 % of the noise, or of another chi-squared ``limit``.

    ``covariance_M`` (3, 3) [m^2] is that of the error: tracker and repeatability of this measurement and, after a
    correction, of the one that it was made from. The squared Mahalanobis length of a normal vector in three dimensions
    is chi-squared with three degrees of freedom.
    """
    covariance = covariance_M + _FINEST_M**2 * np.eye(3)
    return bool(error_M @ np.linalg.solve(covariance, error_M) <= limit)


def distance_explained_by_noise(error_m: float, line_M: Array, covariance_M: Array, limit: float = _NORMAL_95) -> bool:
    """Whether noise explains the error of the distance of two SMRs: ``line_M`` (3,) leads from one to the other.

    ``covariance_M`` (3, 3) [m^2] is that of the vector between them.
    """
    along = line_M / np.linalg.norm(line_M)
    sigma_m = np.sqrt(along @ covariance_M @ along + _FINEST_M**2)
    return bool(abs(error_m) <= limit * sigma_m)
