"""What a laser tracker misreads."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import PLAIN, EffectColumn, EffectContext, Law, shift_column

_ORDERS = (1, 2)


class TrackerScale:
    """All distances read too long or too short: ``dP = k u``, k in m/m, u from the tracker to the SMR.

    Refractive index: 1 ppm/K and 0.27 ppm/hPa of opposite signs (published); 1 to 10 ppm of 3 m are 3 to 30 um. It is
    exactly the same as all lengths of the arm being out by one factor, so that one arm alone cannot show it: a scale
    bar in view can. Visible only where lengths of the arm are held by a prior.
    """

    slug = "tracker_scale"
    title = "scale of the tracker"
    look_alikes: tuple[str, ...] = ("thermal_growth", "tracker_distance_offset")
    variables = frozenset({"beam"})

    def untestable(self, context: EffectContext) -> str:
        """The beam is always known."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """One."""
        return [PLAIN]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column."""
        return [shift_column("scale", "m/m", "tracker", context.p_M, -1e-4, 1e-4)]


class TrackerDistanceOffset:
    """All distances read too long by the same: ``dP = k u / rho``, k in m.

    Home distance or the absolute distance meter's zero: permissible errors are 5 and 10 um for a tracker of this class
    (maker's manual). Only 12 % is visible, the rest is a shift of the base: short and long distances, or the target
    between two stations, show it. Look-alikes: errors of the tracker's angles (0.9).
    """

    slug = "tracker_distance_offset"
    title = "zero of the tracker's distance"
    look_alikes: tuple[str, ...] = ("tracker_angle_error", "pedestal_compliance", "target_incidence")
    variables = frozenset({"beam"})

    def untestable(self, context: EffectContext) -> str:
        """The beam is always known."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """One."""
        return [PLAIN]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column."""
        return [shift_column("distance_offset", "m", "tracker", context.beam[1], -1e-3, 1e-3)]


class TrackerAngleError:
    """The tracker's angles err with one and two cycles a turn: ``d_az = sum_n a_n cos n az + b_n sin n az``, so for el.

    Eccentricity and runout of the graduated circles; amplitudes in rad. Across the beam, azimuth moves the point by
    ``rho cos el d_az``, elevation by ``rho d_el``. Even orders survive two-face averaging (published). Size: half of
    the permissible 15 um + 6 um/m is typical (maker's manual). 23 % is visible from one station. Look-alikes: the zero
    of the distance, joint compliance; a second station, or both faces, tell them apart.
    """

    slug = "tracker_angle_error"
    title = "errors of the tracker's angles"
    look_alikes: tuple[str, ...] = ("tracker_distance_offset", "pedestal_compliance", "joint_compliance")
    variables = frozenset({"beam"})

    def untestable(self, context: EffectContext) -> str:
        """The beam is always known."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """First and second order."""
        return [Law("orders")]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each order of each angle, a block an order."""
        distance, _ = context.beam
        azimuth, elevation, horizontal, upward = context.across
        angles = (
            ("azimuth", azimuth, (distance * np.cos(elevation))[:, None] * horizontal),
            ("elevation", elevation, distance[:, None] * upward),
        )
        return [
            shift_column(
                f"{name}_{letter}{n}",
                "rad",
                "tracker",
                wave(n * angle)[:, None] * across,
                -5e-4,
                5e-4,
                f"{name} {n}",
            )
            for name, angle, across in angles
            for n in _ORDERS
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]
