"""Motor currents of a UR arm: from its client to the state; emulated drives of a plant report them at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.arms.ur_answers import arm_state
from drivers.arms.ur_motion import read_worker_sample
from drivers.emulators.ur_controller.motion import FreeMotions
from tests.drivers.arms.delayed_client import DelayedClient


def answer(current_a: list[float]) -> dict[str, Any]:
    client = DelayedClient()
    client.current_a = current_a
    return {**read_worker_sample(client, ()).as_dict(), "fault": None, "moving": False}


def test_currents_are_part_of_the_state() -> None:
    found = arm_state(answer([0.1, -3.2, 1.5, 0.2, 0.1, 0.0]), 0.01)
    assert found.tau_nm is None
    assert found.current_a is not None
    np.testing.assert_array_equal(found.current_a, [0.1, -3.2, 1.5, 0.2, 0.1, 0.0])


@pytest.mark.parametrize("current_a", [[0.0] * 6, None])
def test_drives_that_measure_none_have_none(current_a: list[float] | None) -> None:
    whole = answer([0.0] * 6) | {"current_a": current_a}
    assert arm_state(whole, 0.01).current_a is None


def test_ideal_joints_have_no_currents() -> None:
    assert FreeMotions.drive_torques(None, "left") == (None, None)  # type: ignore[arg-type]
