"""Reading of a UR arm that a person leads by hand, over RTDE outputs only. Nothing is written, no program is touched.

The person enables freedrive with the button of the pendant or of a handle. The arm counts as resting while no joint is
faster than ``settle_speed`` or leaves ``settle_window``.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import ArmError, ArmState, ArmTimeout, WrongRobot
from drivers.arms.ur_checks import UrExpectation, checks
from drivers.arms.ur_links import RTDE_PORT, Connection
from drivers.arms.ur_options import UrOptions
from drivers.arms.ur_probe import probe_ur
from drivers.arms.ur_rtde_reader import UrSample, samples
from drivers.patience import Patience

_READ_MODES = ("IDLE", "BACKDRIVE", "RUNNING")
"""Modes in which the joints have power, so that their encoders can be read."""


def read_led_arm(
    settings: UrOptions,
    expected: UrExpectation,
    rest_s: float,
    patience_s: float,
    *,
    rtde_port: int = RTDE_PORT,
    **ports: Any,
) -> ArmState:
    """Return the arm's state, joints averaged over the last ``rest_s`` [s] of rest. ``ports`` are those of the probe.

    Raises
    ------
    ArmTimeout
        If it does not rest for so long within ``patience_s`` [s].
    WrongRobot
        If the controller is not the one of the profile.
    LinkLost
        If the controller is silent for ``settings.timeout``, or the peer is no UR controller.
    ArmError
        If the joints have no power.
    """
    found = checks(expected, probe_ur(settings.host, settings.timeout, rtde_port=rtde_port, **ports))
    for check in found:
        if check.status == "failed" and check.error is WrongRobot:
            raise WrongRobot(f"{check.subject}: {check.text}")
    with Connection.to(settings.host, rtde_port, Patience(settings.timeout)) as link:
        return _once_resting(link, settings, rest_s, patience_s)


def _once_resting(link: Connection, settings: UrOptions, rest_s: float, patience_s: float) -> ArmState:
    window: deque[UrSample] = deque()
    began_s = None
    for sample in samples(link, Patience(settings.timeout + patience_s)):
        if sample.robot_mode not in _READ_MODES:
            raise ArmError(f"the robot is {sample.robot_mode}: its joints are not read; switch it on at the pendant")
        began_s = sample.time_s if began_s is None else began_s
        window.append(sample)
        if sample.speed > settings.settle_speed or _left(window) > settings.settle_window:
            window.clear()
        elif sample.time_s - window[0].time_s >= rest_s:
            return _state(window)
        if sample.time_s - began_s > patience_s:
            break
    joint = int(np.argmax(np.abs(sample.qd))) + 1
    raise ArmTimeout(
        f"the arm moves (joint {joint} at {np.degrees(sample.speed):.2f} deg/s); let go of freedrive, let it rest, then"
        " record again"
    )


def _left(window: deque[UrSample]) -> float:
    """Return the largest range of a joint within a window [rad]."""
    return float(np.ptp(_joints(window), axis=0).max())


def _joints(window: deque[UrSample]) -> NDArray[np.float64]:
    return np.array([one.q for one in window])


def _state(window: deque[UrSample]) -> ArmState:
    last = window[-1]
    return ArmState(
        q=_joints(window).mean(axis=0),
        time_s=last.time_s,
        moving=False,
        ready=False,
        reason="it is led by hand",
        payload_kg=last.payload_kg,
        joint_temperature_c=None if last.joints_c is None else np.array(last.joints_c),
        robot_mode=last.robot_mode,
        safety_mode=last.safety_mode,
        program=last.program,
        speed_fraction=last.speed_fraction,
    )
