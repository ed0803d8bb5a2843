"""Lines of the bridge protocol: values are transmitted bit for bit, damaged lines are refused."""

from __future__ import annotations

import math
import random
import re
import socket
import struct
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.emulators.tracker_bridge import FAULTS, TrackerBridgeEmulator
from drivers.plant import Plant, PlantConfig, TrackerConfig
from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.bridge_server import TrackerService
from drivers.trackers.bridge_wire import BadField, Garbled, read_limits, read_packet
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import (
    Halted,
    NotReady,
    Point,
    Preparation,
    TargetLost,
    Track,
    TrackerError,
    TrackerLinkLost,
    TrackerRefused,
    stream_of,
)
from tests.approved import assert_refused
from tests.drivers.trackers.bridged import NEST, client, over
from tests.sure import sure
from tests.waiting import until, within

DOCUMENT = Path(wire.__file__).with_name("BRIDGE.md")

finite = st.floats(-100, 100)
spread = st.floats(0, 1e-3)
texts = st.text(st.characters(codec="utf-8"), max_size=80)


@st.composite
def points(draw):
    given_air = st.none() | st.floats(0, 90)
    spreads = np.array([draw(spread) for _ in range(6)])
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = spreads
    return Point(
        p_M=np.array([draw(finite) for _ in range(3)]),
        covariance_M=np.maximum(covariance, covariance.T),
        time_s=draw(st.floats(-1e9, 1e9)),
        averaging_s=draw(st.floats(1e-3, 600)),
        temperature_c=draw(given_air),
        pressure_hpa=draw(given_air),
        humidity_percent=draw(given_air),
        reflector=draw(st.sampled_from(["", "RRR 1.5 in", "0,5° Ø*"])),
        quality=draw(st.sampled_from([(), ("a warning",), ("one", "100 % humid = wet")])),
    )


def same_point(one: Point, other: Point) -> bool:
    arrays = ("p_M", "covariance_M")
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        if name in arrays and getattr(one, name) is not None
        else getattr(one, name) == getattr(other, name)
        for name in Point.__dataclass_fields__
    )


def over_the_wire(fields):
    return wire.decode(wire.encode(7, "ok", fields)).fields


@given(points())
def test_points_arrive_bit_for_bit(one):
    assert same_point(wire.read_point(over_the_wire(wire.point_fields(one))), one)


keys = st.from_regex(r"[a-z][a-z0-9._]{0,9}", fullmatch=True)


@given(st.integers(0, wire.LAST_SEQUENCE), st.dictionaries(keys, texts))
def test_any_text_fits_a_field(sequence, fields):
    fields = {key: wire.text(value, 60) for key, value in fields.items()}
    assume(sum(len(key) + 62 for key in fields) < wire.LONGEST_LINE - 50)
    line = wire.encode(sequence, "ok", fields)
    assert re.fullmatch(rb"[\x20-\x7e]+\n", line)
    found = wire.decode(line)
    assert (found.sequence, found.word, found.fields) == (sequence, "ok", fields)


GOOD = wire.encode(42, "measure", {"id": "0123456789abcdef", "x": "1.5", "y": "-2.25", "z": "0.1", "averaging": "1.0"})


@given(st.integers(0, len(GOOD) - 2), st.integers(1, 255), st.booleans(), st.booleans())
def test_a_damaged_line_is_no_line(place, change, cut, insert):
    damaged = bytearray(GOOD)
    if cut:
        del damaged[place:]
    elif insert:
        damaged.insert(place, change)
    else:
        damaged[place] ^= change
    assume(bytes(damaged).rstrip(b"\r\n").upper() != GOOD.rstrip(b"\n").upper())  # CRC digits may be of either case
    with pytest.raises(Garbled):
        wire.decode(bytes(damaged))


