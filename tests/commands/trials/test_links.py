"""Results of the trial of links: bars, complaints, tables. The trial itself runs with the driver's tests."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from cellapp.commands.trials.link_faults import FAULTS, HUNG, MOMENTS, SLIDER, shuffled
from cellapp.commands.trials.link_results import LinkLog, OtherArm, Struck
from cellapp.commands.trials.tables import link_tables

pytestmark = pytest.mark.fast


def struck(commanded_s: float, beyond_s: float) -> Struck:
    return Struck("link silent", "during", "left", 0.31, 0.5, 0.4, (OtherArm("right", commanded_s, beyond_s),))


@pytest.mark.parametrize(
    ("commanded_s", "beyond_s", "complaint"),
    [
        (0.099, 0.199, ""),
        (0.101, 0.1, "arm right was commanded to stop 101 ms after the first doubt; the bar is 100 ms"),
        (0.01, 0.21, "arm right rested 0.21 s later than its braking time"),
    ],
)
def test_a_missed_bar_is_a_complaint_and_shown(commanded_s: float, beyond_s: float, complaint: str) -> None:
    log = LinkLog(moves=12)
    log.add(struck(0.01, 0.02))
    log.add(struck(commanded_s, beyond_s))
    result = log.result()
    assert len(result.complaints) == bool(complaint)
    assert all(complaint in text for text in result.complaints)
    times = result.by_fault["link silent"]
    assert times.kept == (not complaint)
    assert times.commanded_s is not None
    assert times.commanded_s.max == max(0.01, commanded_s)
    row = link_tables(result)[1].rows[0]
    assert row[0] == "link silent"
    assert row[-1] == ("MISSED" if complaint else "kept")


def test_a_fault_of_the_whole_cell_has_no_affected_arm() -> None:
    log = LinkLog()
    log.add(Struck("stop key", "during", "", 0.0, 0.4, 0.3, (OtherArm("left", 0.0, 0.0), OtherArm("right", 0.0, 0.0))))
    log.add(Struck(SLIDER, "during", "left", None, 0.5, 3.0))
    times = log.result().by_fault
    assert times["stop key"].at_rest_s is None
    assert times["stop key"].commanded_s is not None
    assert times["stop key"].commanded_s.n == 2
    assert times[SLIDER].detected_s is times[SLIDER].commanded_s is None


def test_every_fault_is_drawn_at_every_moment_that_makes_sense() -> None:
    draw = shuffled(np.random.default_rng(1))
    pairs = sum(len(fault.moments) for fault in FAULTS.values())
    drawn = Counter(draw() for _ in range(2 * pairs))
    assert set(drawn.values()) == {2}
    assert {moment for name, moment in drawn if name in (HUNG, SLIDER)} == {"during"}
    assert {moment for name, moment in drawn if name == "protective stop"} == set(MOMENTS)
