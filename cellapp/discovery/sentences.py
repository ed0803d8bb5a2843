"""Outcomes of tests in words: structure of what is left, findings that contradict their own effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from cellapp.effects import EFFECTS, DriverVariable, enumeration, place_in_words
from cellapp.results import Contradiction, RemainingStructure, StructureKind, StructureTest

_KIND_WORDS: Mapping[StructureKind, str] = {
    "joints": "the joint angles",
    "order": "the order of the readings",
    "time": "time",
    "approach": "the side of approach",
    "position": "the position in the workspace",
    "tracker": "the tracker's distance and angles",
}
_SIGN_CHECKS: tuple[tuple[DriverVariable, str], ...] = (
    (DriverVariable.APPROACH, "the approach convention: +1 is a last motion towards larger joint angles"),
    (DriverVariable.STEP, "the sign of the last steps"),
    (DriverVariable.JOINT_TEMPERATURE, "the sign and the order of the temperatures"),
    (DriverVariable.TORQUE, "the direction of gravity, the masses and the payload in the profile"),
    (DriverVariable.OTHER_ARM, "which readings are those of the other arm"),
)
"""What to check where a sign is impossible, by what the effect depends on, the first that applies."""


def remaining_structure(p_values: Mapping[StructureKind, float], chance: float) -> RemainingStructure:
    """The tests of what is left and their outcome in words.

    Structure is stated where a p-value is at most ``chance`` divided by the number of tests (Bonferroni): the chance
    that pure noise is said to have any structure is then at most ``chance``.
    """
    tests = tuple(StructureTest(against=kind, p_value=p) for kind, p in p_values.items())
    if not tests:
        return RemainingStructure(tests=(), sentence="what is left was not tested for structure")
    found = [test for test in tests if test.p_value <= chance / len(tests)]
    if found:
        words = enumeration([f"{_KIND_WORDS[test.against]} ({_p_in_words(test.p_value)})" for test in found])
        return RemainingStructure(tests=tests, sentence=f"what is left still depends on {words}")
    tested = enumeration([_KIND_WORDS[test.against] for test in tests])
    smallest = min(test.p_value for test in tests)
    return RemainingStructure(
        tests=tests,
        sentence=f"what is left shows no structure against {tested} (smallest {_p_in_words(smallest)})",
    )


def contradiction(
    effect: str, acts_on: Sequence[str], joints: Sequence[int], size_um: float, impossible: Literal["sign", "size"]
) -> Contradiction:
    """What behaves like an effect with an impossible sign or size, in words.

    Parameters
    ----------
    effect : str
        Its slug.
    acts_on, joints
        Names of what it acts on, ``joint 2`` or ``base``; its joints, from 1.
    size_um : float
        Rms displacement of the SMR.
    impossible
        What is impossible.
    """
    like = "of the opposite sign" if impossible == "sign" else "of an impossible size"
    return Contradiction(
        effect=effect,
        joints=tuple(joints),
        size_um=size_um,
        sentence=f"behaves like {EFFECTS[effect].title}, but {like}, at {place_in_words(acts_on)},"
        f" {size_um:.0f} um rms at the SMR: check {_to_check(effect)}; counted as unknown",
    )


def _to_check(effect: str) -> str:
    depends = EFFECTS[effect].variables
    return next((words for variable, words in _SIGN_CHECKS if variable in depends), "the signs of what it depends on")


def _p_in_words(p_value: float) -> str:
    return "p below 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"
