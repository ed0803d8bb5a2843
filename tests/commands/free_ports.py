"""Emulated arms on ports that the operating system chooses, so that tests do not depend on free standard ports."""

from __future__ import annotations

from dataclasses import replace

from cellapp.commands.emulate.run import EmulatedArm, emulated_arms
from cellapp.ground.profile import Profile


def on_free_ports(profile: Profile) -> list[EmulatedArm]:
    """The emulated arms of a profile on free ports."""
    return [
        replace(arm, dashboard_port=0, primary_port=0, script_port=0, rtde_port=0) for arm in emulated_arms(profile)
    ]
