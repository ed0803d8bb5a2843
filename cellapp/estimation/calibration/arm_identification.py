"""Identification of an arm with weights that include unmodelled physics, and without a mirrored SMR offset."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from cellapp.estimation.calibration.identification import Identification, TooFewReadings, identify
from cellapp.estimation.calibration.parameters import ParameterSet, SetName
from cellapp.estimation.calibration.quantities import with_probe
from cellapp.estimation.calibration.weights import RobustName, excess_of_kinds, with_excess
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile.schema import Calibration
from cellapp.robot.kinematics.chain import TOOL_NAMES, Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, register, rotation_x

_EXCESS_ROUNDS = 6
"""Maximum rounds of identification and excess variance; the variance settles to a percent in two or three."""
_EXCESS_SETTLED = 0.01
"""Relative change of the excess variance at which the rounds end: weights then change by less than 1 %."""
_WRIST_ERRORS = 20.0
"""Distance of the SMR's mirror image along the last axis, in standard errors, up to which it is tried. It is a second
minimum only within some 10, and the linear standard error understates the width of such a valley."""


@contextmanager
def refused_by_arm(name: str) -> Iterator[None]:
    """Name the arm of the profile in errors of an identification: an ``InputError``, or that it did not converge."""
    try:
        yield
    except TooFewReadings as error:
        raise InputError(f"arm '{name}': {error}") from None
    except NotConverged as error:
        raise NotConverged(f"arm '{name}': {error}") from None
    except ValueError as error:
        raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None


def robust_loss(settings: Calibration, *, robust: bool) -> RobustName:
    """Return the robust loss of the profile; Tukey's if it has none and ``robust`` asks for one."""
    return "tukey" if robust and settings.robust == "none" else settings.robust


class _Fit(Protocol):
    def __call__(
        self, start: Geometry, *, sigma: Array | None, parameter_set: SetName | ParameterSet
    ) -> Identification: ...


def identify_with_excess(
    start: Geometry,
    q: Array,
    p_M: Array,
    *,
    sigma: Array | None,
    R_M_S: Array | None = None,
    parameter_set: SetName | ParameterSet = "auto",
    prior_sigma: Mapping[str, float] | None = None,
    robust: RobustName = "none",
    tolerance: float = 1e-8,
    max_iterations: int = 50,
) -> tuple[Identification, float]:
    """Identify one arm with weights that include the scatter beyond the stated uncertainty.

    Unmodelled physics leaves residuals far above the uncertainty of the tracker. Weights from that uncertainty alone
    would let the few readings with the smallest one dominate. The first round weighs all readings alike. The excess
    variance is then estimated from the residuals and added to the stated one, and the identification is repeated until
    it settles. Arguments are those of ``identify``; the mean of the priors is ``start``.

    If the last axis hardly turns in space, the SMR's position along it is known through small angles only. Its
    mirror image about the wrist, with the opposite angles, fits nearly as well and is a second minimum. Both are
    tried, and the better one is returned.

    Returns
    -------
    identification : Identification
        With the iterations and steps of all rounds.
        ``excess_rad`` is the excess standard deviation of an orientation.
    excess : float
        Excess standard deviation of a coordinate [m].

    Raises
    ------
    NotConverged
        If the last identification, of the better one, did not converge.
    """
    fit: _Fit = partial(
        identify,
        q=q,
        p_M=p_M,
        R_M_S=R_M_S,
        prior_sigma=prior_sigma,
        prior_mean=start,
        robust=robust,
        tolerance=tolerance,
        max_iterations=max_iterations,
    )
    found, excess = _rounds(fit, start, sigma, parameter_set)
    tool = _mirrored_tool(found)
    if tool is None:
        return found.settled("identification"), excess
    at_origin = replace(start, tool=tool).with_T_M_B(np.eye(4))
    points = slice(None) if found.turned is None else ~found.turned
    mirrored = at_origin.with_T_M_B(register(p_M[points], smr_positions(at_origin, q[points])))
    if R_M_S is not None:
        mirrored = with_probe(mirrored, q, R_M_S)
    other, its_excess = _rounds(fit, mirrored, sigma, parameter_set)
    better = (other, its_excess) if _square(other) < _square(found) else (found, excess)
    return better[0].settled("identification"), better[1]


def _rounds(
    fit: _Fit, start: Geometry, sigma: Array | None, parameter_set: SetName | ParameterSet
) -> tuple[Identification, float]:
    """Iterate identification and excess variance from one start; return the identification and excess scatter [m]."""
    found = fit(start, sigma=None, parameter_set=parameter_set)
    if sigma is None:
        return found, 0.0
    excess = (math.inf, math.inf)
    for _ in range(_EXCESS_ROUNDS):
        before, excess = excess, excess_of(found, sigma)
        if all(abs(now - then) <= _EXCESS_SETTLED * now for now, then in zip(excess, before, strict=True)):
            break
        earlier, weighed = found, with_excess(sigma, excess[0], found.turned, excess[1])
        found = fit(earlier.geometry, sigma=weighed, parameter_set=parameter_set)
        found = replace(found, iterations=earlier.iterations + found.iterations, steps=(*earlier.steps, *found.steps))
    return replace(found, excess_rad=math.sqrt(excess[1])), math.sqrt(excess[0])


def excess_of(found: Identification, sigma: Array) -> tuple[float, float]:
    """Estimate the variances of positions [m^2] and of orientations [rad^2] beyond the stated uncertainty ``sigma``."""
    return excess_of_kinds(found.residuals, sigma, found.degrees_of_freedom, found.turned, found.freedom_of_turns)


def _mirrored_tool(found: Identification) -> Array | None:
    """Mirror the SMR (3,) [m] along the last axis about the origin of the frame before; None if that is too far."""
    places = [found.estimated.names.index(name) for name in TOOL_NAMES if name in found.estimated.names]
    if len(places) < len(TOOL_NAMES):
        return None
    _, d, a, alpha, _ = found.geometry.rows[-1].tolist()
    to_last = rotation_x(alpha).T
    axis, wrist = to_last[:, 2], -to_last @ np.array([a, 0.0, d])
    tool = found.geometry.tool
    shift = 2.0 * float((tool - wrist) @ axis)
    variance = float(axis @ found.estimated_covariance[np.ix_(places, places)] @ axis)
    return tool - shift * axis if abs(shift) < _WRIST_ERRORS * math.sqrt(variance) else None


def _square(found: Identification) -> float:
    """Compute the weighted sum of squared residuals [m^2]."""
    return float(found.weights @ np.sum(found.residuals**2, axis=1))