def test_a_whole_line_must_also_be_well_formed_as_approved():
    def refused(line: str) -> object:
        body = line.encode("latin-1")
        return wire.decode(b"%s*%08X\n" % (body, zlib.crc32(body)))

    assert_refused(Path(__file__).parent / "approved" / "no-lines.txt", refused)


def test_a_line_that_is_too_long_is_never_written():
    with pytest.raises(ValueError, match="not a line of the bridge protocol"):
        wire.encode(1, "ok", {"a": "x" * 2048})
    with pytest.raises(ValueError, match="not a line of the bridge protocol"):
        wire.encode(1, "Not A Word", {})


@pytest.mark.parametrize("value", ["", "nan", "inf", "1e999", "1_000", "0x10", " 1", "1,5", "--1", "1e", "9" * 40])
def test_invalid_numbers_are_refused(value):
    with pytest.raises(BadField, match="expected a number"):
        wire.read_number({"x": value}, "x", -10, 10)


def test_fields_that_are_missing_or_out_of_range_are_named():
    fields = dict(wire.point_fields(Point(np.ones(3), np.eye(3) * 1e-10, 1.0, 1.0, 20.0)))
    for change, why in (
        ({"x": "1e4"}, "x is '1e4'"),
        ({"cxx": "-1e-12"}, "cxx is '-1e-12'"),
        ({"averaging": "-1"}, "averaging is '-1'"),
        ({"humidity": "101"}, "humidity is '101'"),
    ):
        with pytest.raises(BadField, match=re.escape(why)):
            wire.read_point(fields | change)
    for missing in ("z", "cyz", "time"):
        with pytest.raises(BadField, match=f"'{missing}' is missing"):
            wire.read_point({key: value for key, value in fields.items() if key != missing})
    with pytest.raises(BadField, match="not a finite number"):
        wire.point_fields(Point(np.array([1.0, np.nan, 0.0]), np.eye(3), 1.0, 1.0, None))
    with pytest.raises(BadField, match="8 to 64 letters and digits"):
        wire.read_id({"id": "a b"})


def test_errors_keep_their_kind():
    class OfADriver(TrackerError):
        pass

    class OfATarget(TargetLost):
        pass

    for error, kind in (
        (NotReady("a"), "not-ready"),
        (TargetLost("b"), "target-lost"),
        (OfADriver("c"), "failed"),
        (OfATarget("e"), "target-lost"),
        (ValueError("d"), "bad-field"),
    ):
        assert wire.error_fields(error) == {"kind": kind, "text": str(error)}
    for kind, raised in wire.ERRORS.items():
        if kind not in ("held", "version"):
            assert wire.error_fields(raised(""))["kind"] == kind


def test_a_proof_needs_the_token_and_both_nonces():
    proofs = {
        wire.proof(token, side, client, one, two)
        for token in ("a" * 16, "b" * 16)
        for side in ("client", "server")
        for client in ("client-1", "client-2")
        for one in ("n1", "n2")
        for two in ("m1", "m2")
    }
    assert len(proofs) == 32
    assert all(wire.proofs_equal(proof, proof.upper()) for proof in proofs)
    assert not wire.proofs_equal("", proofs.pop())
    assert not wire.proofs_equal("\xe9", "e")


def test_the_proofs_in_the_document_are_right():
    document = DOCUMENT.read_text("utf-8")
    (token,) = re.findall(r"with the token `([^`]+)`", document)
    lines = re.findall(r"^    [<>] (.*\*[0-9A-F]{8})$", document, flags=re.MULTILINE)
    said = [wire.decode(line.encode("ascii")) for line in lines]
    assert {"hello", "sync", "auth", "prepare", "measure", "wait", "ok", "error", "bye"} <= {one.word for one in said}
    hello = next(line for line in said if line.word == "hello")
    challenge = next(line for line in said if line.fields.get("auth") == "hmac-sha256")
    auth = next(line for line in said if line.word == "auth")
    answer = next(line for line in said if line.word == "ok" and "proof" in line.fields)
    nonces = hello.fields["client"], challenge.fields["nonce"], auth.fields["nonce"]
    assert wire.proofs_equal(auth.fields["proof"], wire.proof(token, "client", *nonces))
    assert wire.proofs_equal(answer.fields["proof"], wire.proof(token, "server", *nonces))


