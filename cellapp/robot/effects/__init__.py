"""The library of physical effects. A new effect is one file and one line in ``registry``, or a plug-in."""

from cellapp.robot.effects.context import (
    Channel,
    EffectColumn,
    EffectContext,
    MeasurementConditions,
    TemperatureRecord,
    Wave,
    joint_column,
    shift_column,
    varies,
)
from cellapp.robot.effects.effect import Effect, Meaning, SizeSource, enumeration, place_in_words
from cellapp.robot.effects.law import FIXED, SCALED, Constant, DriverVariable, Law, LawForm, NeighbouringPauses, Scaled
from cellapp.robot.effects.own_law import Linear, MotionLaw, Tuned, motion_laws, own_law
from cellapp.robot.effects.registry import EFFECTS, registered
from cellapp.robot.effects.term import (
    Displacement,
    EffectTerm,
    displacement,
    displacement_by,
    term_from_json,
    term_to_json,
)

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
    "Linear",
    "Meaning",
    "MeasurementConditions",
    "MotionLaw",
    "NeighbouringPauses",
    "Scaled",
    "SizeSource",
    "TemperatureRecord",
    "Tuned",
    "Wave",
    "displacement",
    "displacement_by",
    "enumeration",
    "joint_column",
    "motion_laws",
    "own_law",
    "place_in_words",
    "registered",
    "shift_column",
    "term_from_json",
    "term_to_json",
    "varies",
]
