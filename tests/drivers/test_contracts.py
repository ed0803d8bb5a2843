"""The contracts of arms and trackers, held by every kind of driver: simulated, on the wire, and of a plug-in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers import contracts
from drivers.arms.protocol import Arm, JointLimits
from drivers.arms.settings import ArmContext
from drivers.arms.simulated import SimulatedArm
from drivers.emulators.tracker_bridge import TrackerBridgeEmulator
from drivers.emulators.ur_controller import EmulatorProcess
from drivers.plant import Plant
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.lmf import LmfTracker
from drivers.trackers.lmf_settings import LmfSettings
from drivers.trackers.protocol import Preparation, Tracker
from drivers.trackers.simulated import SimulatedTracker
from tests.drivers.arms.emulated_ur_cell import AWAY, HOME, driven, emulated_cell, repair
from tests.drivers.trackers.fake_lmf import Scene
from tests.interfaces.plugins.example_plugin.cellapp_example.line_arm import LineArm
from tests.interfaces.plugins.line_controller import line_controllers

pytestmark = pytest.mark.waits

LIMITS = JointLimits(np.tile([-6.0, 6.0], (6, 1)), np.full(6, 2.0), np.full(6, 4.0))


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    with emulated_cell() as started:
        yield started


@contextmanager
def arm_of(kind: str, plant: Plant, emulator: EmulatorProcess) -> Iterator[Arm]:
    if kind == "simulated":
        yield SimulatedArm(plant, "left")
    elif kind == "toy":
        with line_controllers(HOME.tolist()) as (controller,):
            yield LineArm(ArmContext("toy", "toy", 6, LIMITS, 0.0, np.zeros(3)), "127.0.0.1", controller.port)
    else:
        name = {"CB3": "left", "e-Series": "right"}[kind]
        repair(emulator, name)
        with driven(name) as arm:
            yield arm


@pytest.mark.parametrize("contract", contracts.ARM, ids=lambda one: one.__name__)
@pytest.mark.parametrize("kind", ["simulated", "CB3", "e-Series", "toy"])
def test_an_arm(kind: str, contract: Callable[..., None], make_plant, make_arm, emulator: EmulatorProcess) -> None:
    with arm_of(kind, make_plant(make_arm(home=HOME)), emulator) as arm:
        arm.connect()
        try:
            contract(arm, AWAY)
        finally:
            arm.disconnect()


NEST = np.array([1.5, 2.0, -0.3])


@contextmanager
def tracker_of(kind: str, plant: Plant) -> Iterator[Tracker]:
    if kind == "simulated":
        yield SimulatedTracker(plant, nests={"n": NEST})
    elif kind == "LMF":
        scene = Scene(targets={"left": NEST}, initialised=True)
        yield LmfTracker(LmfSettings(address="192.168.0.1"), Preparation(), load=lambda library: scene.lmf())
        assert scene.violations == []
    else:
        with TrackerBridgeEmulator(plant, nests={"n": NEST}) as bridge:
            yield BridgeTracker(bridge.url, timeout_s=2.0, preparation=Preparation())


@pytest.mark.parametrize("contract", contracts.TRACKER, ids=lambda one: one.__name__)
@pytest.mark.parametrize("kind", ["simulated", "bridge", "LMF"])
def test_a_tracker(kind: str, contract: Callable[..., None], make_plant) -> None:
    with tracker_of(kind, make_plant()) as tracker:
        tracker.connect()
        try:
            contract(tracker, NEST)
        finally:
            tracker.disconnect()
