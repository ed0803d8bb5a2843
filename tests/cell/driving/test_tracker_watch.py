"""The tracker is asked whether it answers, between the job's calls, and watched while the arms move."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
import pytest

from cellapp.cell.driving.tracker_watch import monitored, unwatched, watched
from drivers.trackers.protocol import (
    StreamingTracker,
    StreamLimits,
    Tracker,
    TrackerLinkLost,
    TrackerTimeout,
    stream_of,
)
from tests.latency import attempts

_PATIENT_S = 20.0


def slept(duration_s: float) -> Callable[[], list[str]]:
    """An answer that takes its time."""

    def answer() -> list[str]:
        threading.Event().wait(duration_s)
        return []

    return answer


class Answering:
    """A tracker that answers with ``answer()``, and complains when two calls overlap."""

    def __init__(self, answer: Callable[[], Any] = list) -> None:
        self.answer = answer
        self.asked = threading.Semaphore(0)
        self.overlapped = False
        self._at_work = threading.Lock()

    def confirm(self, within_s: float) -> None:
        self._call(self.answer)
        self.asked.release()

    def unmet(self) -> list[str]:
        return cast(list[str], self._call(slept(0.02)))

    def data_age_s(self) -> float:
        return 0.0

    def _call(self, act: Callable[[], Any]) -> Any:
        if not self._at_work.acquire(blocking=False):
            self.overlapped = True
            return None
        try:
            return act()
        finally:
            self._at_work.release()


def as_tracker(double: Answering) -> Tracker:
    return cast(Tracker, double)


def is_lost() -> None:
    raise TrackerLinkLost("tracker: the link is cut")


def test_a_tracker_that_answers_is_not_reported() -> None:
    tracker, died = Answering(), queue.SimpleQueue[str]()
    with watched(as_tracker(tracker), died.put):
        for _ in range(5):
            assert tracker.asked.acquire(timeout=_PATIENT_S)
    assert died.empty()


def test_a_link_lost_while_the_arms_move_is_reported_at_once_and_once() -> None:
    for took in attempts(reported=0.5):
        tracker, died = Answering(), queue.SimpleQueue[str]()
        with watched(as_tracker(tracker), died.put):
            tracker.answer = is_lost
            began_s = time.monotonic()
            assert died.get(timeout=_PATIENT_S) == "tracker: the link is cut"
            took["reported"] = time.monotonic() - began_s
            for _ in range(2):
                tracker.asked = threading.Semaphore(0)
                tracker.answer = lambda: None
                assert tracker.asked.acquire(timeout=_PATIENT_S)
        assert died.empty()


@pytest.mark.parametrize("error", [TrackerLinkLost("tracker: gone"), TrackerTimeout("tracker: still at work")])
def test_a_tracker_that_is_not_confirmed_is_reported_before_the_arms_move(error: Exception) -> None:
    def fails() -> None:
        raise error

    for watch in (watched, unwatched):
        died: list[str] = []
        with watch(as_tracker(Answering(fails)), died.append):
            assert died == [str(error)]


def test_silence_is_reported_while_the_question_still_hangs() -> None:
    for took in attempts(reported=1.0):
        hanging, tracker, died = threading.Event(), Answering(), queue.SimpleQueue[str]()
        with watched(as_tracker(tracker), died.put):
            tracker.answer = partial(hanging.wait, _PATIENT_S)
            began_s = time.monotonic()
            assert died.get(timeout=_PATIENT_S) == "tracker: no answer for 0.4 s while the arms moved"
            took["reported"] = time.monotonic() - began_s
            assert took["reported"] > 0.3
            hanging.set()
        assert died.empty()


def test_questions_and_calls_never_overlap_and_both_go_on() -> None:
    tracker = Answering(lambda: threading.Event().wait(0.005))
    with monitored(as_tracker(tracker)) as monitor:
        for _ in range(15):
            assert monitor.unmet() == []
            monitor.confirm(1.0)
        assert tracker.asked.acquire(timeout=_PATIENT_S)
    assert not tracker.overlapped


def test_a_call_of_the_job_is_no_silence() -> None:
    tracker, died = Answering(), queue.SimpleQueue[str]()
    with monitored(as_tracker(tracker)) as monitor, watched(monitor, died.put):
        tracker.unmet = slept(0.8)  # type: ignore[method-assign]
        monitor.unmet()
    assert died.empty()


def test_a_silent_tracker_at_rest_is_seen_only_and_reported_at_the_next_motion() -> None:
    tracker, died = Answering(), queue.SimpleQueue[str]()
    with monitored(as_tracker(tracker)) as monitor:
        with watched(monitor, died.put):
            assert tracker.asked.acquire(timeout=_PATIENT_S)
        tracker.answer = is_lost
        assert not tracker.asked.acquire(timeout=0.6)
        assert died.empty()
        with watched(monitor, died.put):
            assert died.get(timeout=0.0) == "tracker: the link is cut"
        tracker.answer = lambda: None
        with watched(monitor, died.put):
            assert died.empty()


class Streaming(Answering):
    """It measures moving SMRs, as it says."""

    def stream_limits(self) -> StreamLimits:
        return cast(StreamLimits, self._call(lambda: StreamLimits(0.001, 1.0)))

    def start_track(self, expected_M: Any, interval_s: float, lost: Any, received: Any) -> None:
        self._call(lambda: None)

    def end_track(self) -> str:
        return cast(str, self._call(lambda: "a track"))


def test_a_monitor_can_do_what_its_tracker_can() -> None:
    assert not isinstance(monitored(as_tracker(Answering())), StreamingTracker)
    monitor = monitored(as_tracker(Streaming()))
    assert isinstance(monitor, StreamingTracker)
    monitor.start_track(np.zeros(3), 0.01, lambda error: None)
    assert stream_of(monitor) is monitor
    assert monitor.end_track() == "a track"  # type: ignore[comparison-overlap]
    assert monitor.data_age_s() == 0.0
