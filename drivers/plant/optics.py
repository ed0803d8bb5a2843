"""Field of view and noise of the tracker, in its frame M: z up, origin at the intersection of its axes."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array, TrackerConfig


def deviations(tracker: TrackerConfig, distance: Array, averaging_s: float) -> tuple[Array, Array]:
    """Return the standard deviations across and along the beam (n,) [m] at ``distance`` (n,) [m].

    Half of the maximum permissible error at the configured averaging time; noise falls with the root of that time.
    """
    factor = 0.5 * np.sqrt(tracker.averaging_s / averaging_s)
    across = factor * (tracker.transverse[0] + tracker.transverse[1] * distance)
    along = factor * (tracker.range[0] + tracker.range[1] * distance)
    return across, along


def covariances(tracker: TrackerConfig, p_M: Array, averaging_s: float) -> Array:
    """Return the covariance (n, 3, 3) [m^2] of measured points ``p_M`` (n, 3); isotropic across the beam."""
    distance = np.linalg.norm(p_M, axis=1)
    across, along = deviations(tracker, distance, averaging_s)
    beam = p_M / distance[:, None]
    dyads = beam[:, :, None] * beam[:, None, :]
    covariance: Array = across[:, None, None] ** 2 * (np.eye(3) - dyads) + along[:, None, None] ** 2 * dyads
    return covariance


def noise(tracker: TrackerConfig, p_M: Array, averaging_s: float, rng: np.random.Generator) -> Array:
    """Sample random errors (n, 3) [m] of measured points with the covariance of ``covariances``."""
    distance = np.linalg.norm(p_M, axis=1)
    across, along = deviations(tracker, distance, averaging_s)
    beam = p_M / distance[:, None]
    sample = rng.standard_normal(p_M.shape)
    share = (sample * beam).sum(axis=1)
    errors: Array = across[:, None] * sample + ((along - across) * share)[:, None] * beam
    return errors


def why_hidden(tracker: TrackerConfig, p_M: Array, normal_M: Array, acceptance: float) -> str:
    """Return why an SMR at ``p_M`` (3,) with viewing direction ``normal_M`` (3,) returns no beam; empty if it does."""
    x, y, z = (float(v) for v in p_M)
    flat = np.hypot(x, y)
    distance = float(np.hypot(flat, z))
    if not tracker.distance[0] <= distance <= tracker.distance[1]:
        low, high = tracker.distance
        return f"it is {distance:.3f} m away; the tracker measures from {low:g} to {high:g} m"
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, flat))
    low, high = np.degrees(tracker.azimuth)
    if (azimuth - low) % 360.0 > high - low:
        return f"its azimuth is {azimuth:.1f} deg; the tracker reaches from {low:.0f} to {high:.0f} deg"
    low, high = np.degrees(tracker.elevation)
    if not low <= elevation <= high:
        return f"its elevation is {elevation:.1f} deg; the tracker reaches from {low:.0f} to {high:.0f} deg"
    cosine = -float(normal_M @ p_M) / distance
    incidence = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    if incidence > acceptance:
        return f"it is turned {np.degrees(incidence):.1f} deg away; it accepts {np.degrees(acceptance):.1f} deg"
    return ""
