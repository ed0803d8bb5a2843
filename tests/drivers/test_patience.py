"""Time limits that count only the time in which a process ran."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
import time

import pytest

from drivers import patience, priority
from drivers.patience import MOST_S, SLICE_S, Patience, RunningTime, patient_get
from tests.waiting import within


class Clock:
    """A clock that a test moves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 50.0
        monkeypatch.setattr(patience, "time", self)

    def monotonic(self) -> float:
        return self.now_s

    def run(self, seconds: float) -> None:
        """Let time pass in slices, with a look at each."""
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_a_suspension_hardly_counts_and_leaves_time_to_read(clock: Clock) -> None:
    limit = Patience(0.3)
    clock.run(0.04)
    assert limit.remaining_s == pytest.approx(0.26)
    clock.run(3.0)
    assert limit.remaining_s == pytest.approx(0.26 - MOST_S)
    clock.run(0.1)
    assert limit.remaining_s == pytest.approx(0.06)
    clock.run(3.0)
    assert limit.remaining_s == pytest.approx(SLICE_S)
    clock.run(1.01 * SLICE_S)
    assert limit.over


def test_a_part_ends_with_the_whole_and_is_counted_in_it(clock: Clock) -> None:
    whole = Patience(1.0)
    part = whole.share(0.5)
    for _ in range(10):
        clock.run(0.0501)
        assert part.remaining_s >= 0.0
    assert part.over
    assert whole.remaining_s == pytest.approx(0.5, abs=0.002)
    longer = Patience(9.0, whole)
    for _ in range(10):
        clock.run(0.05)
        assert longer.remaining_s >= 0.0
    assert longer.over


def test_a_wait_ends_when_the_look_raises(clock: Clock) -> None:
    def look() -> None:
        if clock.now_s > 50.2:
            raise InterruptedError

    limit = Patience(10.0, look=look).share(0.5)
    clock.run(0.1)
    assert not limit.over
    clock.run(0.2)
    with pytest.raises(InterruptedError):
        assert limit.over


def test_a_clock_stands_still_while_its_process_does(clock: Clock) -> None:
    running = RunningTime()
    assert running.at(10.0) == 10.0
    assert running.at(10.008) == pytest.approx(10.008)
    assert running.at(13.0) == pytest.approx(10.008 + MOST_S)
    assert running.at(13.01) == pytest.approx(10.018 + MOST_S)


def test_an_answer_that_waits_is_taken_even_without_time_left() -> None:
    answers: queue.SimpleQueue[int] = queue.SimpleQueue()
    answers.put(1)
    assert patient_get(answers, Patience(0.0)) == 1
    with pytest.raises(queue.Empty):
        patient_get(answers, Patience(0.0))
    began_s = time.monotonic()
    threading.Timer(0.1, answers.put, (2,)).start()
    assert patient_get(answers, Patience(5.0)) == 2
    with pytest.raises(queue.Empty):
        patient_get(answers, Patience(0.1))
    assert time.monotonic() - began_s >= 0.2


# -- Priorities: where they are not permitted nothing changes, and what measures times gives its own back --------------


def refused(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_what_is_not_permitted_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "setpriority", refused, raising=False)
    monkeypatch.setattr(os, "sched_setscheduler", refused, raising=False)
    priority.run_first(-10)
    for inherited in (False, True):
        with priority.in_real_time(inherited=inherited) as permitted:
            assert not permitted


@pytest.mark.skipif(sys.platform != "linux", reason="schedulers are those of Linux")
def test_only_the_thread_that_measures_runs_in_real_time_and_only_meanwhile() -> None:
    before = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK  # that flag stays with who measured before
    policies: list[int] = []
    with priority.in_real_time() as permitted:
        if not permitted:
            pytest.skip("this user may not run in real time")
        assert os.sched_getscheduler(0) & os.SCHED_RR
        other = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        other.start()
        within(other.join, "the end of the other thread")
        text = "import os; print(os.sched_getscheduler(0))"
        policies.append(int(subprocess.check_output([sys.executable, "-c", text])))
    assert policies == [before, before]
    assert not os.sched_getscheduler(0) & os.SCHED_RR
