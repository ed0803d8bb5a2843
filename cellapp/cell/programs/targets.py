"""The targets of a program: what each motion is sent to, in which tool frame, and where its numbers stand.

A program of either kind (``.script``, ``.urp``) is read into these; ``correction`` computes, ``rewriting`` writes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Six = tuple[float, float, float, float, float, float]
TargetKind = Literal["pose", "joints"]


@dataclass(frozen=True)
class Place:
    """Where numbers stand in the text: each at its own place, or all as one expression from ``start`` to ``end``."""

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
        Function or thread that the motion stands in.
    place : Place
        Where the new numbers may be written: at the motion itself.
    as_joints : bool
        Whether joint positions must be written at ``place`` although a pose was meant.
    shared : Place or None
        Where the numbers of a variable stand that nothing else uses; better than ``place`` if all its uses agree.
    position_only : bool
        Whether the rotation is not used (the point on the way of ``movec``); ``facing`` is used then.
    facing : six numbers or None
        Pose whose rotation the arm has about there.
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
    """A motion that is left as it is. ``refused``: it has a target that this program cannot correct."""

    line: int
    command: str
    reason: str
    refused: bool = True


@dataclass(frozen=True)
class ReadProgram:
    """What was read.

    Attributes
    ----------
    text : str
        What ``Place`` counts in.
    targets, left : tuples
        In the order of the text.
    payload_kg : float or None
        What ``set_payload`` says, where it says one thing.
    encode : function
        The bytes of the file from the changed text.
    notes : tuple of str
    """

    text: str
    targets: tuple[ProgramTarget, ...]
    left: tuple[LeftMotion, ...]
    payload_kg: float | None
    encode: Callable[[str], bytes]
    notes: tuple[str, ...] = ()
