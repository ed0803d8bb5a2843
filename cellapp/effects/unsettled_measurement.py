"""Readings taken before the arm came to rest."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, joint_column, unknown_law, varies
from cellapp.effects.history import filled
from cellapp.kinematics.transforms import Array

TIME_CONSTANTS = tuple(np.geomspace(0.3, 30.0, 8).tolist())
"""In which servo tails, creep and swing may die away [s]."""
_NOTHING_LEFT = 1e-4


class UnsettledMeasurement:
    """The joint is still on its way: a share of its last motion is missing, ``dq_j = -e_j step_j exp(-t_d / tau)``.

    Laws
    ----
    step
        ``dq_j = -lag_j step_j`` [rad/rad], whatever the dwell t_d.
    creep
        As above, ``lag_j`` the share that is missing at the moment of rest; tau is searched where the dwell varies. A
        dwell that nobody knows counts as the run's median.

    Size: 5e-5 of a move of 1 rad are 30 to 70 um at a UR10's flange (estimate, not sourced). 91 % visible where step
    and sign of the last motion are not tied. Bounds hold for overshoot as well, a negative lag: a joint may swing past.
    Look-alikes: backlash (0.6 where sign and step are tied), friction wind-up. A longer dwell proves it.
    """

    slug = "unsettled_measurement"
    title = "measurement before settling"
    look_alikes: tuple[str, ...] = ("backlash", "friction_windup")
    variables = frozenset({"step", "dwell"})

    def untestable(self, context: EffectContext) -> str:
        """Needs the last steps."""
        return "" if varies(context.known.step) else "no last steps"

    def laws(self, context: EffectContext) -> list[Law]:
        """Whatever the dwell; dying away with it, for time constants that leave something at the shortest dwell."""
        dwell = context.known.dwell_s
        if dwell is None or not varies(dwell):
            return [Law("step")]
        shortest, typical = float(dwell.min()), float(np.median(dwell))
        taus = [tau for tau in TIME_CONSTANTS if np.exp(-shortest / tau) > _NOTHING_LEFT]
        return [Law("step"), *(Law("creep", {"tau_s": tau, "dwell_s": typical}, len(taus)) for tau in taus)]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint; zero where the last step is not known."""
        left: Array | float
        if law.name in ("", "step"):
            left, largest = 1.0, 1e-2
        elif law.name == "creep":
            dwell = filled(context.known.dwell_s, law.constants["dwell_s"], len(context))
            left, largest = np.exp(-dwell / law.constants["tau_s"])[:, None], 1e-1
        else:
            raise unknown_law(self.slug, law)
        behind = -context.step * left
        return [
            joint_column(f"lag{j + 1}", "rad/rad", j, behind[:, j], -largest, largest) for j in range(context.joints)
        ]
