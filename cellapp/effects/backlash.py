"""Lost motion on reversal."""

from __future__ import annotations

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext


class Backlash:
    """The joint stands half the play behind its last motion: ``dq_j = -h_j s_j``, s_j = +1 or -1, h_j > 0.

    Needs stops approached from both sides; from one side only it hides in the joint zero. Size: strain-wave drives
    lose up to an arc minute in all, so h is 10 to 150 urad.
    """

    slug = "backlash"
    title = "backlash"
    look_alikes: tuple[str, ...] = ("friction_windup", "unsettled_measurement")

    def columns(self, context: EffectContext) -> list[EffectColumn]:
        """One column a joint; zero where the side of approach is not known."""
        return [
            EffectColumn(f"half_play{j + 1}", "rad", j, -context.approach[:, j].astype(np.float64), 0.0, 5e-3)
            for j in range(context.q.shape[1])
        ]
