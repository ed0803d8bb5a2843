"""Errors of the measurement: tracker, retroreflector on the flange, readings before the arm came to rest."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.base_motion import OnsetEffect
from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, joint_column, shift_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import FIXED, SCALED, Constant, InputVariable, Law, LawForm
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.effects.thermal import MEAN_AIR, above_mean_air
from cellapp.robot.effects.time_functions import after_onset, with_default
from cellapp.robot.kinematics.transforms import Array

# -- Laser tracker ----------------------------------------------------------------------------------------------------


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


PLAIN_SCALE = LawForm("", "in proportion to the distance", variables=frozenset({InputVariable.BEAM}))
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
    confounded = ("thermal_growth", "tracker_distance_offset")
    variables = frozenset({InputVariable.BEAM, InputVariable.AIR_TEMPERATURE})
    forms = (PLAIN_SCALE, AIR_SCALE)
    discrepancy_inputs = (TermInput(Quantity.RANGE), TermInput(Quantity.TEMPERATURE))

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
            return [shift_column("scale_air", "1/K", ActsOn.TRACKER, shift_M, -largest, largest)]
        return [shift_column("scale", "m/m", ActsOn.TRACKER, context.moved(context.p_M), -_MOST_SCALE, _MOST_SCALE)]


class TrackerDistanceOffset(Effect):
    """A constant error of all distances: ``dP = k u / rho``, k in m.

    Home distance or the absolute distance meter's zero: permissible errors are 5 and 10 µm for a tracker of this class
    (maker's manual). Only 12 % is visible, the rest is a shift of the base: short and long distances, or the target
    between two stations, show it. Confounded: errors of the tracker's angles (0.9).
    """

    slug = "tracker_distance_offset"
    of_reading = True
    title = "zero of the tracker's distance"
    meaning = Meaning.of(
        """cause: All distances are off by one length: zero of the distance meter, wrong type of SMR or home point.
        size (sourced): permissible: 5 µm for home distance, 10 µm for the meter (manual of the AT500)
        check: Check that the SMR selected in the tracker is the one on the flange.
        check: Set the distance at the home point again and run the tracker's own check of its zero.
        settle: Measure a target between two stations of the tracker, or stops near and far."""
    )
    confounded = ("tracker_angle_error", "pedestal_compliance", "target_incidence")
    variables = frozenset({InputVariable.BEAM})
    forms = (LawForm("", "the same at any distance"),)
    discrepancy_inputs = (TermInput(Quantity.RANGE),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column."""
        along = context.moved(context.beam[1])
        return [shift_column("distance_offset", "m", ActsOn.TRACKER, along, -_MOST_OFFSET, _MOST_OFFSET)]


class TrackerAngleError(Effect):
    """Angles err with one and two cycles per revolution: ``d_az = sum_n a_n cos n az + b_n sin n az``, so for el.

    Eccentricity and runout of the graduated circles; amplitudes in rad. Across the beam, azimuth moves the point by
    ``rho cos el d_az``, elevation by ``rho d_el``. Even orders survive two-face averaging (published). Size: half of
    the permissible 15 µm + 6 µm/m is typical (maker's manual). 23 % is visible from one station. Confounded: the zero
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
    confounded = ("tracker_distance_offset", "pedestal_compliance", "joint_compliance")
    variables = frozenset({InputVariable.BEAM})
    forms = (LawForm("orders", "one and two cycles per revolution of either angle"),)
    discrepancy_inputs = (TermInput(Quantity.AZIMUTH), TermInput(Quantity.ELEVATION))

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
                ActsOn.TRACKER,
                context.moved(wave(n * angle)[:, None] * across),
                -_MOST_ANGLE,
                _MOST_ANGLE,
                f"{name} {n}",
            )
            for name, angle, across in angles
            for n in _ORDERS
            for letter, wave in (("cos", np.cos), ("sin", np.sin))
        ]


# -- Retroreflector on the flange -------------------------------------------------------------------------------------


_MOST_SLIP = 1e-2
"""Bound [m]: a target that slipped by a centimetre has fallen off."""
_MOST_ROTATION = 0.1
"""Bound [rad] of a probe's rotation in its mount; from twice this a calibration refuses the orientations."""
_MOST_INCIDENCE = 5e-3
"""Bound [m]: ``1 - cos th`` is 0.13 at 30 degrees, so that this is 0.7 mm, some thirty times the error of a prism."""
RADIAL = LawForm("radial", "along the beam")
LATERAL = LawForm("lateral", "along and across the beam")


class TargetSlip(OnsetEffect):
    """The SMR's mount slips: the SMR moves in the flange by ``d`` [m] along its x, y, z after an onset; a probe, whose
    orientation was measured, also turns by ``w`` [rad] about them.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. Size: 20 to 200 µm
    (estimate); 59 % visible, as it rotates with the wrist. Confounded: no close one; a step of the base where the
    wrist hardly rotates.
    """

    slug = "target_slip"
    of_reading = True
    title = "slip of the target in the flange"
    meaning = Meaning.of(
        """cause: The SMR or its mount slipped in the flange at one moment of the run.
        size (estimate): 20 to 200 µm
        check: Check the screws of the SMR's mount and that the SMR sits clean and fully in it.
        check: Look in the log for a collision of the tool at that time.
        settle: Revisit one of the first poses at two rolls of the wrist: a slipped target rotates with it."""
    )
    confounded = ("base_step",)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Three columns, six of a probe; after the onset where the time is unknown."""
        moved = context.frames[0][-1] * after_onset(context, law)[:, None, None]
        slips = [
            shift_column(f"slip_{letter}", "m", ActsOn.TOOL, context.moved(moved[:, :, k]), -_MOST_SLIP, _MOST_SLIP)
            for k, letter in enumerate("xyz")
        ]
        if context.angular is None if names is None else "turn_x" not in names:
            return slips
        rotations = [context.moved(None, moved[:, :, k]) for k in range(3)]
        return slips + [
            shift_column(f"turn_{letter}", "rad", ActsOn.TOOL, angle_M, -_MOST_ROTATION, _MOST_ROTATION)
            for letter, angle_M in zip("xyz", rotations, strict=True)
        ]


class TargetIncidence(Effect):
    """The reading depends on the angle th between the SMR's axis and the direction back to the tracker.

    Laws
    ----
    radial
        ``dP = k (1 - cos th) u / rho``, k in m: glass or a vertex off the centre lengthen the path.
    lateral
        Also ``dP = l (n - (n.b) b)``, n the SMR's axis and b the unit vector along the beam, which is sin th across the
        beam in the plane of incidence, l in m: dihedral errors of the three mirrors.

    Size: 2 to 20 µm, more for glass prisms (makers' notes on both; the sizes are an estimate). 43 % visible, the rest
    is an SMR offset. Visible with the same point at several wrist rolls. Confounded: none close once wrists rotate.
    """

    slug = "target_incidence"
    of_reading = True
    title = "target's error with the angle of incidence"
    meaning = Meaning.of(
        """cause: The reading changes with the angle at which the beam meets the SMR: a vertex off the centre,
          mirrors that are not square, a glass prism.
        size (estimate): 2 to 20 µm, more for glass prisms
        check: Clean the SMR, look for a damaged mirror, or exchange it and repeat 10 stops.
        check: Mount the SMR so that it faces the tracker in the middle of the work.
        settle: Measure one point at six rolls of the wrist, and with the SMR rotated by 90 degrees in its mount."""
    )
    confounded = ("tracker_distance_offset",)
    variables = frozenset({InputVariable.INCIDENCE})
    forms = (RADIAL, LATERAL)
    discrepancy_inputs = (TermInput(Quantity.INCIDENCE),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs the SMR viewing direction."""
        return "the SMR viewing direction is not known" if context.smr_normal is None else ""

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column or two; zero where the SMR viewing direction is unknown."""
        radial, lateral = np.zeros((len(context), 3)), np.zeros((len(context), 3))
        if context.smr_normal is not None:
            _, beam = context.beam
            normal = context.frames[0][-1] @ context.smr_normal
            along = np.einsum("na,na->n", normal, beam)
            radial, lateral = (1.0 + along)[:, None] * beam, normal - along[:, None] * beam
        shifts = {"incidence_radial": radial}
        if law.form == LATERAL:
            shifts["incidence_lateral"] = lateral
        return [
            shift_column(name, "m", ActsOn.TRACKER, context.moved(shift_M), -_MOST_INCIDENCE, _MOST_INCIDENCE)
            for name, shift_M in shifts.items()
        ]


# -- Readings before the arm came to rest -----------------------------------------------------------------------------


TIME_CONSTANTS = tuple(np.geomspace(0.3, 30.0, 8).tolist())
"""Time constants of servo tails, creep and oscillation to try [s]."""
_NOTHING_REMAINS = 1e-4
"""Fraction of the lag below which nothing is left to see at the shortest dwell."""
_MOST_STEP_LAG = 1e-2
"""Bound of the missing fraction of a step, whatever the dwell [rad/rad]."""
_MOST_CREEP_LAG = 1e-1
"""Bound of the missing fraction at the moment of rest [rad/rad]: most of it is gone at the reading."""

SETTLING_TIME = Constant("tau_s", "s", SCALED, "time constant {} s")
TYPICAL_DWELL = Constant("dwell_s", "s", FIXED)
"""Median dwell of the run, for stops whose dwell is unknown."""
STEP = LawForm("step", "in proportion to the last step")
CREEP = LawForm(
    "creep", "in proportion to the last step, dying away while the arm dwells", (SETTLING_TIME, TYPICAL_DWELL)
)


class UnsettledMeasurement(Effect):
    """The joint has not arrived: a fraction of its last motion is missing, ``dq_j = -e_j step_j exp(-t_d / tau)``.

    Laws
    ----
    step
        ``dq_j = -lag_j step_j`` [rad/rad], whatever the dwell t_d.
    creep
        As above, ``lag_j`` the fraction that is missing at the moment of rest; tau is searched where the dwell varies.
        An unknown dwell counts as the run's median.

    Size: 5e-5 of a move of 1 rad are 30 to 70 µm at a UR10's flange (estimate, not sourced). 91 % visible where step
    and sign of the last motion are not correlated. Bounds allow overshoot as well, a negative lag. Confounded:
    backlash (0.6 where sign and step are correlated), friction wind-up. A longer dwell proves it.
    """

    slug = "unsettled_measurement"
    title = "measurement before settling"
    meaning = Meaning.of(
        """cause: The tracker measured before {place} had come to rest: servo tail, creep of the gear, or swing of the
          arm.
        size (estimate): 5e-5 of a move of 1 rad, 30 to 70 µm at the flange of a UR10
        check: Raise the dwell before a measurement until the value no longer changes.
        check: Lower speed and acceleration of the approach.
        check: Check what can make the SMR swing: compressor, doors, the other arm.
        settle: Vary the dwell from 0.5 to 10 s at random.
        settle: Read the same stop again 5 s later."""
    )
    confounded = ("backlash", "friction_windup")
    variables = frozenset({InputVariable.STEP, InputVariable.DWELL})
    forms = (STEP, CREEP)
    discrepancy_inputs = (
        TermInput(Quantity.STEP, absolute=True),
        TermInput(Quantity.DWELL),
        TermInput(Quantity.JOINT_ANGLE),
    )

    def missing_data(self, context: EffectContext) -> str:
        """Needs the last steps."""
        return "" if varies(context.conditions.step) else "no last steps"

    def laws(self, context: EffectContext) -> list[Law]:
        """Without dwell; decaying with it, for time constants that leave something at the shortest dwell."""
        dwell = context.conditions.dwell_s
        if dwell is None or not varies(dwell):
            return [STEP.law()]
        shortest, typical = float(dwell.min()), float(np.median(dwell))
        taus = [tau for tau in TIME_CONSTANTS if np.exp(-shortest / tau) > _NOTHING_REMAINS]
        constants = [{SETTLING_TIME.name: tau, TYPICAL_DWELL.name: typical} for tau in taus]
        return [STEP.law(), *(CREEP.law(one, len(taus)) for one in constants)]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint; zero where the last step is unknown."""
        remaining: Array | float = 1.0
        largest = _MOST_STEP_LAG
        if law.form == CREEP:
            dwell = with_default(context.conditions.dwell_s, law.constants[TYPICAL_DWELL.name], len(context))
            remaining, largest = np.exp(-dwell / law.constants[SETTLING_TIME.name])[:, None], _MOST_CREEP_LAG
        behind = -context.step * remaining
        return [
            joint_column(f"lag{j + 1}", "rad/rad", j, behind[:, j], -largest, largest) for j in range(context.joints)
        ]
