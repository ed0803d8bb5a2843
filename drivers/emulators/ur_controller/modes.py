"""Modes of a UR controller, numbered as in the protocol."""

from __future__ import annotations

from enum import IntEnum


class RobotMode(IntEnum):
    """Robot mode, numbered as in the protocol."""

    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """Safety mode, numbered as in the protocol."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class Runtime(IntEnum):
    """State of the program, numbered as in the protocol."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
_JOINT_RUNNING, _JOINT_IDLE, _JOINT_BOOTING, JOINT_POWER_OFF = 253, 255, 247, 239
JOINT_MODE = {
    RobotMode.RUNNING: _JOINT_RUNNING,
    RobotMode.IDLE: _JOINT_IDLE,
    RobotMode.POWER_ON: _JOINT_IDLE,
    RobotMode.BOOTING: _JOINT_BOOTING,
}
