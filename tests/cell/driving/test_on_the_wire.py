"""Collecting over real sockets: no reading of an arm that something moved, no motion over a link that is too slow."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.motion import PointAtRest
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from drivers.arms.recording import JointRecord
from drivers.arms.ur_settings import UrSettings
from drivers.trackers.protocol import Point
from tests.commands.emulated_cell import behind_bridge, patiently
from tests.evidence.wire.moved_arms import STEP, Attack, collected, pushed
from tests.evidence.wire.storm_cell import StormCell, emulated_cell
from tests.loopback import free_port, own_arms
from tests.sure import sure
from tests.twin import altered, small_twin
from tests.waiting import until

pytestmark = pytest.mark.waits

HOSTS = own_arms(76)
AVERAGING_S = 0.3
LOOKS = 4


@pytest.fixture(scope="module")
def profile() -> Profile:
    twin = small_twin(1, plan={"reserve": 0})
    arms = {
        name: arm.model_copy(update={"driver": UrSettings(host=HOSTS[name], watchdog_hz=2.0)})
        for name, arm in twin.arms.items()
    }
    return altered(twin, arms=arms, tracker={"averaging": AVERAGING_S})


@pytest.fixture(scope="module")
def plan(profile: Profile) -> dict[str, np.ndarray]:
    """One stop near home."""
    return {name: home[None] + 0.1 for name, home in home_positions(profile).items()}


@pytest.fixture(scope="module")
def emulator(profile: Profile) -> Iterator[StormCell]:
    with emulated_cell(behind_bridge(profile, f"socket://127.0.0.1:{free_port('127.0.0.1')}"), 1.0) as cell:
        yield cell


MOVES = "left its rest without being asked"


@pytest.mark.parametrize(
    ("attacks", "says"),
    [
        ([pushed(1e-2, 0.3)], f"arm left: it {MOVES}"),
        ([pushed(1e-3, 0.05, back_after_s=0.1)], f"arm left: it {MOVES}"),
        ([pushed(1e-3, STEP, after_s=0.7 * AVERAGING_S)], f"arm left: it {MOVES}"),
        ([pushed(1e-2, 4e-3)], f"arm left: it {MOVES}"),
        ([pushed(-1e-2, STEP, "right")], f"arm right: it {MOVES}"),
        ([pushed(1e-3, STEP, back_after_s=0.02)] * 3, "arm left: joint 1 was 0.057 deg from its rest .* 3 times"),
        ([pushed(1e-3, STEP, back_after_s=0.02)] * 2, r"0.057 deg .* \(1 of 2\), .* \(2 of 2\)"),
    ],
    ids=["push", "push and back", "step", "creep", "other arm", "three glitches", "two glitches"],
)
def test_no_reading_of_an_arm_that_was_moved_is_stored(
    profile: Profile, plan: dict[str, np.ndarray], emulator: StormCell, tmp_path: Path, attacks: list[Attack], says: str
) -> None:
    folders = count()

    def act(attempt: int) -> str:
        emulator.repair()
        with RunFile.create(tmp_path / f"run-{next(folders)}", profile) as run:
            run.write_plan(plan)
            try:
                collected(emulator, run, [*attacks])
            except HardwareError as error:
                assert run.stops_done() == set()
                until(lambda: all(one["runtime_state"] == "STOPPED" for one in emulator.status().values()), "both stop")
                return str(error)
            for name in run.arms():
                readings = run.readings(name)
                np.testing.assert_allclose(readings.q, plan[name], atol=1e-6)
                assert sure(readings.q_spread).max() < 1e-6
            return ", ".join(event.text for event in run.events() if "rejected" in event.text)

    # a busy computer may look at the joints too late, and the averaging finds the same: the arms stop for that reason
    found = [patiently(act)]
    while not re.search(says, found[-1]) and len(found) < LOOKS:
        found.append(patiently(act))
    assert re.search(says, found[-1]), found


def test_a_link_that_cannot_hold_the_watchdog_is_refused_before_anything_moves(
    profile: Profile, plan: dict[str, np.ndarray], emulator: StormCell, tmp_path: Path
) -> None:
    emulator.repair()
    moves, ended = emulator.status()["left"]["moves"], threading.Event()

    def disturb() -> None:
        while not ended.wait(0.7):
            emulator.control("left", "fault", "rtde", "silent", 0.5)

    disturbing = threading.Thread(target=disturb)
    disturbing.start()
    try:
        with RunFile.create(tmp_path / "run", profile) as run:
            run.write_plan(plan)
            with pytest.raises(HardwareError) as caught:
                collected(emulator, run, [])
    finally:
        ended.set()
        disturbing.join()
    found = re.search(
        r"arm left: round trip .* states at most (\d+)\.\d ms late, .* too slow for the watchdog, which stops the arm"
        r" after 0.50 s of silence; .* or set arms.left.driver.watchdog_hz to (1\.\d); nothing was moved",
        str(caught.value),
    )
    assert found is not None, caught.value
    assert int(found[1]) > 400
    assert emulator.status()["left"]["moves"] == moves


def test_stored_joints_are_those_of_the_averaging() -> None:
    time_s = np.arange(0.0, 2.0, 0.008)
    joints = JointRecord(time_s, (1e-4 * time_s)[:, np.newaxis], np.zeros((250, 1)), 0.008)
    point = Point(np.zeros(3), np.eye(3), 101.5, 0.5, None)
    found = PointAtRest.of(point, joints, 100.0 + time_s[-1])
    np.testing.assert_allclose(found.q, 1.5e-4, atol=1e-6)
    np.testing.assert_allclose(found.q_spread, 1e-4 * time_s[-1])
