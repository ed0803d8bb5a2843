"""Correct a command by measurement: compute the next command from the measured error, and decide when to stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.driving.verification import Rest, distance_error_m, rms_error_m
from cellapp.cell.targets.invert import invert_model
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

FARTHEST_M = 0.01
"""Largest distance [m] of a corrected command from the model's own: an uncalibrated arm has smaller errors."""
_FARTHEST_RAD = 0.1
"""Largest joint change [rad]: a larger one means another branch or a singularity nearby."""
_POSE = 6
"""Degrees of freedom of a pose: an arm with fewer joints cannot keep its rotation while its position changes."""
REPEATS = 3
"""New measurements of a target before a correction and after one. The measurement that raised the doubt does not count:
it was selected because it was large."""
_NOISE_95 = 7.815
"""95 % quantile of chi-squared with three degrees of freedom; a target above it is measured again."""
_NOISE_99 = 11.345
"""99 % quantile; if the mean of new measurements is above it, it is corrected."""
_NORMAL_95 = 1.960
"""Two-sided 95 % quantile of the normal distribution [standard deviations]."""
_NORMAL_99 = 2.576
"""Two-sided 99 % quantile."""
_ONE_SIDED_95 = 1.645
"""One-sided 95 % quantile of the normal distribution [standard deviations]."""
_FINEST_M = 1e-6
"""Least standard deviation of a coordinate [m]: no arm positions better, and it keeps a zero covariance regular."""


class CorrectionRefused(InputError):
    """A correction was refused because it would be wrong; nothing has moved."""


def corrected_command(arm: ArmModel, q: Array, error_M: Array, first_q: Array) -> Array:
    """Return the command (N,) [rad] that moves the SMR by ``-error_M`` (3,) [m] from where the command ``q`` puts it.

    Invert the calibrated model at the predicted position shifted by the error, on the same branch and with the same
    rotation of the flange. An arm that cannot keep the rotation, as one of five joints, moves its joints as little as
    possible. ``first_q`` (N,) is the command of the model without correction.

    Raises
    ------
    CorrectionRefused
        If the model does not reach the shifted position, or the command is too far from the model's own.
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
    """Return the arms to correct: those with an error that noise does not explain, or both if only the distance has.

    ``before_M`` is the covariance (3, 3) [m^2] of the measurement from which an arm's command was corrected.
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
    """Return the arms of ``names`` with an error significant at the 1 % level; ``names`` if only the distance's is.

    ``rest`` has the means of new measurements.
    """
    own = [name for name in names if not explained_by_noise(rest[name].error_M, rest[name].noise_M, _NOISE_99)]
    if own or len(rest) != 2:
        return own
    first, second = rest.values()
    line_M, noise_M = second.wanted_M - first.wanted_M, first.noise_M + second.noise_M
    clear = not distance_explained_by_noise(distance_error_m(first, second), line_M, noise_M, _NORMAL_99)
    return list(names) if clear else []


def is_better(now: Rest, before: Rest) -> bool:
    """Return whether a correction reduced the error by more than noise explains (95 %)."""
    noise_M = [one.noise_M for rest in (now, before) for one in rest.values()]
    sigma_m = float(np.sqrt(sum(np.linalg.eigvalsh(one)[-1] for one in noise_M) / len(now)))
    return rms_error_m(before) - rms_error_m(now) > _ONE_SIDED_95 * sigma_m


def explained_by_noise(error_M: Array, covariance_M: Array, limit: float = _NOISE_95) -> bool:
    """Return whether ``error_M`` (3,) [m] is within the 95 % region of the noise, or of another chi-squared ``limit``.

    ``covariance_M`` (3, 3) [m^2] is that of the error: tracker and repeatability of this measurement and, after a
    correction, of the measurement that it was computed from. The squared Mahalanobis length of a normal vector in three
    dimensions is chi-squared with three degrees of freedom.
    """
    covariance = covariance_M + _FINEST_M**2 * np.eye(3)
    return bool(error_M @ np.linalg.solve(covariance, error_M) <= limit)


def distance_explained_by_noise(error_m: float, line_M: Array, covariance_M: Array, limit: float = _NORMAL_95) -> bool:
    """Return whether noise explains the distance error of two SMRs; ``line_M`` (3,) [m] leads from one to the other.

    ``covariance_M`` (3, 3) [m^2] is that of the vector between them.
    """
    along = line_M / np.linalg.norm(line_M)
    sigma_m = np.sqrt(along @ covariance_M @ along + _FINEST_M**2)
    return bool(abs(error_m) <= limit * sigma_m)
