"""What a person must do about the safety modes and robot modes of a UR arm. Loads no numpy: the worker uses it, too."""

from __future__ import annotations

from drivers.arms.protocol import ArmError, EmergencyStop, ProtectiveStop

_SAFETY_REMEDY = {
    "REDUCED": "speeds and forces are limited: leave the area or clear the input that triggers it",
    "PROTECTIVE_STOP": "go to the arm, see what stopped it, clear the cause, then enable the robot on the pendant",
    "RECOVERY": "a limit is exceeded: jog the arm back inside on the pendant",
    "SAFEGUARD_STOP": "close the guard or clear the light curtain, then reset the safeguard",
    "SYSTEM_EMERGENCY_STOP": "an emergency stop of the cell is pressed: find out why, release it, power the arm on",
    "ROBOT_EMERGENCY_STOP": "the pendant's emergency stop is pressed: find out why, release it, power the arm on",
    "VIOLATION": "a safety limit was violated: read the pendant's log, then restart the safety system there",
    "FAULT": "the safety system is at fault: read the pendant's log, then restart it there",
}
_NAMES = {ProtectiveStop: "protective stop", EmergencyStop: "emergency stop"}


def safety_error(mode: str) -> type[ArmError]:
    """Return the exception for a safety mode other than normal."""
    if mode.endswith("EMERGENCY_STOP"):
        return EmergencyStop
    return ProtectiveStop if mode == "PROTECTIVE_STOP" else ArmError


def safety_remedy(mode: str) -> str:
    """Return what a person must do about a safety mode other than normal."""
    return _SAFETY_REMEDY.get(mode, "look at the pendant")


def not_ready(robot_mode: str, safety_mode: str) -> tuple[str, str] | None:
    """Return why an arm in these modes accepts no motion, and the remedy; None if it accepts motions."""
    if safety_mode != "NORMAL":
        return _NAMES.get(safety_error(safety_mode), f"safety mode {safety_mode}"), safety_remedy(safety_mode)
    if robot_mode != "RUNNING":
        return f"robot mode {robot_mode}, needed is RUNNING", "power the arm on and release its brakes on the pendant"
    return None
