"""What ``emulate`` serves, as sentences."""

from __future__ import annotations

from cellapp.commands.emulate.result import EmulatedArm, EmulateResult
from cellapp.commands.record import Request, View


def view(result: EmulateResult, request: Request | None = None) -> View:
    """Show the controllers and their ports."""
    served = [_arm_words(arm) for arm in result.arms]
    if (tracker := result.tracker) is not None:
        served.append(f"tracker: simulated, bridge protocol at {tracker.host} port {tracker.port}")
    return View((*served, "Ctrl-C ends this"))


def _arm_words(arm: EmulatedArm) -> str:
    return (
        f"arm {arm.arm}: {arm.controller.model} ({arm.controller.series}), serial {arm.controller.serial},"
        f" at {arm.host}: dashboard {arm.dashboard_port}, primary {arm.primary_port}, script {arm.script_port},"
        f" RTDE {arm.rtde_port}; faults on command at 127.0.0.1:{arm.control_port}"
    )
