"""Result of ``compensate`` of a program: a controller's program with its targets corrected by the calibrated model.

Targets of a program: the target of each motion, its tool frame, and the place of its numbers in the text.

Programs of both kinds (``.script``, ``.urp``) are read into these; ``solving`` computes and writes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from cellapp.estimation.uncertainty.records import CommonUncertainty, Six
from cellapp.ground.results import Record, Result

TargetKind = Literal["pose", "joints"]


@dataclass(frozen=True)
class ArmPlace:
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
    place : ArmPlace
        Place where the new numbers may be written: at the motion itself.
    as_joints : bool
        Whether joint positions must be written at ``place`` although a pose was meant.
    shared : ArmPlace or None
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
    place: ArmPlace
    as_joints: bool = False
    shared: ArmPlace | None = None
    position_only: bool = False
    facing: Six | None = None


@dataclass(frozen=True)
class UnchangedMotion:
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
        Text to which the offsets of ``ArmPlace`` refer.
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
    left: tuple[UnchangedMotion, ...]
    payload_kg: float | None
    encode: Callable[[str], bytes]
    notes: tuple[str, ...] = ()


class CorrectedTarget(Record):
    """One target of a motion in a program.

    Attributes
    ----------
    line : int
        Line of the motion, from 1; in a ``.urp`` of its unpacked XML.
    command : str
    kind : str
        ``pose``: x, y, z [m] and rotation vector [rad]; ``joints``: joint positions [rad].
    old, new : six numbers
        What the program has and gets; ``new`` is None where ``reason`` says why it has no correction.
    correction_mm, correction_mrad : float or None
        How far the commanded TCP pose moves and turns.
    q_new : six numbers or None
        Joint positions that a plain controller computes for ``new`` [rad].
    uncertainty_mm, uncertainty_mrad : float or None
        Standard uncertainties of a coordinate of the TCP and of the flange's orientation there, by the model; None
        where it states none.
    own_mm, own_mrad : float or None
        The same without what is common to all targets (``CommonUncertainty``).
    significant : bool or None
        False where the target is left as taught, as the correction is not significant against its own uncertainty.
    nearest_to : str
        What selected among the solutions of a pose: ``qnear``, a line, or ``home``; ``readings`` or ``reach`` if it is
        the only one in their ranges or within reach; empty for joint positions.
    reason : str
        Why it is not corrected; empty if it is.
    """

    line: int
    command: str
    kind: TargetKind
    old: Six
    new: Six | None = None
    correction_mm: float | None = None
    correction_mrad: float | None = None
    q_new: Six | None = None
    uncertainty_mm: float | None = None
    uncertainty_mrad: float | None = None
    own_mm: float | None = None
    own_mrad: float | None = None
    significant: bool | None = None
    nearest_to: str = ""
    reason: str = ""


class CorrectResult(Result, schema="cellapp-correct"):
    """``compensate`` of a program: every target and what was assumed; ``out`` is None where nothing was written."""

    program: str
    out: str | None
    arm: str
    targets: tuple[CorrectedTarget, ...]
    left: tuple[UnchangedMotion, ...]
    assumptions: tuple[str, ...]
    notes: tuple[str, ...] = ()
    common: tuple[CommonUncertainty, ...] = ()

    @property
    def refused(self) -> tuple[tuple[int, str, str], ...]:
        """Line, command and reason of each target that is not corrected, sorted by line."""
        found = [(one.line, one.command, one.reason) for one in self.targets if one.reason]
        found += [(one.line, one.command, one.reason) for one in self.left if one.refused]
        return tuple(sorted(found))
