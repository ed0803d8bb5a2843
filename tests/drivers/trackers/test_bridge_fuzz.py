"""Whatever clients send, the tracker's bridge and its emulator go on to serve a client that behaves."""

from __future__ import annotations

import math
import random
import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.emulators.tracker_bridge import FAULTS, TrackerBridgeEmulator
from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import Preparation

SEEDS = range(4)
CONVERSATIONS = 400
"""Of each seed."""
NEST = np.array([1.5, 2.0, -0.3])
WORDS = (
    "sync", "hello", "auth", "identify", "prepare", "unmet", "confirm", "measure", "two-face", "inclination", "ping",
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

Draw = random.Random


def line(draw: Draw, client: str) -> bytes:
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


def conversation(draw: Draw, address: tuple[str, int]) -> None:
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
    assert bridge.port is not None
    for _ in range(CONVERSATIONS):
        conversation(draw, (bridge.host, bridge.port))
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
