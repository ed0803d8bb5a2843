"""The library of physical effects. A new effect is one file and one line in ``registry``, or a plug-in."""

from cellapp.effects.column import Channel, EffectColumn, Wave, joint_column, shift_column
from cellapp.effects.context import EffectContext, MeasurementConditions, TemperatureRecord, varies
from cellapp.effects.effect import Effect
from cellapp.effects.law import (
    FIXED,
    SCALED,
    Constant,
    DriverVariable,
    Law,
    LawForm,
    NeighbouringPauses,
    Scaled,
)
from cellapp.effects.meaning import Meaning, SizeSource, enumeration, place_in_words
from cellapp.effects.registry import EFFECTS, registered
from cellapp.effects.term import Displacement, EffectTerm, displacement, term_from_json, term_to_json

__all__ = [
    "EFFECTS",
    "FIXED",
    "SCALED",
    "Channel",
    "Constant",
    "Displacement",
    "DriverVariable",
    "Effect",
    "EffectColumn",
    "EffectContext",
    "EffectTerm",
    "Law",
    "LawForm",
    "Meaning",
    "MeasurementConditions",
    "NeighbouringPauses",
    "Scaled",
    "SizeSource",
    "TemperatureRecord",
    "Wave",
    "displacement",
    "enumeration",
    "joint_column",
    "place_in_words",
    "registered",
    "shift_column",
    "term_from_json",
    "term_to_json",
    "varies",
]
