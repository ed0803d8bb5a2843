"""The trial of stated intervals of recordings, with few runs: far from holding is seen at once."""

from __future__ import annotations

from tests.trials.motion import coverage


def test_intervals_of_recordings_hold():
    held = coverage(12, "slow", 60.0)
    assert held["points"] > 0.85  # 180 coordinates, those of a run alike
    assert held["play"] > 0.85
    assert held["offset"] + held["rate"] > 2 * 0.75
    assert held["largest offset error [ms]"] < 0.2


def test_intervals_hold_beside_errors_that_the_fit_does_not_know():
    held = coverage(10, "effects", 60.0)
    assert held["points"] > 0.8  # 150 coordinates; 0.5 where noise alone was allowed for
    assert held["play"] > 0.85
    assert held["offset"] + held["rate"] > 2 * 0.7
    assert held["largest offset error [ms]"] < 0.2
