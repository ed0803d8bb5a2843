"""A moving SMR over the bridge: every point comes once and in order, whatever the link does meanwhile."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.trackers import bridge_wire
from drivers.trackers.bridge import StreamingBridgeTracker
from drivers.trackers.bridge_server import TrackerService
from drivers.trackers.bridge_wire import BadField, TrackBuffer, read_limits, read_packet
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import (
    Packet,
    Point,
    Preparation,
    TargetLost,
    TrackerError,
    TrackerLinkLost,
    stream_of,
)
from tests.drivers.trackers.virtual_serial_cable import serial_cable

NEST = np.array([1.5, 2.0, -0.3])
INTERVAL_S = 0.001
CLOCK = Imperfections(clock_offset_s=80211.0, clock_rate=20e-6, packet_jitter_s=0.04)


@contextmanager
def client(url: str) -> Iterator[StreamingBridgeTracker]:
    tracker = StreamingBridgeTracker(url, timeout_s=2.0, preparation=Preparation())
    tracker.connect()
    try:
        yield tracker
    finally:
        tracker.disconnect()


@contextmanager
def bridged(make_plant: Any, errors: Imperfections = CLOCK, kind: str = "tcp") -> Iterator[Any]:
    plant = make_plant(noise=False)
    if kind == "tcp":
        with (
            TrackerBridgeEmulator(plant, imperfections=errors, nests={"nest": NEST}) as bridge,
            client(bridge.url) as tracker,
        ):
            yield plant, bridge, tracker
        return
    with serial_cable() as (ours, theirs):
        bridge = TrackerBridgeEmulator(plant, imperfections=errors, nests={"nest": NEST}, port=None, serial_url=theirs)
        with bridge, client(ours) as tracker:
            yield plant, bridge, tracker


def passes(plant: Any, tracker: StreamingBridgeTracker, seconds: float) -> None:
    """Let the plant's time pass while the client asks, as a monitor does."""
    for _ in range(round(seconds / 0.04)):
        plant.advance(0.04)
        tracker.confirm(1.0)


def asked(tracker: StreamingBridgeTracker) -> None:
    """Ask as a monitor does, until it fails."""
    deadline_s = time.monotonic() + 5.0
    while time.monotonic() < deadline_s:
        tracker.confirm(0.5)


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_all_points_come_in_order_with_the_stamps_of_the_tracker(make_plant: Any, kind: str) -> None:
    with bridged(make_plant, kind=kind) as (plant, bridge, tracker):
        assert stream_of(tracker) is not None
        seen: list[Packet] = []
        lost: list[TrackerError] = []
        tracker.start_track(NEST, INTERVAL_S, lost.append, seen.append)
        began_s = plant.clock_s
        passes(plant, tracker, 0.4)
        bridge.tracker.trigger()
        track = tracker.end_track()
    assert lost == []
    assert 390 <= len(track.p_M) <= 402
    wanted = CLOCK.own_time_s(began_s + INTERVAL_S * np.arange(len(track.p_M)))
    np.testing.assert_allclose(track.device_time_s, wanted, atol=2e-7)
    np.testing.assert_allclose(track.p_M, np.repeat(NEST[None], len(wanted), axis=0), atol=1e-8)
    assert np.isfinite(track.sigma_m).all()
    assert 5 <= len(seen) <= len(track.p_M) / 15
    assert len(track.triggers_s) == 1


def test_a_link_that_breaks_loses_no_point(make_plant: Any) -> None:
    with bridged(make_plant, Imperfections()) as (plant, bridge, tracker):
        tracker.start_track(NEST, INTERVAL_S, lambda error: None)
        passes(plant, tracker, 0.12)
        bridge.call_soon(lambda: [bridge._links.drop(one, "pulled", at_once=True) for one in [*bridge._links.links]])
        plant.advance(0.1)
        passes(plant, tracker, 0.12)
        track = tracker.end_track()
    np.testing.assert_allclose(np.diff(track.device_time_s), INTERVAL_S, atol=3e-7)
    assert len(track.p_M) >= 340


