"""Result of ``correct``: a controller's program with its targets corrected by the calibrated model."""

from __future__ import annotations

from cellapp.cell.programs.targets import TargetKind
from cellapp.ground.results import Record, Result

Numbers = tuple[float, float, float, float, float, float]


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
    nearest_to : str
        What selected among the solutions of a pose: ``qnear``, a line, or ``home``; empty for joint positions.
    reason : str
        Why it is not corrected; empty if it is.
    """

    line: int
    command: str
    kind: TargetKind
    old: Numbers
    new: Numbers | None = None
    correction_mm: float | None = None
    correction_mrad: float | None = None
    q_new: Numbers | None = None
    uncertainty_mm: float | None = None
    uncertainty_mrad: float | None = None
    nearest_to: str = ""
    reason: str = ""


class LeftLine(Record):
    """A motion that stays as it is; ``refused`` if it has a target that could not be corrected."""

    line: int
    command: str
    reason: str
    refused: bool


class CorrectResult(Result, schema="cellapp-correct"):
    """``correct``: every target and what was assumed; ``out`` is None where nothing was written."""

    program: str
    out: str | None
    arm: str
    targets: tuple[CorrectedTarget, ...]
    left: tuple[LeftLine, ...]
    assumptions: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def refused(self) -> tuple[tuple[int, str, str], ...]:
        """Line, command and reason of each target that is not corrected, sorted by line."""
        found = [(one.line, one.command, one.reason) for one in self.targets if one.reason]
        found += [(one.line, one.command, one.reason) for one in self.left if one.refused]
        return tuple(sorted(found))
