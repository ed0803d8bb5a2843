"""The bridge from end to end, over TCP and a serial cable: every measurement is delivered exactly once."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

import numpy as np
import pytest

from drivers.arms.simulated import SimulatedArm
from drivers.emulators.tracker_bridge import FAULTS, TrackerBridgeEmulator
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.bridge_links import Link
from drivers.trackers.bridge_server import Reply, TrackerService
from drivers.trackers.bridge_wire import WireLine
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.lmf import LmfTracker
from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.protocol import (
    Halted,
    NotReady,
    Point,
    Preparation,
    TargetLost,
    Tracker,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TrackerTimeout,
    Unstable,
    WrongTarget,
)
from drivers.trackers.simulated import SimulatedTracker
from tests.at_once import all_at_once, in_parallel
from tests.drivers.trackers import bridged
from tests.drivers.trackers.bridged import NEST, serial_cable
from tests.drivers.trackers.fake_lmf import Scene
from tests.latency import attempts
from tests.sure import sure

TOKEN = "correct horse battery staple"
QUICK_S = 0.6
QUICKLY: dict[str, float] = {"reboot_s": 0.2, "slow_s": 1.5 * QUICK_S}
client = partial(bridged.client, timeout_s=QUICK_S)


def over(kind, plant, **options):
    """An emulated bridge and a client that soon gives up."""
    return bridged.over(kind, plant, QUICK_S if kind == "tcp" else 1.0, **(QUICKLY | options))


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_the_bridge_returns_the_trackers_own_results(kind, make_plant):
    def all_of(tracker, plant):
        smr = plant.targets()[0].p_M
        tracker.prepare(Preparation(temperature_c=25.0))
        return [tracker.measure(smr, 1.0), tracker.measure(NEST, 0.5)]

    wrong = Imperfections(warm_up_rad=(2e-5, 0.0, 1e-5), warm_up_m=1e-5)
    direct_plant, plant = make_plant(noise=True), make_plant(noise=True)
    direct = SimulatedTracker(direct_plant, wrong, nests={"n": NEST})
    direct.connect()
    with over(kind, plant, imperfections=wrong) as (_, tracker):
        assert tracker.identify() == direct.identify()
        assert tracker.unmet() == []
        for one, other in zip(all_of(direct, direct_plant), all_of(tracker, plant), strict=True):
            for name in ("p_M", "covariance_M"):
                assert np.array_equal(getattr(one, name), getattr(other, name)), name
            rest = set(one.__dataclass_fields__) - {"p_M", "covariance_M"}
            assert {name: getattr(one, name) for name in rest} == {name: getattr(other, name) for name in rest}
    assert plant.clock_s == direct_plant.clock_s


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_fault_neither_loses_nor_doubles_a_measurement(kind, make_plant):
    in_parallel(fault_is_survived, [(kind, fault, make_plant) for fault in FAULTS])


def fault_is_survived(kind, fault, make_plant):
    with over(kind, make_plant(noise=True)) as (bridge, tracker):
        before = tracker.measure(NEST, 1.0)
        bridge.fault(fault)
        if fault == "beam":
            with pytest.raises(TargetLost, match="that of nest n is there, but something covers it"):
                tracker.measure(NEST, 1.0)
        point = tracker.measure(NEST, 1.0)
        after = tracker.measure(NEST, 1.0)
        assert before.time_s < point.time_s < after.time_s
        assert np.abs(point.p_M - NEST).max() < 1e-3
        # only a restarted bridge, which has lost its results, measures again
        assert bridge.tracker.measured == (4 if fault == "reboot" else 3)
        assert tracker.unmet() == []


def test_errors_of_the_tracker_keep_their_class(make_arm, make_plant):
    plant = make_plant(make_arm(), make_arm("ur5", "right", 1.2))
    with over("tcp", plant, wrong_target_m=0.02) as (bridge, tracker):
        with pytest.raises(TargetLost, match="no SMR within 100 mm"):
            tracker.measure(NEST + 1.0, 1.0)
        with pytest.raises(WrongTarget, match="50 mm from where one was expected"):
            tracker.measure(NEST + np.array([0.0, 0.0, 0.05]), 1.0)
        arm = SimulatedArm(plant, "left")
        arm.connect()
        arm.start_move(np.array([0, 0, 0, 0, 0, 3.0]), np.full(6, 1.0), np.full(6, 2.0))
        with pytest.raises(Unstable, match="the SMR of arm left moved"):
            tracker.measure(plant.targets()[0].p_M, 1.0)
        arm.wait_settled(10.0)
        bridge.tracker.obstacles.append("it is not level: 3 % too much")
        assert tracker.unmet() == ["it is not level: 3 % too much"]
        with pytest.raises(NotReady, match="it is not level: 3 % too much"):
            tracker.measure(NEST, 1.0)
        bridge.tracker.obstacles.clear()
        for point, averaging in ((np.ones(2), 1.0), (np.array([1.0, np.nan, 0.0]), 1.0)):
            with pytest.raises(ValueError, match="three finite coordinates"):
                tracker.measure(point, averaging)
        for averaging in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ValueError, match="averaging must last longer than 0 s"):
                tracker.measure(NEST, averaging)
        assert tracker.measure(NEST, 1.0).p_M == pytest.approx(NEST)


def test_a_setting_that_the_tracker_does_not_have_is_refused(make_plant):
    with TrackerBridgeEmulator(make_plant()) as bridge:
        tracker = BridgeTracker(bridge.url, timeout_s=QUICK_S, preparation=Preparation(reflector="SMR 0.5 in"))
        with pytest.raises(NotReady, match=r"no reflector 'SMR 0.5 in'; it has 'simulated 1.5 in'.* in the profile"):
            tracker.connect()
        with client(bridge.url) as other:  # the tracker is free again
            with pytest.raises(ValueError, match="no reflector"):
                other.prepare(Preparation(reflector="SMR 0.5 in"))
            other.prepare(Preparation(reflector="simulated 1.5 in"))


def test_one_client_at_a_time(make_plant):
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}) as bridge:
        with client(bridge.url) as first:
            for _ in range(3):
                with pytest.raises(TrackerRefused, match=r"held by 127\.0\.0\.1:\d+, which was last heard \d+ s"):
                    BridgeTracker(bridge.url, timeout_s=QUICK_S).connect()
            first.measure(NEST, 1.0)
        with client(bridge.url) as second:
            second.measure(NEST, 1.0)
            with pytest.raises(TrackerLinkLost, match="connect first"):
                first.measure(NEST, 1.0)


def a_silent_client_loses_the_tracker_to_another(make_plant):
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}, idle_s=0.0) as bridge, client(bridge.url) as first:
        first.measure(NEST, 1.0)
        threading.Event().wait(0.05)
        with client(bridge.url, preparation=Preparation(temperature_c=30.0)) as second:
            assert second.measure(NEST, 1.0).temperature_c == 30.0
        # what the other one set up does not stay
        assert first.measure(NEST, 1.0).temperature_c == pytest.approx(20.0, abs=0.6)


def test_the_token_lets_in_and_keeps_out(make_plant, caplog):
    caplog.set_level("DEBUG")
    in_parallel(token_lets_in_and_keeps_out, [(kind, make_plant) for kind in ("tcp", "serial")])
    for peer in (r"127\.0\.0\.1:\d+", "the serial port"):
        assert re.search(f"{peer}: refused: it does not know the token", caplog.text), peer
    assert "horse" not in caplog.text


def token_lets_in_and_keeps_out(kind, make_plant):
    with serial_cable() as (theirs, ours):
        serial_end: dict[str, Any] = {"port": None, "serial_url": theirs} if kind == "serial" else {}
        with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}, token=TOKEN, **serial_end) as bridge:
            url = ours if kind == "serial" else bridge.url
            with pytest.raises(TrackerRefused, match="it asks for a token; name it in the profile"):
                BridgeTracker(url, timeout_s=QUICK_S).connect()
            with pytest.raises(TrackerRefused, match="the token is wrong"):
                BridgeTracker(url, timeout_s=QUICK_S, token="wrong horse battery staple").connect()
            with client(url, token=TOKEN, timeout_s=1.0) as tracker:
                assert tracker.measure(NEST, 1.0).p_M == pytest.approx(NEST)
                bridge.fault("reboot")
                assert tracker.measure(NEST, 1.0).p_M == pytest.approx(NEST)


def test_a_bridge_that_does_not_know_the_token_is_not_trusted(make_plant):
    with TrackerBridgeEmulator(make_plant()) as bridge:
        tracker = BridgeTracker(bridge.url, timeout_s=QUICK_S, token=TOKEN)
        with pytest.raises(TrackerRefused, match="the bridge asks for none"):
            tracker.connect()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"host": "0.0.0.0"}, "0.0.0.0 is not a loopback address: .* Give the bridge a token"),
        ({"host": "::"}, "not a loopback address"),
        ({"host": "tracker-pc"}, "not a loopback address"),
        ({"token": "too short"}, "at least 16 printable ASCII characters"),
        ({"token": "with a\ttabulator in it"}, "at least 16 printable ASCII characters"),
    ],
)
def test_addresses_beyond_loopback_need_a_good_token(options, why, make_plant):
    with pytest.raises(ValueError, match=why):
        TrackerBridgeEmulator(make_plant(), **options)


def test_no_bridge_at_the_address(make_plant):
    with TrackerBridgeEmulator(make_plant()) as bridge:
        url = bridge.url
    tracker = BridgeTracker(url, timeout_s=QUICK_S)
    with pytest.raises(TrackerLinkLost, match=r"[Rr]efused.*; see that the tracker's computer runs"):
        tracker.connect()
    with pytest.raises(TrackerLinkLost, match="connect first"):
        tracker.unmet()
    tracker.disconnect()
    tracker.halt()
    for url in ("nonsense://here", "/dev/no-such-port"):
        with pytest.raises(TrackerLinkLost):
            BridgeTracker(url, timeout_s=QUICK_S).connect()


def a_bridge_that_goes_for_good_ends_the_measurement_in_time(make_plant):
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}) as bridge:
        tracker = BridgeTracker(bridge.url, timeout_s=QUICK_S, preparation=Preparation(), patience_s=1.0)
        tracker.connect()
    with pytest.raises(TrackerLinkLost, match="see that the tracker's computer runs"):
        tracker.measure(NEST, 1.0)
    tracker.disconnect()


# -- a slow tracker ---------------------------------------------------------------------------------------------------


class HeldTracker:
    """A tracker that answers when the test allows it: it may hang, lose its link, and takes its time to measure."""

    def __init__(self):
        self.goes_on, self.begun, self.may_end, self.halted = (threading.Event() for _ in range(4))
        self.goes_on.set()
        self.lost = False
        self.asked = self.connected = self.calls = 0
        self.threads = set()

    def connect(self):
        self.threads.add(threading.get_ident())
        self.connected += 1

    def identify(self):
        return TrackerIdentity("slow", "1", "0")

    def prepare(self, settings):
        self.threads.add(threading.get_ident())

    def unmet(self):
        return []

    def measure(self, expected_M, averaging_s):
        self.threads.add(threading.get_ident())
        self.calls += 1
        self.begun.set()
        for _ in range(400):
            if self.may_end.wait(0.05):
                return Point(np.array(expected_M), np.eye(3) * 1e-10, 5.0, 1.0, None)
            if self.halted.is_set():
                raise Halted("slow: a halt was requested")
        raise AssertionError("the test did not end the measurement")

    def confirm(self, within_s):
        self.asked += 1
        assert self.goes_on.wait(PATIENT_S)
        if self.lost:
            raise TrackerLinkLost("tracker: unplugged")

    def data_age_s(self):
        return math.inf

    def halt(self):
        self.halted.set()

    def disconnect(self):
        self.threads.add(threading.get_ident())


def in_thread(act):
    """Start ``act`` in a thread; return a function that waits for its result or error."""
    outcome = []

    def run():
        try:
            outcome.append(act())
        except TrackerError as error:
            outcome.append(error)

    thread = threading.Thread(target=run)
    thread.start()

    def wait():
        thread.join(20.0)
        assert not thread.is_alive()
        return outcome[0]

    return wait


def a_slow_tracker_is_waited_for_longer_than_the_link_may_be_silent():
    slow = HeldTracker()
    with TrackerService(slow) as bridge, client(bridge.url, timeout_s=1.5) as tracker:
        outcome = in_thread(lambda: tracker.measure(NEST, 1.0))
        assert slow.begun.wait(PATIENT_S)
        threading.Timer(1.7, slow.may_end.set).start()
        assert outcome().p_M == pytest.approx(NEST)
    assert slow.calls == 1
    assert len(slow.threads) == 1


def halt_ends_the_running_measurement():
    slow = HeldTracker()
    with TrackerService(slow) as bridge, client(bridge.url, timeout_s=2.0) as tracker:
        outcome = in_thread(lambda: tracker.measure(NEST, 1.0))
        assert slow.begun.wait(PATIENT_S)
        tracker.halt()
        assert isinstance(outcome(), Halted)
        slow.may_end.set()
        assert tracker.measure(NEST, 1.0).time_s == 5.0  # the halt does not affect the next measurement


def a_client_that_reconnects_gets_the_running_measurement():
    slow = HeldTracker()
    with TrackerService(slow) as bridge, client(bridge.url) as tracker:
        outcome = in_thread(lambda: tracker.measure(NEST, 1.0))
        assert slow.begun.wait(PATIENT_S)
        dropped = threading.Event()

        def drop():
            bridge._links.drop(sure(bridge._holder), "a test cuts the link", at_once=True)
            dropped.set()

        bridge.call_soon(drop)
        assert dropped.wait(PATIENT_S)
        threading.Timer(1.0, slow.may_end.set).start()
        assert outcome().p_M == pytest.approx(NEST)
    assert slow.calls == 1


def a_tracker_that_never_ends_is_halted_and_the_client_gets_a_timeout():
    slow = HeldTracker()
    with TrackerService(slow, command_s=0.3, recover_s=0.0) as bridge, client(bridge.url) as tracker:
        with pytest.raises(TrackerTimeout, match=r"did not finish 'measure' within 0\.3 s; a halt was requested"):
            tracker.measure(NEST, 1.0)
        assert slow.halted.is_set()
        assert tracker.identify().model == "slow"


def test_a_defect_in_a_driver_does_not_end_the_bridge():
    class Broken(HeldTracker):
        def measure(self, expected_M, averaging_s):
            raise KeyError("a mistake")

    with TrackerService(Broken()) as bridge, client(bridge.url) as tracker:
        for _ in range(2):
            with pytest.raises(TrackerError, match="the tracker's driver broke down; see the bridge's log"):
                tracker.measure(NEST, 1.0)
        assert tracker.identify().model == "slow"


def a_tracker_that_cannot_be_reached_is_reported():
    class Away(HeldTracker):
        def connect(self):
            raise TrackerLinkLost("no tracker at 192.168.0.1")

    with TrackerService(Away(), recover_s=0.3) as bridge:
        tracker = BridgeTracker(bridge.url, timeout_s=QUICK_S, preparation=Preparation())
        with pytest.raises(TrackerLinkLost, match=r"no tracker at 192\.168\.0\.1"):
            tracker.connect()


def test_a_leica_tracker_is_served():
    scene = Scene(targets={"left": NEST, "right": NEST + 1.0}, initialised=False)
    lmf = LmfTracker(LmfSettings(address="192.168.0.1"), load=lambda library: scene.lmf())
    with TrackerService(lmf) as bridge, client(bridge.url, timeout_s=2.0) as tracker:
        assert tracker.identify().model.startswith("AT960")
        assert tracker.unmet() == []  # it was initialised when the client connected
        assert tracker.measure(NEST, 1.0).p_M == pytest.approx(NEST, abs=1e-3)
        with pytest.raises(TargetLost):
            tracker.measure(NEST - 1.0, 1.0)
    scene.release.set()
    assert scene.violations == []


# -- a plant with a shared clock ---------------------------------------------------------------------------------------


def test_what_waits_for_the_other_side(make_plant):
    """Each has a bridge of its own; they wait at the same time."""
    all_at_once(
        [
            a_slow_tracker_is_waited_for_longer_than_the_link_may_be_silent,
            halt_ends_the_running_measurement,
            a_client_that_reconnects_gets_the_running_measurement,
            a_tracker_that_never_ends_is_halted_and_the_client_gets_a_timeout,
            a_tracker_that_cannot_be_reached_is_reported,
            partial(a_silent_client_loses_the_tracker_to_another, make_plant),
            partial(a_bridge_that_goes_for_good_ends_the_measurement_in_time, make_plant),
        ]
    )


# -- Whether the tracker behind a bridge answers now: the bridge does not answer for it --------------------------------

WITHIN_S = 0.3
LATEST_S = 0.8
"""A bound for ``WITHIN_S``, with the time that a machine needs."""
PATIENT_S = 20.0
"""Where an answer comes: a busy machine may be late."""


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

    def _dispatch(self, link: Link, line: WireLine) -> None:
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
def held(kind: str = "tcp") -> Iterator[tuple[HeldTracker, Service, BridgeTracker]]:
    behind = HeldTracker()
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
    with held(kind) as (behind, _, tracker):
        assert tracker.data_age_s() == math.inf  # the bridge has answered, the tracker has not
        for n in range(1, 21):
            asked_s = time.monotonic()
            tracker.confirm(PATIENT_S)
            assert behind.asked == n
            assert tracker.data_age_s() <= time.monotonic() - asked_s


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_tracker_that_hangs_behind_a_living_bridge_is_dead_and_may_come_back(kind: str) -> None:
    with held(kind) as (behind, _, tracker):
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
    with held() as (behind, _, tracker):
        tracker.confirm(PATIENT_S)
        behind.lost = True
        assert_at_once(tracker, "^tracker: unplugged$")
        behind.lost = False
        tracker.confirm(PATIENT_S)
        assert behind.connected == 2


@pytest.mark.parametrize(
    ("kind", "spoil"), [("tcp", garbled), ("tcp", dropped), ("tcp", restarted), ("serial", garbled)]
)
def test_a_link_that_is_back_at_once_is_no_death(kind: str, spoil: Callable[[Service, Link, int], None]) -> None:
    with held(kind) as (behind, service, tracker):
        for n in range(1, 6):
            service.spoil = spoil
            tracker.confirm(PATIENT_S)
            assert behind.asked == 2 * n
