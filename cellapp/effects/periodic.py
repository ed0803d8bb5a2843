"""Errors that are periodic in the joint angle: one cycle a turn, or more."""

from __future__ import annotations

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext


def _cycles(context: EffectContext, cycles: int) -> list[EffectColumn]:
    columns = []
    for j in range(context.q.shape[1]):
        for letter, wave in (("cos", np.cos), ("sin", np.sin)):
            columns.append(
                EffectColumn(f"{letter}{cycles}q{j + 1}", "rad", j, wave(cycles * context.q[:, j]), -5e-3, 5e-3)
            )
    return columns


class EncoderEccentricity:
    """One cycle a turn: ``dq_j = (e / r) sin(q_j + phi) = A cos q_j + B sin q_j``.

    A graduated disc of radius r whose centre lies e off the axis, read by one head; 2 um on 25 mm is 80 urad. A gear's
    first-order error has exactly this shape and is not told apart. Needs most of a turn of the joint.
    """

    slug = "encoder_eccentricity"
    title = "encoder eccentricity (one cycle a turn)"
    look_alikes: tuple[str, ...] = ("joint_compliance", "transmission_error")

    def columns(self, context: EffectContext) -> list[EffectColumn]:
        """Cosine and sine of each joint."""
        return _cycles(context, 1)


class TransmissionError:
    """Two cycles a turn: ``dq_j = A cos 2 q_j + B sin 2 q_j``, ovality of gear or encoder disc.

    Size 20 to 80 urad. Higher orders, which strain-wave gears have too, are not in this version.
    """

    slug = "transmission_error"
    title = "transmission error (two cycles a turn)"
    look_alikes: tuple[str, ...] = ("encoder_eccentricity",)

    def columns(self, context: EffectContext) -> list[EffectColumn]:
        """Cosine and sine of twice each joint angle."""
        return _cycles(context, 2)
