"""The example of the handbook: built and installed, its arm driven, braked, cut off, and kept from colliding."""

from __future__ import annotations

import math
import os
import queue
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cellapp import __version__
from cellapp.cell.driving.cell import arm_context, open_cell
from cellapp.cell.driving.motion import MotionRefused, Mover
from cellapp.cell.driving.reaction import StopReaction
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.calibration.calibrate import provenance_of
from cellapp.ground.control import JobControl
from cellapp.ground.profile import Profile
from cellapp.robot.effects.registry import program_of
from drivers.arms.protocol import Arm, ArmError, LimitExceeded, LinkLost, MotionStopped
from drivers.arms.registry import ARMS
from drivers.arms.settings import ArmSettings
from tests.interfaces.plugins.installed import EXAMPLE, REPOSITORY, add_example, installed, run_commands
from tests.interfaces.plugins.line_controller import LineController, line_controllers
from tests.twin import PROFILES, altered
from tests.waiting import WAIT_S

HOME = np.array([0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0])
SPEED, ACCELERATION = np.full(6, 0.5), np.full(6, 1.0)


@pytest.fixture
def controller() -> Iterator[LineController]:
    with line_controllers(HOME.tolist()) as (one,):
        yield one


@pytest.fixture
def settings(tmp_path: Path, controller: LineController) -> Iterator[ArmSettings]:
    """The section ``driver`` of an arm with that controller."""
    with installed(add_example(tmp_path)):
        yield ARMS["line"].model_validate({"kind": "line", "host": "127.0.0.1", "port": controller.port})


@pytest.fixture
def profile(settings: ArmSettings) -> Profile:
    """The simulated cell whose left arm has that driver."""
    twin = load_profile(PROFILES / "twin.yaml")
    return altered(twin, arms={"left": {"driver": settings}})


@pytest.fixture
def arm(profile: Profile) -> Iterator[Arm]:
    """The driver, connected."""
    arm = profile.arms["left"].driver.open(arm_context("left", profile.arms["left"]))
    arm.connect()
    yield arm
    arm.disconnect()


def test_built_and_installed_it_adds_to_every_registry_and_costs_nothing_before(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("__pycache__"))  # building writes beside the source
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index",
         "--disable-pip-version-check", "--target", target, source],
        timeout=120, check=True,
    )  # fmt: skip
    ended = run_commands([target], f"doctor {PROFILES / 'twin.yaml'}")
    adds = "kind of arm line, arm type ur3.yaml, effect hose_pull, export serial-link"
    assert f"ok       plug-in cellapp-example 1.0: adds {adds}" in ended.out
    assert ended.codes == [0]
    path = os.pathsep.join(map(str, (target, REPOSITORY)))
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "cellapp", "--help"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert not loaded & {"cellapp_example", "drivers.plugins", "cellapp.robot.effects"}


def test_who_took_part_is_in_the_provenance(profile: Profile) -> None:
    took_part = f"cellapp {__version__} with cellapp-example 1.0 (kind of arm line, effect hose_pull)"
    assert provenance_of(profile).program == took_part
    twin = load_profile(PROFILES / "twin.yaml")
    assert program_of(twin) == f"cellapp {__version__} with cellapp-example 1.0 (effect hose_pull)"


def test_the_arm_moves_keeps_its_limits_and_stays_when_braked(arm: Arm, controller: LineController) -> None:
    goal = HOME + 0.1
    arm.start_move(goal, SPEED, ACCELERATION)
    np.testing.assert_allclose(arm.wait_settled(WAIT_S).q, goal, atol=1e-12)
    with pytest.raises(LimitExceeded, match="nothing has moved"):
        arm.start_move(np.full(6, 7.0), SPEED, ACCELERATION)
    with pytest.raises(LimitExceeded):
        arm.start_move(np.full(6, math.nan), SPEED, ACCELERATION)
    arm.brake()
    with pytest.raises(MotionStopped, match="braked"):
        arm.start_move(HOME, SPEED, ACCELERATION)
    arm.stop()
    arm.connect()
    arm.start_move(HOME, SPEED, ACCELERATION)
    np.testing.assert_allclose(arm.wait_settled(WAIT_S).q, HOME, atol=1e-12)
    assert [line.split()[0] for line in controller.commands] == ["move", "stop", "stop", "move"]


def test_a_link_that_is_cut_is_pushed_once_and_then_said_by_every_call(arm: Arm, controller: LineController) -> None:
    faults: queue.Queue[ArmError] = queue.Queue()
    arm.watch(faults.put)
    controller.close()
    told = faults.get(timeout=WAIT_S)
    assert isinstance(told, LinkLost)
    assert "look at the arm, it may still move" in str(told)
    for call in (arm.state, lambda: arm.wait_settled(WAIT_S), lambda: arm.start_move(HOME, SPEED, ACCELERATION)):
        with pytest.raises(LinkLost):
            call()
    with pytest.raises(LinkLost, match="check power, cable and address"):
        arm.connect()
    assert faults.empty()


def test_a_controller_of_another_arm_is_not_taken(settings: ArmSettings) -> None:
    twin = load_profile(PROFILES / "twin.yaml")
    with line_controllers(HOME[:5].tolist()) as (other,):
        wrong = settings.model_copy(update={"port": other.port})
        with pytest.raises(LinkLost, match="5 joints, expected 6"):
            wrong.open(arm_context("left", twin.arms["left"])).connect()


def test_the_safety_gate_keeps_it_from_colliding(profile: Profile, controller: LineController) -> None:
    assert profile.moves_hardware, "no motion without consent"
    down = np.array([0.0, math.pi / 2.0, 0.0, 0.0, 0.0, 0.0])
    with open_cell(profile) as cell:
        bodies = cell_bodies(profile)
        reaction = StopReaction(cell.arms, cell.tracker, cell.together)
        mover = Mover(profile, cell, bodies, reaction, JobControl())
        with pytest.raises(MotionRefused, match=r"arm left: .* floor"):
            mover.move({"left": down, "right": HOME})
        assert controller.commands == []
        mover.move({"left": HOME + 0.05, "right": HOME})
    assert [line.split()[0] for line in controller.commands] == ["move"]