# -- A moving SMR over the bridge: every point comes once and in order, whatever the link does meanwhile ---------------

INTERVAL_S = 0.001
CLOCK = Imperfections(clock_offset_s=80211.0, clock_rate=20e-6, packet_jitter_s=0.04)


@contextmanager
def bridged(make_plant: Any, errors: Imperfections = CLOCK, kind: str = "tcp") -> Iterator[Any]:
    plant = make_plant(noise=False)
    with over(kind, plant, 2.0, imperfections=errors) as (bridge, tracker):
        yield plant, bridge, tracker


def passes(plant: Any, tracker: BridgeTracker, seconds: float) -> None:
    """Let the plant's time pass while the client asks, as a monitor does."""
    for _ in range(round(seconds / 0.04)):
        plant.advance(0.04)
        tracker.confirm(1.0)


def asked(tracker: BridgeTracker) -> None:
    """Ask as a monitor does, until it fails."""
    until(lambda: tracker.confirm(0.5), "the tracker's link fails")


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_all_points_come_in_order_with_the_stamps_of_the_tracker(make_plant: Any, kind: str) -> None:
    with bridged(make_plant, kind=kind) as (plant, _, tracker):
        assert stream_of(tracker) is not None
        seen: list[Track] = []
        lost: list[TrackerError] = []
        tracker.start_track(NEST, INTERVAL_S, lost.append, seen.append)
        began_s = plant.clock_s
        passes(plant, tracker, 0.4)
        track = tracker.end_track()
    assert lost == []
    assert 390 <= len(track.p_M) <= 402
    wanted = CLOCK.own_time_s(began_s + INTERVAL_S * np.arange(len(track.p_M)))
    np.testing.assert_allclose(track.device_time_s, wanted, atol=2e-7)
    np.testing.assert_allclose(track.p_M, np.repeat(NEST[None], len(wanted), axis=0), atol=1e-8)
    assert np.isfinite(track.sigma_m).all()
    assert 5 <= len(seen) <= len(track.p_M) / 15


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
        bridge.tracker.covered.add("n")
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
    with TrackerService(Resting()) as service, client(service.url, timeout_s=2.0) as tracker:  # type: ignore[arg-type]
        assert tracker.stream_limits() is None
        assert stream_of(tracker) is None
        with pytest.raises(TrackerError, match="does not measure an SMR while it moves"):
            tracker.start_track(NEST, 0.01, lambda error: None)
    old = TrackerService(Resting())  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drivers.trackers.bridge_server._COMMANDS", ("prepare",))
        with old, client(old.url, timeout_s=2.0) as tracker:
            assert stream_of(tracker) is None


@pytest.mark.parametrize(
    "fields",
    [
        {"points": "1,2,3", "age": "0", "waiting": "0"},
        {"points": "1,2,3,4,x", "age": "0", "waiting": "0"},
        {"points": "1.2.3,2,3,4,", "age": "0", "waiting": "0"},
        {"points": "1,2,3,4,", "waiting": "0"},
        {"points": "", "waiting": "-1"},
    ],
)
def test_damaged_points_are_refused(fields: dict[str, str]) -> None:
    with pytest.raises(BadField):
        read_packet(fields, 0.0)
    with pytest.raises(BadField):
        read_limits(fields)


# -- The tracker bridge under random sequences of commands, halts and link faults: nothing lost or doubled -------------

