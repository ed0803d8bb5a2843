"""Dashboard server: one line per command and answer. The texts of refusals were not compared with a real controller."""

from __future__ import annotations

from collections.abc import Callable

from drivers.arms.ur_rtde_reader import ProgramState, SafetyMode
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.script import ForeignProgram

GREETING = "Connected: Universal Robots Dashboard Server"

_LOCAL = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port"
    " 29999"
)
"""Answer of real controllers in local control; a connection that was opened in local control stays refused."""
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
_REMOTE_ONLY = (
    "play",
    "pause",
    "stop",
    "load",
    "load installation",
    "power on",
    "power off",
    "brake release",
    "unlock protective stop",
    "restart safety",
    "shutdown",
)
_PROGRAM_STATES = {
    ProgramState.STOPPED: "STOPPED",
    ProgramState.STOPPING: "STOPPED",
    ProgramState.PAUSING: "PAUSED",
    ProgramState.PAUSED: "PAUSED",
}
_ACKNOWLEDGED = {
    "close popup": "closing popup",
    "popup": "showing popup",
    "addToLog": "Added log message",
    "close safety popup": "closing safety popup",
}
_NOT_EMULATED = (
    "load",
    "load installation",
    "shutdown",
    "set operational mode",
    "clear operational mode",
    "setUserRole",
)


def answer(controller: Controller, line: str, *, opened_in_remote: bool = True) -> str:
    """Execute a line and return the answer; ``opened_in_remote``: commands were allowed when the connection opened."""
    answer_to_question = _questions(controller).get(line)
    if answer_to_question is not None:
        return answer_to_question
    commands = _commands(controller)
    refused = f"Failed to execute: {line}"
    allowed = controller.accepts_commands and opened_in_remote
    if not allowed and any(_is_command(line, command) for command in _REMOTE_ONLY):
        return _LOCAL
    if line in commands:
        return commands[line]() or refused
    for command, acknowledged in _ACKNOWLEDGED.items():
        if _is_command(line, command):
            if command == "addToLog":
                controller.log.append(f"dashboard: {line[9:209]}")
            return acknowledged
    if any(_is_command(line, command) for command in _NOT_EMULATED):
        return refused
    return f"could not understand: '{line}'"


def _is_command(line: str, command: str) -> bool:
    return line == command or line.startswith(f"{command} ")


def _questions(controller: Controller) -> dict[str, str]:
    personality = controller.config.personality
    safety = SafetyMode(controller.safety_mode).name
    known = {
        "PolyscopeVersion": personality.software,
        "get robot model": personality.model,
        "get serial number": personality.serial,
        "robotmode": f"Robotmode: {controller.robot_mode.name}",
        "safetymode": f"Safetymode: {safety}",
        "running": f"Program running: {str(controller.running).lower()}",
        "programState": f"{_PROGRAM_STATES.get(controller.runtime, 'PLAYING')} {_program_name(controller)}",
        "get loaded program": _loaded(controller),
        "isProgramSaved": "true <unnamed>",
        "quit": "Disconnected",
    }
    if personality.series == "e-Series":
        known |= {
            "safetystatus": f"Safetystatus: {safety}",
            "is in remote control": str(controller.remote_control).lower(),
            "get operational mode": "NONE",
        }
    return known


def _program_name(controller: Controller) -> str:
    """Return the name of the program; that of an uploaded one was not compared with a real controller."""
    return "<unnamed>" if controller.program is None else controller.program.name


def _loaded(controller: Controller) -> str:
    if isinstance(controller.program, ForeignProgram):
        return f"Loaded program: /programs/{controller.program.name}"
    return "No program loaded"


def _commands(controller: Controller) -> dict[str, Callable[[], str]]:
    """Return the function of each command; an empty answer is a refusal."""

    def stop() -> str:
        controller.stop_program("dashboard: stop")
        return "Stopped"

    def power_off() -> str:
        controller.power_off("dashboard: power off")
        return "Powering off"

    def restart_safety() -> str:
        return "Restarting safety" if controller.safety_mode is SafetyMode.NORMAL else ""

    return {
        "stop": stop,
        "pause": lambda: "Pausing program" if controller.pause_program() else "",
        "play": lambda: "Starting program" if controller.resume_program() else "",
        "power on": lambda: "Powering on" if controller.power_on() else "",
        "brake release": lambda: "Brake releasing" if controller.release_brakes() else "",
        "power off": power_off,
        "unlock protective stop": lambda: "Protective stop releasing" if controller.unlock() else _TOO_EARLY,
        "restart safety": restart_safety,
    }
