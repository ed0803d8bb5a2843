"""Verdicts: what was found, whether rivals remain, and whether the noise floor is reached."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.discovery.accepted import accepted_effect
from cellapp.estimation.discovery.records import AcceptedEffect, BeforeAfter, Evidence, Place, RunnerUp
from cellapp.estimation.discovery.search.state import Scatter
from cellapp.estimation.discovery.verdict import CHANCE, remaining_structure, verdict
from cellapp.robot.effects import EFFECTS, EffectTerm

pytestmark = pytest.mark.fast

NOISE = Scatter(1.0, 0.5)
FAR_ABOVE = Scatter(3.0, 0.0)
NONE = remaining_structure({"joints": 0.4, "time": 0.2}, CHANCE)
STRUCTURE = remaining_structure({"joints": 0.4, "time": 1e-6}, CHANCE)
UNTESTED = remaining_structure({}, CHANCE)


def rival(*, distinguishable: bool) -> RunnerUp:
    return RunnerUp(effect="friction_windup", statistic=45.0, distinguishable=distinguishable)


def accepted(*rivals: RunnerUp) -> AcceptedEffect:
    law = EFFECTS["backlash"].law("constant")
    term = EffectTerm("backlash", ("half_play1",), np.ones(1), np.ones(1), ("rad",), law)
    evidence = Evidence(statistic=50.0, corrected_p=0.001, heldout_mm=BeforeAfter(before=0.2, after=0.1))
    return accepted_effect(term, Place(joints=(1,), acts_on=("joint 1",)), evidence, 0.9, runners_up=rivals)


@pytest.mark.parametrize(
    ("effects", "after_mm", "scatter", "structure", "word"),
    [
        ([], 0.1, NOISE, NONE, "nothing missing"),
        ([], 0.12, Scatter(1.2, 0.0), NONE, "nothing missing"),
        ([], 0.12, Scatter(1.2, 0.0), STRUCTURE, "unknown effect"),
        ([], 0.3, FAR_ABOVE, STRUCTURE, "unknown effect"),
        ([], 0.3, FAR_ABOVE, NONE, "nothing missing"),
        ([], 0.3, FAR_ABOVE, UNTESTED, "nothing missing"),
        ([], 0.3, None, NONE, "nothing missing"),
        ([], 0.3, None, STRUCTURE, "unknown effect"),
        ([accepted()], 0.1, NOISE, NONE, "explained"),
        ([accepted()], 0.1, NOISE, STRUCTURE, "explained"),
        ([accepted(rival(distinguishable=True))], 0.1, NOISE, NONE, "explained"),
        ([accepted(rival(distinguishable=False))], 0.1, NOISE, NONE, "ambiguous"),
        ([accepted(rival(distinguishable=False))], 0.3, None, STRUCTURE, "unknown effect"),
        ([accepted()], 0.3, FAR_ABOVE, STRUCTURE, "unknown effect"),
        ([accepted()], 0.3, FAR_ABOVE, NONE, "explained"),
        ([accepted()], 0.3, FAR_ABOVE, UNTESTED, "explained"),
        ([accepted()], 0.3, None, NONE, "explained"),
        ([accepted()], 0.3, None, STRUCTURE, "unknown effect"),
    ],
)
def test_the_verdict_follows_from_effects_rivals_and_what_is_left(effects, after_mm, scatter, structure, word) -> None:
    found, sentence = verdict(effects, 0.1, after_mm, 100, scatter, structure)
    assert found == word
    assert ("state no uncertainty" in sentence) == (scatter is None)
    assert ("still depends on time" in sentence) == (word == "unknown effect")
    scatters = scatter is not None and after_mm > 0.1 and structure is not STRUCTURE
    assert ("times as stated" in sentence) == scatters


def test_readings_that_are_too_few_for_a_search_do_not_say_that_nothing_is_missing() -> None:
    found, sentence = verdict([], 0.1, 1.3, 10, Scatter(50.0, 0.0), UNTESTED)
    assert found == "unknown effect"
    assert "scatter 50 times as stated and are too few to look for effects" in sentence
