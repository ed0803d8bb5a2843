"""Errors against their tolerances, as shown on the page's first screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from cellapp.commands.view.acceptance_words import CHARACTERISTIC_WORDS
from cellapp.estimation.uncertainty.records import Judgement


@dataclass
class JudgedRow:
    """One characteristic: judgements by arm, or one of several arms together without a column of its own."""

    label: str
    tolerance: float
    by_arm: dict[str, Judgement] = field(default_factory=dict)
    together: Judgement | None = None


@dataclass(frozen=True)
class JudgedMatrix:
    """Characteristics in rows, arms in columns."""

    arms: tuple[str, ...]
    rows: tuple[JudgedRow, ...]


def judged_matrix(judgements: Sequence[Judgement], arms: Sequence[str]) -> JudgedMatrix:
    """Arrange judgements in a matrix: those of one characteristic by one tolerance form a row."""
    rows: list[JudgedRow] = []
    for one in judgements:
        label = CHARACTERISTIC_WORDS[one.characteristic]
        if one.where not in arms:
            more = "" if one.characteristic == "cooperative" and len(arms) == 2 else f", {one.where}"
            rows.append(JudgedRow(label + more, one.tolerance, together=one))
            continue
        free = (
            row
            for row in rows
            if (row.label, row.tolerance, row.together) == (label, one.tolerance, None) and one.where not in row.by_arm
        )
        row = next(free, None)
        if row is None:
            row = JudgedRow(label, one.tolerance)
            rows.append(row)
        row.by_arm[one.where] = one
    shown = tuple(arm for arm in arms if any(arm in row.by_arm for row in rows))
    return JudgedMatrix(shown, tuple(rows))