def test_a_lost_beam_is_told_after_the_last_point(make_plant: Any) -> None:
    with bridged(make_plant, Imperfections()) as (plant, bridge, tracker):
        lost: list[TrackerError] = []
        tracker.start_track(NEST, 0.01, lost.append)
        passes(plant, tracker, 0.2)
        bridge.tracker.covered.add("nest")
        passes(plant, tracker, 0.2)
        assert [type(error) for error in lost] == [TargetLost]
        tracker.confirm(1.0)  # the tracker itself answers now
        assert 15 <= len(tracker.end_track().p_M) <= 25
        with pytest.raises(TargetLost):
            tracker.start_track(NEST, 0.01, lost.append)
        bridge.tracker.covered.clear()
        tracker.start_track(NEST, 0.01, lost.append)
        assert isinstance(tracker.measure(NEST, 0.1), Point)


def test_a_restarted_bridge_has_lost_the_track(make_plant: Any) -> None:
    with bridged(make_plant, Imperfections()) as (plant, bridge, tracker):
        tracker.start_track(NEST, 0.01, lambda error: None)
        passes(plant, tracker, 0.08)
        bridge.call_soon(bridge.restart)
        with pytest.raises(TrackerLinkLost, match=r"no such track|tracker bridge"):
            asked(tracker)
        with pytest.raises(TrackerLinkLost, match="no such track"):
            tracker.end_track()


class Resting:
    """A tracker whose driver measures at rest only."""

    def connect(self) -> None: ...
    def disconnect(self) -> None: ...
    def halt(self) -> None: ...
    def prepare(self, settings: object) -> None: ...
    def data_age_s(self) -> float:
        return 0.0


def test_a_tracker_without_a_stream_says_so_and_an_old_bridge_too() -> None:
    with TrackerService(Resting()) as service, client(service.url) as tracker:  # type: ignore[arg-type]
        assert tracker.stream_limits() is None
        assert stream_of(tracker) is None
        with pytest.raises(TrackerError, match="does not measure an SMR while it moves"):
            tracker.start_track(NEST, 0.01, lambda error: None)
    old = TrackerService(Resting())  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drivers.trackers.bridge_server._COMMANDS", ("prepare",))
        with old, client(old.url) as tracker:
            assert stream_of(tracker) is None


def test_rates_out_of_range_are_refused_before_anything_is_sent(make_plant: Any) -> None:
    with bridged(make_plant) as (_, _, tracker):
        for wrong in (1e-4, 5.0, np.nan):
            with pytest.raises(ValueError, match=r"one each 0\.001 to 1 s"):
                tracker.start_track(NEST, wrong, lambda error: None)


def test_a_client_that_is_too_slow_loses_points_and_the_stamps_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_wire, "MOST_WAITING", 50)
    buffer = TrackBuffer("track-0001")
    for k in range(10):
        stamps = k + 0.1 * np.arange(10.0)
        buffer.received(Packet(stamps, np.zeros((10, 3)), np.full(10, np.nan), 0.0))
    found, number = [], 0
    while (packet := read_packet(buffer.fields(number), 0.0)[0]).device_time_s.size:
        found.append(packet.device_time_s)
        number += 1
    assert len(np.concatenate(found)) == 50
    with pytest.raises(BadField, match="the next line is 5"):
        buffer.fields(3)


@pytest.mark.parametrize(
    "fields",
    [
        {"points": "1,2,3", "age": "0", "waiting": "0"},
        {"points": "1,2,3,4,x", "age": "0", "waiting": "0"},
        {"points": "1.2.3,2,3,4,", "age": "0", "waiting": "0"},
        {"points": "1,2,3,4,", "waiting": "0"},
        {"points": "", "waiting": "-1"},
        {"points": "", "waiting": "0", "pulses": "soon"},
    ],
)
def test_damaged_points_are_refused(fields: dict[str, str]) -> None:
    with pytest.raises(BadField):
        read_packet(fields, 0.0)
    with pytest.raises(BadField):
        read_limits(fields)
