"""Reading errors of a laser tracker."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import Channel, EffectColumn, EffectContext, shift_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import DriverVariable, Law, LawForm
from cellapp.robot.effects.modulation import FreeDriver
from cellapp.robot.effects.thermal import MEAN_AIR, above_mean_air

_ORDERS = (1, 2)
"""Harmonics of the tracker's angles: eccentricity and ovality of its circles."""
_MOST_SCALE = 1e-4
"""Bound [m/m]: ten times the largest error of an uncorrected refractive index."""
_MOST_SCALE_PER_KELVIN = 1e-5
"""Bound [1/K]: ten times the change of the refractive index of air."""
_MOST_OFFSET = 1e-3
"""Bound [m]: a hundred times the permissible error."""
_MOST_ANGLE = 5e-4
"""Bound of each amplitude [rad]: ten times the permissible error at 3 m."""


PLAIN_SCALE = LawForm("", "in proportion to the distance", variables=frozenset({DriverVariable.BEAM}))
AIR_SCALE = LawForm("air", "in proportion to the distance and to the air temperature", (MEAN_AIR,))


class TrackerScale(Effect):
    """All distances read too long or too short: ``dP = k u``, k in m/m, u from the tracker to the SMR.

    Laws
    ----
    (no name)
        The same scale throughout the run.
    air
        ``dP = k (T - T_mean) u`` with the air temperature, k in 1/K: the index is not corrected for the air in the
        beam. Unlike the first it is visible.

    Refractive index: 1 ppm/K and 0.27 ppm/hPa of opposite signs (published); 1 to 10 ppm of 3 m are 3 to 30 µm. It is
    equivalent to a common scale error of all lengths of the arm, so that one arm alone cannot show it; a scale bar can.
    Visible only where lengths of the arm are held by a prior.
    """

    slug = "tracker_scale"
    of_reading = True
    title = "scale of the tracker"
    meaning = Meaning.of(
        """cause: The tracker's lengths are wrong by a factor: wrong air temperature, pressure or humidity, or a bad
          reference.
        size (computed): 1 ppm per K, -0.27 ppm per hPa (published): 1 to 10 ppm of 3 m are 3 to 30 µm
        check: Check the weather station against another thermometer and barometer, and that the tracker's controller
          uses it.
        check: Check the tracker on a scale bar.
        settle: Measure a calibrated scale bar or two nests of known distance: the arm alone cannot show a scale."""
    )
    look_alikes = ("thermal_growth", "tracker_distance_offset")
    variables = frozenset({DriverVariable.BEAM, DriverVariable.AIR_TEMPERATURE})
    forms = (PLAIN_SCALE, AIR_SCALE)
    free_drivers = (FreeDriver(Quantity.RANGE), FreeDriver(Quantity.TEMPERATURE))

    def laws(self, context: EffectContext) -> list[Law]:
        """The same throughout; with the air temperature where it is known."""
        air_c = context.conditions.air_c
        if air_c is None or not varies(air_c):
            return [PLAIN_SCALE.law()]
        return [PLAIN_SCALE.law(), AIR_SCALE.law({MEAN_AIR.name: float(air_c.mean())})]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column; zero, as at the run's mean, where the law needs a temperature that is unknown."""
        if law.form == AIR_SCALE:
            shift_M = context.moved(above_mean_air(context, law)[:, None] * context.p_M)
            largest = _MOST_SCALE_PER_KELVIN
            return [shift_column("scale_air", "1/K", Channel.TRACKER, shift_M, -largest, largest)]
        return [shift_column("scale", "m/m", Channel.TRACKER, context.moved(context.p_M), -_MOST_SCALE, _MOST_SCALE)]


class TrackerDistanceOffset(Effect):
    """A constant error of all distances: ``dP = k u / rho``, k in m.

    Home distance or the absolute distance meter's zero: permissible errors are 5 and 10 µm for a tracker of this class
    (maker's manual). Only 12 % is visible, the rest is a shift of the base: short and long distances, or the target
    between two stations, show it. Look-alikes: errors of the tracker's angles (0.9).
    """

    slug = "tracker_distance_offset"
    of_reading = True
    title = "zero of the tracker's distance"
    meaning = Meaning.of(
        """cause: All distances are off by one length: zero of the distance meter, wrong reflector type or home point.
        size (sourced): permissible: 5 µm for home distance, 10 µm for the meter (manual of the AT500)
        check: Check that the reflector selected in the tracker is the one on the flange.
        check: Set the distance at the home point again and run the tracker's own check of its zero.
        settle: Measure a target between two stations of the tracker, or stops near and far."""
    )
    look_alikes = ("tracker_angle_error", "pedestal_compliance", "target_incidence")
    variables = frozenset({DriverVariable.BEAM})
    forms = (LawForm("", "the same at any distance"),)
    free_drivers = (FreeDriver(Quantity.RANGE),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column."""
        along = context.moved(context.beam[1])
        return [shift_column("distance_offset", "m", Channel.TRACKER, along, -_MOST_OFFSET, _MOST_OFFSET)]


class TrackerAngleError(Effect):
    """Angles err with one and two cycles per revolution: ``d_az = sum_n a_n cos n az + b_n sin n az``, so for el.

    Eccentricity and runout of the graduated circles; amplitudes in rad. Across the beam, azimuth moves the point by
    ``rho cos el d_az``, elevation by ``rho d_el``. Even orders survive two-face averaging (published). Size: half of
    the permissible 15 µm + 6 µm/m is typical (maker's manual). 23 % is visible from one station. Look-alikes: the zero
    of the distance, joint compliance; a second station, or both faces, distinguish them.
    """

    slug = "tracker_angle_error"
    of_reading = True
    title = "errors of the tracker's angles"
    meaning = Meaning.of(
        """cause: The tracker's angles err periodically: eccentric or oval circles, or a tilted axis.
        size (sourced): about half (estimate) of the permissible 15 µm + 6 µm/m (manual of the AT500)
        check: Let the tracker warm up for two hours, then run its two-face check, and its field adjustment where that
          fails.
        check: Check that its stand does not twist as the head rotates.
        settle: Measure 10 stops in both faces: odd orders change sign, even orders stay.
        settle: Measure the same stops from a second station."""
    )
    look_alikes = ("tracker_distance_offset", "pedestal_compliance", "joint_compliance")
    variables = frozenset({DriverVariable.BEAM})
    forms = (LawForm("orders", "one and two cycles per revolution of either angle"),)
    free_drivers = (FreeDriver(Quantity.AZIMUTH), FreeDriver(Quantity.ELEVATION))

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each order of each angle, a block per order."""
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
                Channel.TRACKER,
                context.moved(wave(n * angle)[:, None] * across),
                -_MOST_ANGLE,
                _MOST_ANGLE,
                f"{name} {n}",
            )
            for name, angle, across in angles
            for n in _ORDERS
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]
