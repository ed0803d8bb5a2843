"""Primary interface: a version message, then the robot state ten times a second, the first with kinematics."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from drivers.arms.ur_rtde_reader import ProgramState, RobotMode, SafetyMode
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.personality import ControllerConfig, Personality

PERIOD_S = 0.1

_ROBOT_STATE, _MESSAGE = 16, 20
_MODE_DATA, _JOINT_DATA, _CARTESIAN, _KINEMATICS, _CONFIGURATION = 0, 1, 4, 5, 6
_VERSION_MESSAGE = 3
_MICROSECONDS = 1e6
_ROBOT_TYPES = {"UR5": 1, "UR10": 2, "UR3": 3}


def _sub(kind: int, payload: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(payload), kind) + payload


def package(subs: Iterable[bytes]) -> bytes:
    """Return a robot-state package made of sub-packages."""
    payload = b"".join(subs)
    return struct.pack(">iB", 5 + len(payload), _ROBOT_STATE) + payload


def kinematics_info(personality: Personality) -> bytes:
    """Return the sub-package with D-H parameters and calibration checksums."""
    theta, d, a, alpha = zip(*personality.rows, strict=True)
    values = struct.pack(">6I24dI", *personality.checksums, *theta, *a, *d, *alpha, personality.calibration_status)
    return _sub(_KINEMATICS, values)


def configuration_data(config: ControllerConfig) -> bytes:
    """Return the sub-package with limits, default speeds and D-H parameters (in the order a, d, alpha, theta)."""
    theta, d, a, alpha = zip(*config.personality.rows, strict=True)
    limits = [bound for pair in config.limits for bound in pair]
    rates = [value for pair in zip(config.speed, config.acceleration, strict=True) for value in pair]
    defaults = (1.047, 1.396, 0.25, 1.2, 0.0)
    kind = _ROBOT_TYPES.get(config.personality.model, 0)
    return _sub(
        _CONFIGURATION, struct.pack(">12d12d5d24d4i", *limits, *rates, *defaults, *a, *d, *alpha, *theta, 0, 0, kind, 0)
    )


def version_message(controller: Controller) -> bytes:
    """Return the first message of a connection."""
    personality = controller.config.personality
    name = b"URControl"
    major, minor, bugfix, build = personality.version
    payload = struct.pack(">QbbB", int(controller.clock_s * _MICROSECONDS), -2, _VERSION_MESSAGE, len(name)) + name
    payload += struct.pack(">BBii", major, minor, bugfix, build)
    return struct.pack(">iB", 5 + len(payload), _MESSAGE) + payload


def first_state(controller: Controller) -> bytes:
    """Return the first robot state of a connection, with kinematics and configuration."""
    config = controller.config
    return package([*_state(controller), kinematics_info(config.personality), configuration_data(config)])


def state(controller: Controller) -> bytes:
    """Return the current robot state."""
    return package(_state(controller))


def _state(controller: Controller) -> list[bytes]:
    safety, values = controller.safety_mode, controller.values
    powered = controller.robot_mode is not RobotMode.POWER_OFF
    paused = controller.runtime in (ProgramState.PAUSING, ProgramState.PAUSED)
    stops = (safety is SafetyMode.ROBOT_EMERGENCY_STOP, safety is SafetyMode.PROTECTIVE_STOP)
    flags = (True, not controller.config.simulation, powered, *stops, controller.running, paused)
    numbers = (int(controller.robot_mode), 0, controller.slider.fraction, 1.0, 1.0, 0)
    mode = struct.pack(">Q7?2B3dB", int(controller.clock_s * _MICROSECONDS), *flags, *numbers)
    joint_mode = int(values["joint_mode"][0])
    rows = zip(values["actual_q"], values["actual_qd"], values["joint_temperatures"], strict=True)
    joints = b"".join(
        struct.pack(">3d4fB", q, q, qd, 0.0, 48.0 * powered, temperature, 0.0, joint_mode)
        for q, qd, temperature in rows
    )
    controller.refresh_poses()
    cartesian = struct.pack(">12d", *values["actual_TCP_pose"], *controller.tcp)
    return [_sub(_MODE_DATA, mode), _sub(_JOINT_DATA, joints), _sub(_CARTESIAN, cartesian)]