SILENCE_S = 0.1
NESTS = {"a": np.array([1.5, 2.0, -0.3]), "b": np.array([2.0, 1.0, 0.2])}
NEAR_M = 1e-3
LINK_FAULTS = ("slow", "garbage", "truncate", "silence", "drop", "repeat", "tracker-reboot")
"""Faults after which a measurement is delivered, and was made once."""


class BridgeMachine(RuleBasedStateMachine):
    """A client and the bridge of a tracker that measures fixed nests; the link between them fails."""

    def __init__(self) -> None:
        super().__init__()
        self.stack = ExitStack()
        plant = Plant(PlantConfig(seed=1, arms=(), tracker=TrackerConfig(T_C_M=np.eye(4))))
        self.bridge = self.stack.enter_context(
            TrackerBridgeEmulator(plant, nests=NESTS, reboot_s=0.1, slow_s=1.5 * SILENCE_S)
        )
        self.tracker = BridgeTracker(self.bridge.url, timeout_s=SILENCE_S, preparation=Preparation())
        self.stack.callback(lambda: self.tracker.disconnect())
        self.tracker.connect()
        self.waiting: list[str] = []
        self.stamps: list[float] = []
        self.undelivered = 0
        """Measurements that the tracker made and that nobody got: halted, or forgotten in a restart of the bridge."""

    def teardown(self) -> None:
        self.stack.close()

    @rule(kind=st.sampled_from((*LINK_FAULTS, "beam", "reboot")))
    def fault(self, kind: str) -> None:
        if len(self.waiting) < 2:
            self.bridge.fault(kind)
            self.waiting.append(kind)

    @rule(nest=st.sampled_from(sorted(NESTS)))
    def measure(self, nest: str) -> None:
        faults, self.waiting = self.waiting, []
        while True:
            try:
                point = self.tracker.measure(NESTS[nest], 0.5)
                break
            except TargetLost:
                assert "beam" in faults, "the target was lost without a cause"
                faults.remove("beam")
        self.undelivered += faults.count("reboot")
        self.delivered(point, nest)
        self.waiting = list(self.bridge._faults)

    def delivered(self, point: Point, nest: str) -> None:
        assert np.linalg.norm(point.p_M - NESTS[nest]) < NEAR_M, "the point of another nest"
        self.stamps.append(point.time_s)

    @rule(nest=st.sampled_from(sorted(NESTS)), late_s=st.sampled_from([0.0, 0.02, 0.1]))
    def measure_and_halt(self, nest: str, late_s: float) -> None:
        """Halt from another thread; the measurement is delivered, or ends as halted, or was halted before it began."""
        self.measure(nest)  # faults that wait belong to another rule
        while self.waiting:
            self.measure(nest)
        self.bridge.fault("slow")
        halting = threading.Timer(late_s, self.tracker.halt)
        halting.start()
        try:
            self.delivered(self.tracker.measure(NESTS[nest], 0.5), nest)
        except Halted:
            self.undelivered += 1
        finally:
            within(halting.join, "the end of the halt")
        self.waiting = list(self.bridge._faults)

    @rule()
    def halt_at_rest(self) -> None:
        self.tracker.halt()
        assert self.tracker.unmet() == []

    @rule()
    def reconnect(self) -> None:
        self.tracker.disconnect()
        with pytest.raises(TrackerLinkLost):
            self.tracker.unmet()
        self.tracker.connect()

    @rule()
    def second_client(self) -> None:
        other = BridgeTracker(self.bridge.url, timeout_s=SILENCE_S)
        with pytest.raises(TrackerRefused):
            other.connect()

    @invariant()
    def each_point_was_measured_once(self) -> None:
        assert self.stamps == sorted(set(self.stamps)), "a point was delivered twice or out of order"
        made = self.bridge.tracker.measured
        assert len(self.stamps) <= made <= len(self.stamps) + self.undelivered


