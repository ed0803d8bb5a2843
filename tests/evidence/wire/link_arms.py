"""The two emulated arms of the program links and their drivers, in this process or in one that hangs."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.reaction import StopReaction
from drivers.arms.protocol import ArmError, JointLimits
from drivers.arms.ur import UrArm
from drivers.arms.ur_checks import UrExpectation
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import ControllerConfig, Series, personality

Vector = NDArray[np.float64]

_CONTROLLERS: Mapping[str, tuple[Series, str, str]] = {
    "left": ("CB3", "UR10", "20150000001"),
    "right": ("e-Series", "UR5", "20200000002"),
}
_JOINT_SPEED = {"left": math.radians(120.0), "right": math.radians(180.0)}
"""Speed limit of the slowest joints of a UR10 and a UR5 [rad/s]; braking from it takes half a second."""
SPEED, ACCELERATION = 2.0, 6.0
FAR_RAD = 2.4
"""Length of a motion that a fault interrupts: it lasts longer than any fault needs to take effect."""
HOME = np.array([0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0])
SETTLE_S = 0.1
START_DELAY_S = 0.05
_PATIENT_S = 60.0


class NoTracker:
    """The tracker of a cell that does not measure."""

    def halt(self) -> None:
        """Do nothing."""


def controllers(hosts: Mapping[str, str]) -> list[ControllerConfig]:
    """Return the emulated controllers of the arms ``left`` and ``right``."""
    quick: dict[str, Any] = {"boot_s": 0.3, "brake_release_s": 0.2, "unlock_after_s": 0.5}
    return [
        ControllerConfig(
            name,
            host,
            personality(*_CONTROLLERS[name]),
            speed=(_JOINT_SPEED[name],) * 6,
            start_delay_s=START_DELAY_S,
            **quick,
        )
        for name, host in hosts.items()
    ]


def driver(name: str, host: str) -> UrArm:
    """Return the driver of an arm, not connected yet."""
    series, model, serial = _CONTROLLERS[name]
    limits = JointLimits(np.tile([-2.0 * math.pi, 2.0 * math.pi], (6, 1)), np.full(6, 2.05), np.full(6, 8.0))
    expected = UrExpectation(
        model=model if series == "CB3" else f"{model}e",
        serial=serial,
        limits=limits,
        payload_kg=0.0,
        payload_center_m=np.zeros(3),
    )
    return UrArm(name, UrSettings(host=host, settle_time=SETTLE_S), expected)


def start(arm: UrArm, q: Vector) -> None:
    """Start a motion at the trial's speed."""
    arm.start_move(q, np.full(6, SPEED), np.full(6, ACCELERATION))


def start_far(arm: UrArm) -> None:
    """Start a long motion of the first joint, away from where it is."""
    here = arm.state().q
    way = FAR_RAD if here[0] < HOME[0] else -FAR_RAD
    start(arm, here + np.array([way, 0.0, 0.0, 0.0, 0.0, 0.0]))


def disconnect(arm: UrArm) -> None:
    """Disconnect, whatever the arm answers."""
    with suppress(ArmError):
        arm.disconnect()


@contextmanager
def other_application(hosts: Mapping[str, str]) -> Iterator[int]:
    """Run another process that moves both arms like an application; gives its id once they move."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_move_both, args=(dict(hosts), theirs), name="application", daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(_PATIENT_S):
            raise TimeoutError(f"the other application did not start within {_PATIENT_S:g} s")
        error = ours.recv()
        if error:
            raise TimeoutError(f"the other application could not move the arms: {error}")
        assert process.pid is not None
        yield process.pid
    except EOFError as error:
        raise TimeoutError("the other application ended") from error
    finally:
        process.kill()
        process.join()
        ours.close()


def _move_both(hosts: Mapping[str, str], pipe: Connection) -> None:
    arms = {name: driver(name, host) for name, host in hosts.items()}
    StopReaction(arms, NoTracker())
    try:
        for arm in arms.values():
            arm.connect()
        for arm in arms.values():
            start_far(arm)
    except ArmError as error:
        pipe.send(str(error))
        return
    pipe.send("")
    for arm in arms.values():
        with suppress(ArmError):
            arm.wait_settled(_PATIENT_S)
    pipe.poll(_PATIENT_S)
