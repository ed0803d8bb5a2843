"""Whether the tracker behind a bridge answers now: the bridge does not answer for it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
import pytest

from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.bridge_links import Link
from drivers.trackers.bridge_server import Reply, TrackerService
from drivers.trackers.bridge_wire import Line
from drivers.trackers.protocol import Point, Preparation, Tracker, TrackerLinkLost, TrackerTimeout
from tests.drivers.trackers.virtual_serial_cable import serial_cable
from tests.latency import attempts

WITHIN_S = 0.3
LATEST_S = 0.8
"""A bound for ``WITHIN_S``, with the time that a machine needs."""
PATIENT_S = 20.0
"""Where an answer comes: a busy machine may be late."""
NEST = np.array([1.5, 2.0, -0.3])


class Behind:
    """The tracker behind the bridge: it may hang, lose its link, and takes its time to measure."""

    def __init__(self) -> None:
        self.goes_on, self.measures, self.may_end = threading.Event(), threading.Event(), threading.Event()
        self.goes_on.set()
        self.lost = False
        self.asked = self.connected = 0
        self.sign_s = -math.inf

    def connect(self) -> None:
        self.connected += 1

    def disconnect(self) -> None: ...

    def halt(self) -> None: ...

    def prepare(self, settings: object) -> None: ...

    def unmet(self) -> list[str]:
        self.confirm(1.0)
        return ["its laser is off"]

    def confirm(self, within_s: float) -> None:
        self.asked += 1
        assert self.goes_on.wait(20.0)
        if self.lost:
            raise TrackerLinkLost("tracker: unplugged")

    def data_age_s(self) -> float:
        return time.monotonic() - self.sign_s

    def measure(self, expected_M: Any, averaging_s: float) -> Point:
        self.measures.set()
        assert self.may_end.wait(20.0)
        return Point(NEST, np.eye(3) * 1e-10, 5.0, 1.0, None)


class Service(TrackerService):
    """A bridge whose next answers are spoilt by ``spoil``, and that may be older than ``confirm``."""

    spoil: Callable[[Service, Link, int], None] | None = None
    old = False

    def _deliver(self, link: Link, sequence: int, reply: Reply) -> None:
        spoil, self.spoil = self.spoil, None
        if spoil is None:
            super()._deliver(link, sequence, reply)
        else:
            spoil(self, link, sequence)

    def _dispatch(self, link: Link, line: Line) -> None:
        if self.old and line.word == "confirm":
            self._error(link, line.sequence, "unknown-command", "unknown command 'confirm'")
        else:
            super()._dispatch(link, line)


def garbled(service: Service, link: Link, sequence: int) -> None:
    service._links.send(link, b"%d oj*12345678\n" % sequence)


def dropped(service: Service, link: Link, sequence: int) -> None:
    service._links.drop(link, "a test cuts it", at_once=True)


def restarted(service: Service, link: Link, sequence: int) -> None:
    service.restart()


@contextmanager
def bridged(kind: str = "tcp") -> Iterator[tuple[Behind, Service, BridgeTracker]]:
    behind = Behind()
    as_tracker = cast(Tracker, behind)
    with serial_cable() as (theirs, ours):
        served = {"port": None, "serial_url": theirs} if kind == "serial" else {}
        with Service(as_tracker, **served) as service:  # type: ignore[arg-type]
            tracker = BridgeTracker(ours if kind == "serial" else service.url)
            tracker.connect()
            try:
                yield behind, service, tracker
            finally:
                behind.goes_on.set()
                behind.may_end.set()
                tracker.disconnect()


def lost(tracker: BridgeTracker, words: str, within_s: float = WITHIN_S) -> float:
    began_s = time.monotonic()
    with pytest.raises(TrackerLinkLost, match=words):
        tracker.confirm(within_s)
    return time.monotonic() - began_s


def assert_at_once(tracker: BridgeTracker, words: str) -> None:
    """Assert that the loss is reported long before patience ends."""
    assert lost(tracker, words, PATIENT_S) < 0.5 * PATIENT_S


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_the_tracker_is_asked_each_time(kind: str) -> None:
    with bridged(kind) as (behind, _, tracker):
        assert tracker.data_age_s() == math.inf  # the bridge has answered, the tracker has not
        for n in range(1, 21):
            asked_s = time.monotonic()
            tracker.confirm(PATIENT_S)
            assert behind.asked == n
            assert tracker.data_age_s() <= time.monotonic() - asked_s


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_tracker_that_hangs_behind_a_living_bridge_is_dead_and_may_come_back(kind: str) -> None:
    with bridged(kind) as (behind, _, tracker):
        for took in attempts(known=LATEST_S):
            recovered(tracker)
            behind.goes_on.clear()
            took["known"] = lost(tracker, "no answer from the tracker within 0.3 s")
            assert took["known"] >= WITHIN_S
            behind.goes_on.set()
        recovered(tracker)
        behind.goes_on.clear()
        lost(tracker, "no answer from the tracker within 0.3 s")
        with pytest.raises(TrackerTimeout, match="the tracker is at work on a 'confirm'"):
            tracker.confirm(WITHIN_S)
        assert tracker.data_age_s() > WITHIN_S
        behind.goes_on.set()
        recovered(tracker)


def recovered(tracker: BridgeTracker) -> None:
    """Ask until the tracker has done with an earlier question."""
    until_s = time.monotonic() + PATIENT_S
    while True:
        try:
            tracker.confirm(PATIENT_S)
            return
        except TrackerTimeout:
            assert time.monotonic() < until_s
            threading.Event().wait(0.01)


def test_a_tracker_without_a_link_is_reported_at_once_and_connected_again_at_the_next_question() -> None:
    with bridged() as (behind, _, tracker):
        tracker.confirm(PATIENT_S)
        behind.lost = True
        assert_at_once(tracker, "^tracker: unplugged$")
        behind.lost = False
        tracker.confirm(PATIENT_S)
        assert behind.connected == 2


def test_a_refused_connection_is_reported_at_once_and_repeated_commands_still_recover() -> None:
    with bridged() as (behind, service, tracker):
        tracker.confirm(PATIENT_S)
        service.close()
        assert_at_once(tracker, "see that the tracker's computer runs 'cellapp tracker-bridge'")
        assert_at_once(tracker, "[Rr]efused")
        with Service(cast(Tracker, behind), port=service.port):
            tracker.confirm(PATIENT_S)
            assert tracker.unmet() == ["its laser is off"]


@pytest.mark.parametrize(
    ("kind", "spoil"),
    [("tcp", garbled), ("tcp", dropped), ("tcp", restarted), ("serial", garbled)],
)
def test_a_link_that_is_back_at_once_is_no_death(kind: str, spoil: Callable[[Service, Link, int], None]) -> None:
    with bridged(kind) as (behind, service, tracker):
        for n in range(1, 6):
            service.spoil = spoil
            tracker.confirm(PATIENT_S)
            assert behind.asked == 2 * n


def test_a_link_that_ends_again_and_again_is_one() -> None:
    class Closing(Service):
        def _dispatch(self, link: Link, line: Line) -> None:
            dropped(self, link, line.sequence)

    with bridged() as (behind, service, tracker):
        service.close()
        with Closing(cast(Tracker, behind), port=service.port):
            assert_at_once(tracker, "the link broke")


def test_a_bridge_of_before_is_asked_what_measuring_lacks() -> None:
    with bridged() as (behind, service, tracker):
        service.old = True
        for n in range(1, 4):
            tracker.confirm(PATIENT_S)
            assert behind.asked == n
        behind.goes_on.clear()
        assert WITHIN_S <= lost(tracker, "no answer from the tracker") < 0.5 * PATIENT_S


def test_while_it_measures_the_age_is_the_trackers_and_not_the_bridges() -> None:
    with bridged() as (behind, _, tracker):
        for took in attempts(age=LATEST_S, end=LATEST_S):
            behind.measures.clear()
            behind.may_end.clear()
            behind.sign_s = time.monotonic()
            tracker.prepare(Preparation())
            measuring = threading.Thread(target=lambda: tracker.measure(NEST, 1.0), daemon=True)
            measuring.start()
            assert behind.measures.wait(PATIENT_S)
            alive_until_s = time.monotonic() + LATEST_S
            took["age"] = 0.0
            while time.monotonic() < alive_until_s:
                behind.sign_s = time.monotonic()
                took["age"] = max(took["age"], tracker.data_age_s())
                threading.Event().wait(0.01)
            began_s = time.monotonic()  # from now on it hangs, and the bridge goes on to send its lines
            threading.Event().wait(0.8)
            assert tracker.data_age_s() > 0.75 * (time.monotonic() - began_s)
            behind.may_end.set()
            measuring.join(PATIENT_S)
            took["end"] = tracker.data_age_s()
