"""Torsional compliance of joints and gears under gravity."""

from __future__ import annotations

from cellapp.effects.effect import EffectColumn, EffectContext


class JointCompliance:
    """Each joint gives way to the gravity torque on it: ``dq_j = c_j tau_j(q, payload)``, c_j = 1 / K_j > 0.

    Needs a range of q2, q3; a payload change tells it from errors of the masses. Size: strain-wave drives of this
    class have K = 1e4 to 1e5 Nm/rad (Harmonic Drive CSG catalogue, ratio 1:50), 1 to 3 mm at a UR10's flange.
    """

    slug = "joint_compliance"
    title = "joint compliance under gravity"
    look_alikes: tuple[str, ...] = ("link_bending", "encoder_eccentricity", "pedestal_compliance")

    def columns(self, context: EffectContext) -> list[EffectColumn]:
        """One column a joint."""
        return [
            EffectColumn(f"compliance{j + 1}", "rad/Nm", j, context.torques[:, j], 0.0, 1e-3)
            for j in range(context.q.shape[1])
        ]
