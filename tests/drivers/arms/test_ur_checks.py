"""Payload, TCP and speed slider, checked again once the control program runs; and requests that are refused unsent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.arms.protocol import JointLimits, LimitExceeded
from drivers.arms.ur import checked_rows
from drivers.arms.ur_checks import UrExpectation, load_checks
from drivers.arms.ur_probe import UrProbe
from drivers.arms.ur_rtde_reader import UrSample

EXPECTED = UrExpectation(
    "UR10",
    None,
    JointLimits(np.tile([-6.0, 6.0], (6, 1)), np.full(6, 2.0), np.full(6, 8.0)),
    payload_kg=0.35,
    payload_center_m=np.array([0.0, 0.0, 0.03]),
    tcp=np.array([0.0, 0.0, 0.06, 0.0, 0.0, 0.0]),
)
PROBE = UrProbe(
    host="192.168.0.10",
    greeting="",
    software="3.15.8",
    series="CB3",
    model="UR10",
    serial=None,
    robot_mode="RUNNING",
    safety_mode="NORMAL",
    safety_status=None,
    remote_control=None,
    program_running=False,
    ports={},
    kinematics=None,
    kinematics_note="",
    tcp=(0.0, 0.0, 0.06, 0.0, 0.0, 0.0),
    sample=UrSample(1.0, (0.0,) * 6, (0.0,) * 6, "RUNNING", "NORMAL", "STOPPED", 1.0, 0.35, (0.0, 0.0, 0.03)),
)
ANSWER: dict[str, Any] = {
    "payload_kg": 0.35,
    "payload_center_m": [0.0, 0.0, 0.03],
    "tcp": [0.0, 0.0, 0.06, 0.0, 0.0, 0.0],
    "speed_fraction": 1.0,
}


@pytest.mark.parametrize(
    ("change", "failed"),
    [
        ({}, []),
        ({"payload_kg": 0.0}, ["payload"]),
        ({"payload_center_m": [0.0, 0.0, 0.08]}, ["payload"]),
        ({"tcp": [0.0] * 6}, ["TCP"]),
        ({"tcp": None}, []),  # not reported by the program: the probe's is compared
        ({"speed_fraction": 0.0}, ["speed slider"]),
        ({"speed_fraction": 0.3}, []),
    ],
)
def test_what_the_program_changes_is_found(change: dict[str, Any], failed: list[str]) -> None:
    found = load_checks(EXPECTED, PROBE, ANSWER | change)
    assert [check.subject for check in found if check.status == "failed"] == failed


@pytest.mark.parametrize("rows", [np.zeros(6), np.zeros((2, 5)), np.array([[0.0] * 6, [np.nan] * 6])])
def test_rows_that_are_no_joint_positions_are_not_asked(rows: np.ndarray) -> None:
    with pytest.raises(LimitExceeded, match="arm left: "):
        checked_rows("left", rows)
