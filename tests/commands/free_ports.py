"""Emulated arms on ports that the operating system chooses, so that tests do not depend on free standard ports."""

from __future__ import annotations

from cellapp.commands.emulate import EmulatedArm, emulated_arms
from cellapp.ground.profile import Profile

FREE = ("dashboard_port", "primary_port", "script_port", "rtde_port")


def on_free_ports(profile: Profile) -> list[EmulatedArm]:
    """The emulated arms of a profile on free ports."""
    return [arm.model_copy(update=dict.fromkeys(FREE, 0)) for arm in emulated_arms(profile)]
