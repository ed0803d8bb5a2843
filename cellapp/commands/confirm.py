"""A person's permission before real arms move: the doctor must find no fault now, and the first path is shown in words.

A cell whose arms are simulated, or emulated on this computer, never asks.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.cell.driving.diagnosis import examine
from cellapp.cell.driving.motion import Confirm, Vector
from cellapp.commands.record import Ask
from cellapp.ground.counting import counted
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model.nominal import nominal_arm, pose_matrix

_STILL_RAD = 1e-4
"""Smaller steps are shown as no motion: nobody could see them."""
_MOST_SHOWN = 3
"""Most failed checks in one message; the doctor shows all."""


class MotionNotConfirmed(InputError):
    """Error: real arms would move and nobody allowed it. Nothing has moved."""


def require_permission(profile: Profile, ask: Ask | None) -> None:
    """Raise ``MotionNotConfirmed`` if real arms would move and nobody can be asked."""
    if ask is None and profile.moves_hardware:
        real = [name for name, arm in profile.arms.items() if arm.driver.moves_hardware]
        raise MotionNotConfirmed(
            f"profile {profile.name}: this moves real arms ({', '.join(real)}); nothing was moved. Clear the cell, then"
            " repeat with --allow-motion, or at a terminal, where you are asked"
        )


def confirmation(profile: Profile, ask: Ask | None) -> Confirm | None:
    """Return the callable with which the engine asks before its first motion; None for a cell without real arms.

    Raises
    ------
    MotionNotConfirmed
        If real arms would move and nobody can be asked.
    CheckFailed
        If the doctor finds a fault now. Nothing has moved.
    """
    require_permission(profile, ask)
    if ask is None or not profile.moves_hardware:
        return None
    failed = [finding for finding in examine(profile) if finding.status == "failed"]
    if failed:
        shown = "; ".join(f"{finding.subject}: {finding.text}" for finding in failed[:_MOST_SHOWN])
        raise CheckFailed(
            f"doctor: {counted(len(failed), 'check')} failed, nothing was moved: {shown}; 'cellapp doctor PROFILE'"
            " shows all"
        )
    return lambda start, targets: ask(first_path_words(profile, start, targets))


def asked_once(ask: Ask) -> Ask:
    """Return ``ask`` for a job of several parts: once allowed, it does not ask again for later parts."""
    allowed = False

    def asked(words: str) -> bool:
        nonlocal allowed
        allowed = allowed or ask(words)
        return allowed

    return asked


def first_path_words(profile: Profile, start: Mapping[str, Vector], targets: Mapping[str, Vector]) -> str:
    """Say which arm goes from where to where, one line for each arm; positions (N,) [rad] by name."""
    lines = ["First motion, all arms at once:"]
    lines += [f"  arm {name}: {_path(profile, name, q, targets.get(name, q))}" for name, q in start.items()]
    slow = profile.collection.slow_start
    if slow.stops and profile.moves_hardware:
        lines.append(
            f"  The first {counted(slow.stops, 'stop is', 'stops are')} visited at {slow.speed:.0%} of the"
            " profile's speed."
        )
    return "\n".join(lines)


def _path(profile: Profile, name: str, start: Vector, end: Vector) -> str:
    step = np.abs(end - start)
    if float(step.max()) <= _STILL_RAD:
        return f"stays at {_degrees(end)}"
    joint = int(step.argmax())
    words = (
        f"from {_degrees(start)} to {_degrees(end)}; joint {joint + 1} rotates farthest, by"
        f" {np.degrees(step[joint]):.1f} deg"
    )
    arm = profile.arms[name]
    if arm.base is None:
        return words
    p_C = smr_positions(nominal_arm(arm).with_T_M_B(pose_matrix(arm.base)), np.array([start, end]))
    ends = " to ".join(f"({', '.join(f'{x:z.2f}' for x in p)})" for p in p_C.tolist())
    return f"{words}; its SMR from {ends} m in the cell"


def _degrees(q: Vector) -> str:
    return f"({', '.join(f'{angle:z.1f}' for angle in np.degrees(q).tolist())}) deg"