BridgeMachine.TestCase.settings = settings(
    max_examples=8, stateful_step_count=7, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
TestBridgeMachine = BridgeMachine.TestCase


# -- Whatever clients send, the tracker's bridge and its emulator go on to serve a client that behaves -----------------

SEEDS = range(2)
CONVERSATIONS = 400
"""Of each seed."""
WORDS = (
    "sync", "hello", "auth", "identify", "prepare", "unmet", "confirm", "measure", "ping",
    "halt", "bye", "fault", "ok", "wait", "error", "nothing",
)  # fmt: skip
KEYS = (
    "nonce", "protocol", "client", "proof", "id", "reflector", "accuracy", "temperature", "x", "y", "z", "averaging",
    "within", "kind", "pressure", "humidity",
)  # fmt: skip
VALUES = (
    "", "0", "1", "-1", "1e999", "-1e-999", "nan", "inf", "9" * 40, "1e12", "abcdefgh", "simulated 1.5 in", "fast",
    "\u00e9%*", "1.5", "2.0", "-0.3", "0.001", *FAULTS,
)  # fmt: skip

EffectSampler = random.Random


def line(draw: EffectSampler, client: str) -> bytes:
    """One line of the protocol, or nearly one."""
    if draw.random() < 0.15:
        return draw.randbytes(draw.choice([0, 1, 30, 3000])) + draw.choice([b"\n", b""])
    fields = {key: draw.choice(VALUES) for key in draw.sample(KEYS, draw.randrange(len(KEYS)))}
    word = draw.choice(WORDS)
    fields |= {
        "sync": {"nonce": "0123456789abcdef"},
        "hello": {"protocol": "1", "client": client},
        "confirm": {"within": draw.choice(VALUES)},
        "measure": {
            "id": f"id{draw.randrange(10**9):09}",
            "x": "1.5",
            "y": "2.0",
            "z": "-0.3",
            "averaging": draw.choice(VALUES),
        },
    }.get(word, {})
    try:
        said = wire.encode(draw.choice([0, 1, 999_999, draw.randrange(1000)]), word, fields)
    except ValueError:
        return b"\n"
    if draw.random() < 0.1:
        said = bytes(byte ^ (draw.random() < 0.05) * draw.randrange(256) for byte in said)
    return said


def conversation(draw: EffectSampler, address: tuple[str, int]) -> None:
    client = f"client{draw.randrange(10**6):06}"
    try:
        with socket.create_connection(address, 5.0) as link:
            link.settimeout(0.005)
            if draw.random() < 0.7:
                link.sendall(wire.encode(1, "hello", {"protocol": "1", "client": client}))
            for _ in range(draw.randrange(1, 12)):
                link.sendall(line(draw, client))
            if draw.random() < 0.5:
                link.recv(65536)
            if draw.random() < 0.2:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    except OSError:
        pass  # the bridge may hang up, or answer nothing


@pytest.fixture
def bridge(make_plant) -> Iterator[TrackerBridgeEmulator]:
    with TrackerBridgeEmulator(make_plant(), nests={"n": NEST}, reboot_s=0.01, slow_s=0.05) as served:
        yield served


@pytest.mark.parametrize("seed", SEEDS)
def test_no_conversation_ends_the_bridge(seed: int, bridge: TrackerBridgeEmulator) -> None:
    draw = random.Random(seed)
    for _ in range(CONVERSATIONS):
        conversation(draw, (bridge.host, sure(bridge.port)))
    bridge.call_soon(bridge._faults.clear)  # they strike whoever measures next
    tracker = BridgeTracker(bridge.url, preparation=Preparation())
    assert len(bridge._faults) <= 1000
    tracker.connect()
    try:
        asked_s = time.monotonic()
        tracker.confirm(20.0)
        assert tracker.data_age_s() <= time.monotonic() - asked_s, "it answered this question"
        assert tracker.measure(NEST, 1.0).p_M == pytest.approx(NEST, abs=1e-3)
    finally:
        tracker.disconnect()
    assert math.isfinite(tracker.data_age_s())
