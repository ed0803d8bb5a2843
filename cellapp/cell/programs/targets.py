"""Targets of a program: the target of each motion, its tool frame, and the place of its numbers in the text.

Programs of both kinds (``.script``, ``.urp``) are read into these; ``solving`` computes and writes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Six = tuple[float, float, float, float, float, float]
TargetKind = Literal["pose", "joints"]


@dataclass(frozen=True)
class Place:
    """Place of numbers in the text: each number's offsets, or one expression from ``start`` to ``end``."""

    start: int
    end: int
    numbers: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class ProgramTarget:
    """One target of a motion.

    Attributes
    ----------
    line : int
        Line of the motion, from 1.
    command : str
        ``movej``, ``movel``, ...
    kind : str
    numbers : six numbers
        x, y, z [m] and rotation vector [rad] of the TCP in the base frame; or joint positions [rad].
    tcp : six numbers or None
        Pose of the TCP in the flange frame; None for joint positions, where it does not matter.
    near : six numbers or None
        ``qnear``: the solution nearest to these joint positions [rad] is meant.
    function : str
        Function or thread that contains the motion.
    place : Place
        Place where the new numbers may be written: at the motion itself.
    as_joints : bool
        Whether joint positions must be written at ``place`` although a pose was meant.
    shared : Place or None
        Place of the numbers of a variable that nothing else uses; preferred to ``place`` if all its uses agree.
    position_only : bool
        Whether the rotation is not used (the via point of ``movec``); then ``facing`` is used.
    facing : six numbers or None
        Pose with approximately the arm's rotation there.
    """

    line: int
    command: str
    kind: TargetKind
    numbers: Six
    tcp: Six | None
    near: Six | None
    function: str
    place: Place
    as_joints: bool = False
    shared: Place | None = None
    position_only: bool = False
    facing: Six | None = None


@dataclass(frozen=True)
class LeftMotion:
    """Motion that is not changed. ``refused``: it has a target that cannot be corrected."""

    line: int
    command: str
    reason: str
    refused: bool = True


@dataclass(frozen=True)
class ReadProgram:
    """Program as read.

    Attributes
    ----------
    text : str
        Text to which the offsets of ``Place`` refer.
    targets, left : tuples
        Targets and unchanged motions in the order of the text.
    payload_kg : float or None
        Payload of ``set_payload``, if all calls agree.
    encode : function
        Function that returns the bytes of the file for the changed text.
    notes : tuple of str
    """

    text: str
    targets: tuple[ProgramTarget, ...]
    left: tuple[LeftMotion, ...]
    payload_kg: float | None
    encode: Callable[[str], bytes]
    notes: tuple[str, ...] = ()
