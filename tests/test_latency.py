"""The least of several latencies keeps a bound, or all of them are shown."""

from __future__ import annotations

import pytest

from tests.latency import ATTEMPTS, attempts


def test_the_least_of_each_latency_counts() -> None:
    made = iter([{"told": 0.3, "stopped": 0.05}, {"told": 0.1, "stopped": 0.4}, {"told": 0.0, "stopped": 0.0}])
    for took in attempts(told=0.2, stopped=0.1):
        took.update(next(made))
    assert len(list(made)) == 1, "the second attempt completes both"


def test_all_attempts_are_shown_when_none_keeps_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.latency.PAUSES_S", (0.0,) * (ATTEMPTS - 1))

    def too_slow() -> None:
        for took in attempts(told=0.2, stopped=0.1):
            took.update(told=0.1, stopped=0.15)

    with pytest.raises(AssertionError, match=rf"stopped \(0\.1 s\): \[{', '.join(['0.15'] * ATTEMPTS)}\]"):
        too_slow()


def test_an_attempt_that_measured_nothing_is_a_mistake() -> None:
    with pytest.raises(KeyError, match="stopped"):
        list(attempts(stopped=0.1))
