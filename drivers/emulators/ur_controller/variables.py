"""RTDE variables and their types in the protocol."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.arms.ur_rtde_reader import FORMATS

REGISTERS = 48
"""Number of integer and of float registers in each direction."""

_OUTPUTS = {
    "DOUBLE": (
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage"
        " actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1"
        " standard_analog_output0 standard_analog_output1 io_current tool_analog_input0 tool_analog_input1"
        " tool_output_current tool_temperature tcp_force_scalar payload"
    ),
    "VECTOR6D": (
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current"
        " actual_current_window joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose"
        " target_TCP_speed joint_temperatures actual_joint_voltage payload_inertia tcp_offset"
    ),
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage",
    "UINT32": (
        "runtime_state robot_status_bits safety_status_bits analog_io_types tool_analog_input_types tool_mode"
        " output_bit_registers0_to_31 output_bit_registers32_to_63 input_bit_registers0_to_31"
        " input_bit_registers32_to_63"
    ),
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
}
_INPUTS = {
    "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "UINT8": (
        "standard_digital_output_mask standard_digital_output configurable_digital_output_mask"
        " configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask"
        " standard_analog_output_type"
    ),
    "VECTOR6D": "external_force_torque",
}


def _by_name(table: dict[str, str], directions: Sequence[str]) -> dict[str, str]:
    known = {name: kind for kind, names in table.items() for name in names.split()}
    for direction in directions:
        for number in range(REGISTERS):
            known[f"{direction}_int_register_{number}"] = "INT32"
            known[f"{direction}_double_register_{number}"] = "DOUBLE"
    return known


OUTPUTS = _by_name(_OUTPUTS, ("input", "output"))
"""Name -> type of the outputs of both series."""
E_SERIES_OUTPUTS = {"ft_raw_wrench": "VECTOR6D"}
INPUTS = _by_name(_INPUTS, ("input",))
"""Name -> type of the inputs."""


def layout(kinds: Sequence[str]) -> struct.Struct:
    """Return the binary layout of consecutive values of the given types."""
    return struct.Struct(">" + "".join(FORMATS[kind] for kind in kinds))


def width(kind: str) -> int:
    """Return how many numbers a value of a type has."""
    one = layout([kind])
    return len(one.unpack(bytes(one.size)))


def zeros() -> dict[str, tuple[float, ...]]:
    """Return every variable with the value zero."""
    kinds = OUTPUTS | E_SERIES_OUTPUTS | INPUTS
    return {name: layout([kind]).unpack(bytes(layout([kind]).size)) for name, kind in kinds.items()}
