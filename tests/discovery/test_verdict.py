"""Verdicts: what was found, whether rivals remain, and whether the noise floor is reached."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.discovery.outcome import AcceptedEffect
from cellapp.discovery.search.comparison import Scatter
from cellapp.discovery.search.state import Rival
from cellapp.discovery.verdict import verdict
from cellapp.effects import EFFECTS, EffectTerm

pytestmark = pytest.mark.fast

NOISE = Scatter(1.0, 0.5)
FAR_ABOVE = Scatter(3.0, 0.0)


def accepted(*rivals: Rival) -> AcceptedEffect:
    law = EFFECTS["backlash"].law("constant")
    term = EffectTerm("backlash", ("half_play1",), np.ones(1), np.ones(1), ("rad",), law)
    return AcceptedEffect(term, (1,), ("joint 1",), 50.0, 0.001, 0.2, 0.1, rivals, None)


@pytest.mark.parametrize(
    ("effects", "after_mm", "scatter", "word"),
    [
        ([], 0.1, NOISE, "nothing missing"),
        ([], 0.12, Scatter(1.2, 0.0), "nothing missing"),
        ([], 0.3, FAR_ABOVE, "unknown effect"),
        ([accepted()], 0.1, NOISE, "explained"),
        ([accepted(Rival("friction_windup", 45.0, True))], 0.1, NOISE, "explained"),
        ([accepted(Rival("friction_windup", 45.0, False))], 0.1, NOISE, "ambiguous"),
        ([accepted()], 0.3, FAR_ABOVE, "unknown effect"),
        ([accepted()], 0.3, None, "explained"),
    ],
)
def test_the_verdict_follows_from_effects_rivals_and_scatter(effects, after_mm, scatter, word) -> None:
    found, sentence = verdict(effects, 0.1, after_mm, 100, scatter)
    assert found == word
    assert ("uncertainty" in sentence) == (scatter is None)
