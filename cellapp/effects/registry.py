"""All effects that are looked for, by slug."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.effects.backlash import Backlash
from cellapp.effects.effect import Effect
from cellapp.effects.joint_compliance import JointCompliance
from cellapp.effects.periodic import EncoderEccentricity, TransmissionError

_ALL: tuple[Effect, ...] = (
    JointCompliance(),
    EncoderEccentricity(),
    TransmissionError(),
    Backlash(),
)
EFFECTS: Mapping[str, Effect] = {effect.slug: effect for effect in _ALL}
