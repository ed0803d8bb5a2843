"""Readings taken before the arm came to rest."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext, joint_column, varies
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import FIXED, SCALED, Constant, DriverVariable, Law, LawForm
from cellapp.robot.effects.modulation import FreeDriver
from cellapp.robot.effects.time_functions import with_default
from cellapp.robot.kinematics.transforms import Array

TIME_CONSTANTS = tuple(np.geomspace(0.3, 30.0, 8).tolist())
"""Time constants of servo tails, creep and oscillation to try [s]."""
_NOTHING_LEFT = 1e-4
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
    and sign of the last motion are not correlated. Bounds allow overshoot as well, a negative lag. Look-alikes:
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
    look_alikes = ("backlash", "friction_windup")
    variables = frozenset({DriverVariable.STEP, DriverVariable.DWELL})
    forms = (STEP, CREEP)
    free_drivers = (
        FreeDriver(Quantity.STEP, absolute=True),
        FreeDriver(Quantity.DWELL),
        FreeDriver(Quantity.JOINT_ANGLE),
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
        taus = [tau for tau in TIME_CONSTANTS if np.exp(-shortest / tau) > _NOTHING_LEFT]
        constants = [{SETTLING_TIME.name: tau, TYPICAL_DWELL.name: typical} for tau in taus]
        return [STEP.law(), *(CREEP.law(one, len(taus)) for one in constants)]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column per joint; zero where the last step is unknown."""
        left: Array | float = 1.0
        largest = _MOST_STEP_LAG
        if law.form == CREEP:
            dwell = with_default(context.conditions.dwell_s, law.constants[TYPICAL_DWELL.name], len(context))
            left, largest = np.exp(-dwell / law.constants[SETTLING_TIME.name])[:, None], _MOST_CREEP_LAG
        behind = -context.step * left
        return [
            joint_column(f"lag{j + 1}", "rad/rad", j, behind[:, j], -largest, largest) for j in range(context.joints)
        ]
