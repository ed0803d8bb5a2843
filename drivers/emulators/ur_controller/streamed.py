"""Values of the RTDE variables that depend on a controller's modes and settings."""

from __future__ import annotations

from drivers.emulators.ur_controller import poses
from drivers.emulators.ur_controller.modes import (
    JOINT_MODE,
    JOINT_POWER_OFF,
    SAFETY_BITS,
    RobotMode,
    Runtime,
    SafetyMode,
)
from drivers.emulators.ur_controller.personality import Rows
from drivers.emulators.ur_controller.variables import zeros

Values = tuple[float, ...]


def initial_values(q: Values) -> dict[str, Values]:
    """Return every variable of a controller whose arm rests at ``q`` (6,) [rad]."""
    return zeros() | {
        "actual_q": q,
        "target_q": q,
        "actual_main_voltage": (48.0,),
        "speed_scaling": (1.0,),
        "target_speed_fraction": (1.0,),
        "actual_tool_accelerometer": (0.0, 0.0, 9.82),
    }


def of_modes(robot_mode: RobotMode, safety_mode: SafetyMode, runtime: Runtime) -> dict[str, Values]:
    """Return the variables that show the modes."""
    powered = robot_mode not in (RobotMode.POWER_OFF, RobotMode.DISCONNECTED)
    running = runtime in (Runtime.PLAYING, Runtime.RESUMING)
    return {
        "robot_mode": (int(robot_mode),),
        "safety_mode": (int(safety_mode),),
        "safety_status": (int(safety_mode),),
        "runtime_state": (int(runtime),),
        "robot_status_bits": (powered * 1 | running * 2 | powered * 8,),
        "safety_status_bits": (SAFETY_BITS[safety_mode],),
        "joint_mode": (JOINT_MODE.get(robot_mode, JOINT_POWER_OFF),) * 6,
        "actual_robot_voltage": (48.0 * powered,),
    }


def of_load(mass: float, center: Values, inertia: Values, tcp: Values) -> dict[str, Values]:
    """Return the variables that show payload and TCP."""
    return {"payload": (mass,), "payload_cog": center, "payload_inertia": inertia, "tcp_offset": tcp}


def of_tool(rows: Rows, q: Values, qd: Values, tcp: Values) -> dict[str, Values]:
    """Return the variables that show pose and speed of the TCP, at joint positions and speeds (6,) [rad, rad/s]."""
    frames = poses.chain(rows, q)
    tool = poses.composed(frames[-1], poses.frame(tcp))
    pose = poses.pose(tool)
    return {"actual_TCP_pose": pose, "target_TCP_pose": pose, "actual_TCP_speed": poses.speed(frames, qd, tool.p)}
