"""Write new numbers into the text of a program; everything else stays unchanged, byte for byte."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.programs.records import CorrectedTarget
from cellapp.cell.programs.targets import Place, ProgramTarget

_DIGITS = 10
"""Digits after the decimal point: 0.1 nm and 0.1 nrad."""
_AGREE = 1e-9
"""If the new numbers [m, rad] for all uses of a variable differ by less, they are written at its assignment."""


def rewritten(text: str, targets: Sequence[ProgramTarget], corrected: Sequence[CorrectedTarget]) -> str:
    """Return the text with the new numbers of all targets that have some.

    Numbers of a variable change at its assignment if all its uses are targets with the same new numbers; otherwise they
    are written at each use.
    """
    edits: dict[tuple[int, int], str] = {}
    for target, result in zip(targets, corrected, strict=True):
        if result.new is None or result.new == result.old:
            continue
        if target.shared is not None and _agree(target.shared, targets, corrected):
            edits.update(_edits(target.shared, result.new, pose=target.kind == "pose"))
        elif target.as_joints and result.q_new is not None:
            edits.update(_edits(target.place, result.q_new, pose=False))
        else:
            edits.update(_edits(target.place, result.new, pose=target.kind == "pose"))
    for (start, end), new in sorted(edits.items(), reverse=True):
        text = text[:start] + new + text[end:]
    return text


def number_text(value: float) -> str:
    """Format a number as in programs, without an exponent."""
    text = f"{value:.{_DIGITS}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


# -- inside -----------------------------------------------------------------------------------------------------------


def _agree(shared: Place, targets: Sequence[ProgramTarget], corrected: Sequence[CorrectedTarget]) -> bool:
    """Return whether all uses of a variable have the same new numbers."""
    found = [result.new for target, result in zip(targets, corrected, strict=True) if target.shared == shared]
    known = [one for one in found if one is not None]
    return len(known) == len(found) and bool(np.ptp(np.array(known), axis=0).max() < _AGREE)


def _edits(place: Place, numbers: Sequence[float], *, pose: bool) -> dict[tuple[int, int], str]:
    texts = [number_text(value) for value in numbers]
    if place.numbers:
        return dict(zip(place.numbers, texts, strict=True))
    return {(place.start, place.end): f"{'p' if pose else ''}[{', '.join(texts)}]"}
