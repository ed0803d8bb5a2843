"""Translation of a UR worker's answers to the terms of the arm's protocol: errors with their remedies, and states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from drivers.arms.protocol import (
    ArmError,
    ArmState,
    ArmTimeout,
    EmergencyStop,
    HostStalled,
    LinkLost,
    MotionStopped,
    NotInRemoteControl,
    ProtectiveStop,
)
from drivers.arms.ur_checks import JOINTS
from drivers.arms.ur_safety import not_ready

REFUSALS: Mapping[str, type[ArmError]] = {
    "protective": ProtectiveStop,
    "emergency": EmergencyStop,
    "local": NotInRemoteControl,
    "link": LinkLost,
    "driver": LinkLost,
    "nonsense": LinkLost,
    "timeout": ArmTimeout,
    "stopped": MotionStopped,
    "stalled": HostStalled,
    "failed": ArmError,
    "advised": ArmError,
}
"""Exception for each kind of refusal of the worker. A kind without a remedy here has the remedy in its text."""
_REMEDIES = {
    "link": "see whether the controller is on and the network between works, then connect again",
    "driver": "close other programs on this computer, then connect again",
    "nonsense": "look at the pendant's log, restart the controller",
    "timeout": "see what the pendant shows",
    "stopped": "connect again when it may move",
    "stalled": "nothing is wrong at the arm; close other programs on this computer",
    "failed": "look at the arm and at the pendant's log, then connect again",
}


def arm_error(name: str, kind: str, text: str) -> ArmError:
    """Return the exception for a refusal of arm ``name``; its message says what is wrong and what to do."""
    remedy = _REMEDIES.get(kind, "")
    return REFUSALS[kind](f"arm {name}: {text}" + (f"; {remedy}" if remedy else ""))


def arm_state(answer: Mapping[str, Any], moving_rad_s: float) -> ArmState:
    """Return the state from a worker's answer; a joint faster than ``moving_rad_s`` counts as moving."""
    mode, safety, fault = str(answer["robot_mode"]), str(answer["safety_mode"]), answer["fault"]
    reason, problem = "", not_ready(mode, safety)
    if problem is not None:
        reason = ": ".join(problem)
    elif fault is not None:
        reason = f"{fault['text']}; connect again when the arm may move"
    qd = np.array(answer["qd"], dtype=np.float64)
    temperatures = answer["joints_c"]
    return ArmState(
        q=np.array(answer["q"], dtype=np.float64),
        time_s=float(answer["time_s"]),
        moving=bool(answer["moving"]) or float(np.abs(qd).max()) > moving_rad_s,
        ready=not reason,
        reason=reason,
        payload_kg=answer["payload_kg"],
        joint_temperature_c=np.array(temperatures, dtype=np.float64) if len(temperatures) == JOINTS else None,
        robot_mode=mode,
        safety_mode=safety,
        program=str(answer["program"]),
        speed_fraction=answer["speed_fraction"],
    )
