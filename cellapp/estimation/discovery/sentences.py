"""Outcomes of structure tests of the residuals, in words."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.estimation.discovery.records import RemainingStructure, StructureKind, StructureTest
from cellapp.robot.effects import enumeration

_KIND_WORDS: Mapping[StructureKind, str] = {
    "joints": "the joint angles",
    "order": "the order of the readings",
    "time": "time",
    "approach": "the side of approach",
    "position": "the position in the workspace",
    "tracker": "the tracker's distance and angles",
}


def remaining_structure(p_values: Mapping[StructureKind, float], chance: float) -> RemainingStructure:
    """Return the tests of the residuals and their outcome in words.

    Structure is reported if a p-value is at most ``chance`` divided by the number of tests (Bonferroni). The
    probability that pure noise is reported as structure is then at most ``chance``.
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


def _p_in_words(p_value: float) -> str:
    return "p below 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"
