"""The tracker bridge under random sequences of commands, halts and link faults: nothing lost or doubled."""

from __future__ import annotations

import threading
from contextlib import ExitStack

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.plant import Plant, PlantConfig, TrackerConfig
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import Halted, Point, Preparation, TargetLost, TrackerLinkLost, TrackerRefused
from tests.waiting import within

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
    max_examples=8,
    stateful_step_count=7,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
TestBridgeMachine = BridgeMachine.TestCase
