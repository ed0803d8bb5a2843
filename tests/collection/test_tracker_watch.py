"""The tracker is watched while the arms move."""

from __future__ import annotations

import queue
import threading
from typing import Any, cast

import pytest

from cellapp.collection.tracker_watch import watched
from drivers.trackers.protocol import Tracker, TrackerLinkLost

pytestmark = pytest.mark.fast


class Answering:
    """A tracker that answers with ``answer()``."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer
        self.asked = threading.Semaphore(0)

    def unmet(self) -> list[str]:
        self.asked.release()
        return cast(list[str], self._answer())


def as_tracker(double: Answering) -> Tracker:
    return cast(Tracker, double)


def test_a_tracker_that_answers_is_not_reported() -> None:
    tracker, died = Answering(lambda: ["no target"]), queue.SimpleQueue[str]()
    with watched(as_tracker(tracker), died.put):
        for _ in range(3):
            assert tracker.asked.acquire(timeout=10.0)
    assert died.empty()


def test_a_lost_link_is_reported_at_once() -> None:
    def lost() -> list[str]:
        raise TrackerLinkLost("tracker: the link is cut")

    died = queue.SimpleQueue[str]()
    with watched(as_tracker(Answering(lost)), died.put):
        assert died.get(timeout=10.0) == "tracker: the link is cut"


def test_silence_is_reported_while_the_call_still_hangs() -> None:
    hanging, died = threading.Event(), queue.SimpleQueue[str]()

    def hang() -> list[str]:
        hanging.wait(30.0)
        return []

    with watched(as_tracker(Answering(hang)), died.put, silent_s=0.05):
        assert died.get(timeout=10.0) == "tracker: no answer for 0.05 s while the arms moved"
        hanging.set()
