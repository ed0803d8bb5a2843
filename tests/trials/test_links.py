"""Results of the trial of links: bars, complaints, tables. The trial itself runs with the driver's tests."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.ground.errors import CheckFailed
from tests.trials import links
from tests.trials.link_faults import FAULTS, HUNG, MOMENTS, SLIDER, shuffled
from tests.trials.link_results import LinkLog, OtherArm, Struck
from tests.trials.link_tables import link_tables

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


@pytest.mark.parametrize("complaints", [[], ["move 3: an arm still moves"]])
def test_a_broken_promise_ends_the_command_with_one(monkeypatch: pytest.MonkeyPatch, complaints: list[str]) -> None:
    struck = [Struck("link closed", "during", "left", 0.07, 0.15, 0.22, (OtherArm("right", 0.01, 0.05),))]
    log = LinkLog(4, struck, complaints, connect_s=[0.2], state_s=[0.005], overhead_s=[0.04])
    monkeypatch.setattr(links, "link_trials", lambda *_: log.result())
    ended = CliRunner().invoke(links.app, ["--moves", "4", "--every", "2"])
    assert isinstance(ended.exception, CheckFailed) == bool(complaints)
    assert "link closed" in ended.stdout
    assert "kept" in ended.stdout
    assert all(complaint in ended.stdout for complaint in complaints)
    stated = CliRunner().invoke(links.app, ["--json", "-"])
    assert json.loads(stated.stdout)["by_fault"]["link closed"]["at_rest_s"]["max"] == 0.15
