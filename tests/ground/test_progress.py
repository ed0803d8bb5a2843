"""Estimated times, parts of a job that run at the same time."""

from __future__ import annotations

import threading

import pytest

from cellapp.ground.progress import Progress, SharedProgress, StateChange, eta_words, in_lines, with_eta
from tests.waiting import within

pytestmark = pytest.mark.fast


class Clocked:
    """Events with the estimates that a listener got, at times that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.events: list[Progress] = []
        self._listen = with_eta(self.events.append, lambda: self.now_s)

    def emit(self, now_s: float, event: Progress) -> float | None:
        self.now_s = now_s
        self._listen(event)
        return self.events[-1].eta_s


def test_the_rate_is_that_of_steps_under_our_eyes() -> None:
    job = Clocked()
    assert job.emit(0.0, Progress("collect", 200, 400)) is None, "a resumed job: the stored steps took no time"
    assert job.emit(10.0, Progress("collect", 201, 400)) == pytest.approx(1990.0)
    assert job.emit(14.0, Progress("collect", 201, 400, "measuring")) == pytest.approx(1986.0)
    assert job.emit(20.0, Progress("collect", 202, 400)) == pytest.approx(1980.0)
    assert job.emit(50.0, Progress("collect", 202, 400)) == pytest.approx(198 * 50.0 / 3 - 30.0), "a long step counts"
    assert job.emit(2001.0, Progress("collect", 400, 400)) == 0.0


def test_the_rate_follows_a_change_of_pace() -> None:
    job = Clocked()
    for step in range(50):
        job.emit(step * 1.0, Progress("collect", step, 200))
    for step in range(50, 100):
        eta_s = job.emit(50.0 + (step - 50) * 10.0, Progress("collect", step, 200))
    assert eta_s == pytest.approx(101 * 10.0)


def test_jobs_have_rates_of_their_own_and_begin_anew() -> None:
    job = Clocked()
    job.emit(0.0, Progress("plan", 0, 10))
    assert job.emit(1.0, Progress("calibrate", 0, 3)) is None
    assert job.emit(2.0, Progress("plan", 1, 10)) == pytest.approx(18.0)
    assert job.emit(3.0, Progress("plan", 0, 10)) is None


def test_an_estimate_of_the_emitter_is_kept_and_a_pause_is_no_part_of_the_pace() -> None:
    job = Clocked()
    assert job.emit(0.0, Progress("collect", 0, 10, eta_s=77.0)) == 77.0
    job.emit(1.0, Progress("collect", 1, 10))
    assert job.emit(5000.0, Progress("collect", 1, 10, detail=StateChange("running", "resumed"))) is None
    assert job.emit(5001.0, Progress("collect", 2, 10)) == pytest.approx(8.0)


def test_parts_at_the_same_time_are_added_and_never_go_back() -> None:
    events: list[Progress] = []
    shared = SharedProgress(events.append, "calibrate", 2, 22)
    threads = [
        threading.Thread(target=lambda part=part: [part(step, "step") for step in range(11)])
        for part in (shared.part("arm left"), shared.part("arm right"))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        within(thread.join, "the end of a part")
    done = [event.done for event in events]
    assert done == sorted(done)
    assert (done[-1], events[-1].total) == (22, 22)


def test_times_in_words() -> None:
    assert [eta_words(eta_s) for eta_s in (None, 0.0, 59.0, 90.0, 3700.0)] == [
        "", "0 s left", "59 s left", "2 min left", "1 h 02 min left",
    ]  # fmt: skip


def test_a_long_job_without_a_terminal_says_each_minute_how_far_it_is() -> None:
    now_s, said = [0.0], list[str]()
    listen = in_lines(said.append, lambda: now_s[0])
    for step in range(1000):  # 250 s
        now_s[0] = 0.25 * step
        listen(Progress("iso9283", step, 1000, f"pose {step}", eta_s=249.75 - now_s[0]))
    assert said == [f"iso9283: {k} of 1000, pose {k}, {eta_words(249.75 - k / 4)}" for k in (240, 480, 720, 960)]
    listen(Progress("iso9283", 1000, 1000, "done"))
    assert len(said) == 4
