"""Identify one arm of a profile from readings in sockets, and write the notes for the operator."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.estimation.calibration.arm_identification import refused_by_arm, robust_loss
from cellapp.estimation.calibration.socket_identification import (
    LIKE_THE_BASE,
    Fit,
    estimated_in_sockets,
    identify_in_sockets,
    scale_spread,
    start_in_sockets,
)
from cellapp.estimation.readings import Readings
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, invert
from cellapp.robot.model.nominal import nominal_arm, pose_matrix, prior_sigmas

_SCALE_SEEN = 0.5
"""Share of the scale's prior standard deviation below which the distances, not the priors, determine the scale."""
_SCALE_OFF = 2e-3
"""Relative error of held-out known distances from which a note says that the scale is hidden."""
_LOOSE = 2.5
"""Ratio of a point's rms residual to the median of all points from which its socket seems loose."""


def base_in_profile(profile: Profile, name: str) -> Array:
    """Return ``T_M_B`` (4, 4) from the profile; the tracker frame is the cell frame if the profile states no pose."""
    base, tracker = profile.arms[name].base, profile.tracker.pose
    T_C_B = np.eye(4) if base is None else pose_matrix(base)
    return T_C_B if tracker is None else np.asarray(invert(pose_matrix(tracker)) @ T_C_B)


def fit_arm(profile: Profile, name: str, learn: Readings, *, robust: bool) -> tuple[Geometry, Fit, dict[str, float]]:
    """Identify an arm from readings in sockets; return the start geometry, the fit and the priors [m, rad].

    Raises
    ------
    InputError
        If there are too few readings, or the set of parameters is not for this arm.
    """
    arm, settings = profile.arms[name], profile.calibration
    published = nominal_arm(arm).with_T_M_B(base_in_profile(profile, name))
    nominal = start_in_sockets(published, learn, tool_unknown=arm.smr.offset == "unknown")
    with refused_by_arm(name):
        parameters, priors = estimated_in_sockets(
            settings.parameter_set, nominal, prior_sigmas(nominal, settings.priors)
        )
        fit = identify_in_sockets(
            nominal,
            learn,
            parameters,
            priors,
            robust=robust_loss(settings, robust=robust),
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )
    return nominal, fit, priors


def socket_notes(
    name: str, readings: Readings, fit: Fit, prior_sigma: Mapping[str, float], nominal: Geometry
) -> tuple[str, ...]:
    """Return notes on what sockets cannot show, how well the scale is known, and which sockets seem loose."""
    notes = [
        f"arm '{name}': sockets do not show where the base stands: it is where the profile puts it, and"
        f" {' and '.join(LIKE_THE_BASE)}, which act like it, are nominal",
        f"arm '{name}': the ball's centre scatters by {fit.noise_m * 1e3:.3f} mm in each coordinate",
        _scale_words(name, fit, prior_sigma, nominal),
    ]
    return (*notes, *_loose_sockets(name, fit))


def gauge_note(name: str, held_out: Readings, mean_mm: float) -> list[str]:
    """Warn if held-out known distances are off by more than ``_SCALE_OFF``."""
    known = Contacts.of(held_out).distance_m
    share = mean_mm * 1e-3 / float(known.mean())
    if share < _SCALE_OFF:
        return []
    return [
        f"arm '{name}': {len(known)} known distance{'s' if len(known) > 1 else ''} at held-out points"
        f" {'are' if len(known) > 1 else 'is'} off by {mean_mm:.3f} mm ({share * 100.0:.2f} %): errors of the arm from"
        " place to place hide the scale beyond that; measure longer known distances"
    ]


def _scale_words(name: str, fit: Fit, prior_sigma: Mapping[str, float], nominal: Geometry) -> str:
    """Say whether known distances determine the scale, and with which relative uncertainty."""
    spread, of_priors = scale_spread(fit, prior_sigma, nominal)
    count = len(fit.points.contacts.pairs)
    if not count and math.isinf(of_priors):
        return f"arm '{name}': the scale is not seen: no distance between sockets is known, and lengths have no priors"
    if not count or spread > _SCALE_SEEN * of_priors:
        reason = "no distance between sockets is known" if not count else "the known distances are too short"
        return (
            f"arm '{name}': the scale is not seen ({reason}): all lengths share a relative uncertainty of"
            f" {spread * 100.0:.2f} %, from the priors of the profile; measure a longer known distance"
        )
    return (
        f"arm '{name}': {count} known distance{'s fix' if count > 1 else ' fixes'} the scale to {spread * 100.0:.2f} %;"
        " longer ones would fix it better"
    )


def _loose_sockets(name: str, fit: Fit) -> list[str]:
    """Warn of points whose readings scatter far more than the others."""
    contacts: Contacts = fit.points.contacts
    squares = np.sum(fit.identification.residuals**2, axis=1)
    rms = np.sqrt(np.bincount(contacts.index, squares) / np.bincount(contacts.index))
    typical = float(np.median(rms))
    loose = [
        f"'{point}' ({its * 1e3:.2f} mm)" for point, its in zip(contacts.names, rms.tolist()) if its > _LOOSE * typical
    ]
    if not loose:
        return []
    return [
        f"arm '{name}': {', '.join(loose)} scatter far more than the {typical * 1e3:.2f} mm rms of the other points:"
        " is the block fixed, and the ball seated?"
    ]
