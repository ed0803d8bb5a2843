"""Lost motion on reversal: play, hysteresis, and what friction winds up."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, joint_column, unknown_law, varies

WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Steps [rad] after which hysteresis may be saturated."""


class Backlash:
    """The joint stands half the play behind its last motion: ``dq_j = -h_j s_j``, s_j = +1 or -1, h_j > 0 [rad].

    Laws
    ----
    constant
        Any motion takes up all of the play.
    saturating
        ``dq_j = -h_j s_j tanh(|step_j| / w)``: hysteresis that a small step does not take up; w is searched. A step
        that nobody knows counts as the run's median step of that joint.

    Size: strain-wave gears are specified in arc minutes of lost motion (sourced), h some 10 to 150 urad; 40 urad are
    25 to 55 um at a UR10's flange. 90 % visible with stops approached from both sides; from one side only it hides in
    the joint zero. Look-alikes: unsettled measurement where sign and step are tied, friction wind-up.
    """

    slug = "backlash"
    title = "backlash or hysteresis of joints"
    look_alikes: tuple[str, ...] = ("friction_windup", "unsettled_measurement")
    variables = frozenset({"approach", "step"})

    def untestable(self, context: EffectContext) -> str:
        """Needs approaches from both sides."""
        return no_reversal(context)

    def laws(self, context: EffectContext) -> list[Law]:
        """Constant; saturating where steps are known."""
        if not varies(context.known.step):
            return [Law("constant")]
        typical = {f"step{j}": size for j, size in enumerate(np.median(np.abs(context.step), axis=0).tolist(), 1)}
        return [Law("constant"), *(Law("saturating", {"width": w, **typical}, len(WIDTHS)) for w in WIDTHS)]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint; zero where the side of approach is not known."""
        if law.name in ("", "constant"):
            sizes = np.ones(context.q.shape)
        elif law.name == "saturating":
            typical = np.array([law.constants.get(f"step{j + 1}", np.inf) for j in range(context.joints)])
            step = context.known.step
            steps = (
                np.broadcast_to(typical, context.q.shape)
                if step is None
                else np.where(np.isnan(step), typical, np.abs(step))
            )
            sizes = np.tanh(steps / law.constants["width"])
        else:
            raise unknown_law(self.slug, law)
        behind = -context.approach * sizes
        return [joint_column(f"half_play{j + 1}", "rad", j, behind[:, j], 0.0, 5e-3) for j in range(context.joints)]


class FrictionWindup:
    """Friction under load winds the drive up against the last motion: ``dq_j = -s_j (f_j + w_j |tau_j|)``.

    Laws
    ----
    load
        ``w_j`` alone [rad/Nm].
    both
        Dry friction ``f_j`` [rad] as well.

    Size: 1e-4 rad at 50 Nm (2e-6 rad/Nm) are 50 to 130 um at a UR10's flange (estimate, not sourced). 80 % visible with
    stops approached from both sides under different loads. Look-alikes: backlash (0.7 of what is visible; a payload
    change tells them apart), unsettled measurement.
    """

    slug = "friction_windup"
    title = "friction wind-up of joints"
    look_alikes: tuple[str, ...] = ("backlash", "unsettled_measurement")
    variables = frozenset({"approach", "torque", "payload", "q"})

    def untestable(self, context: EffectContext) -> str:
        """Needs approaches from both sides."""
        return no_reversal(context)

    def laws(self, context: EffectContext) -> list[Law]:
        """In proportion to the load; with dry friction."""
        return [Law("load"), Law("both")]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint or two; zero where the side of approach is not known."""
        if law.name not in ("", "load", "both"):
            raise unknown_law(self.slug, law)
        loaded = -context.approach * np.abs(context.torques)
        columns = []
        for j in range(context.joints):
            if law.name == "both":
                columns.append(joint_column(f"dry{j + 1}", "rad", j, -context.approach[:, j], 0.0, 5e-3))
            columns.append(joint_column(f"windup{j + 1}", "rad/Nm", j, loaded[:, j], 0.0, 1e-4))
        return columns


def no_reversal(context: EffectContext) -> str:
    """Why lost motion cannot be seen; empty when some joint was approached from both sides."""
    if not context.approach.any():
        return "no approach signs"
    both = (context.approach > 0.0).any(axis=0) & (context.approach < 0.0).any(axis=0)
    return "" if both.any() else "every joint was approached from one side only"
