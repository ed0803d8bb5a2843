"""The library of named physical effects. A new one is one new file and one line in ``registry``."""

from cellapp.effects.effect import (
    PLAIN,
    Circumstances,
    Effect,
    EffectColumn,
    EffectContext,
    EffectTerm,
    Law,
    Moved,
    Record,
    Refinable,
    joint_column,
    moved_by,
    shift_column,
    varies,
)
from cellapp.effects.registry import EFFECTS

__all__ = [
    "EFFECTS",
    "PLAIN",
    "Circumstances",
    "Effect",
    "EffectColumn",
    "EffectContext",
    "EffectTerm",
    "Law",
    "Moved",
    "Record",
    "Refinable",
    "joint_column",
    "moved_by",
    "shift_column",
    "varies",
]
