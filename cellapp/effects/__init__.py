"""The library of named physical effects. A new one is one new file and one line in ``registry``."""

from cellapp.effects.effect import Effect, EffectColumn, EffectContext, EffectTerm, joint_offsets
from cellapp.effects.registry import EFFECTS

__all__ = ["EFFECTS", "Effect", "EffectColumn", "EffectContext", "EffectTerm", "joint_offsets"]
