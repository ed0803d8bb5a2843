"""Points that determine the pose of a base: each is known in the tracker frame M and at the arm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Self

from pydantic import ValidationError, model_validator

from cellapp.cell.profile.loader import is_number
from cellapp.cell.profile.messages import dotted, value_message
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import CellPoint
from cellapp.ground.profile.smr import ArmPoint
from drivers.quantities import Turn
from drivers.settings import Section

_COORDINATES = 3
"""Number of coordinates of a point; no arm of this program has as few joints."""


class SurveyPoint(Section):
    """One point: ``tracker`` in M, and either ``base`` in the base frame B or the ``joints`` with the SMR there."""

    tracker: CellPoint
    base: ArmPoint | None = None
    joints: tuple[Turn, ...] | None = None

    @model_validator(mode="after")
    def _known_at_the_arm(self) -> Self:
        if (self.base is None) == (self.joints is None):
            raise ValueError(
                "give 'base' (coordinates in the base frame) or 'joints' (joint positions), one of the two"
            )
        return self


def points_of_text(text: str) -> tuple[SurveyPoint, ...]:
    """Parse points from a text with a line for each: "at the arm ; in the tracker frame".

    Three values at the arm are coordinates in the base frame, more are joint positions.

    Raises
    ------
    InputError
        If a line is no such point.
    """
    return tuple(_points_of(text))


def _points_of(text: str) -> Iterator[SurveyPoint]:
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        at_arm, found, tracker = line.partition(";")
        if not found:
            raise InputError(f"line {number}: expected two lists with a semicolon between them: at the arm ; tracker")
        values = _values(at_arm)
        known = "base" if len(values) == _COORDINATES else "joints"
        try:
            yield SurveyPoint.model_validate({known: values, "tracker": _values(tracker)})
        except ValidationError as error:
            details = error.errors(include_url=False)[0]
            raise InputError(f"line {number}: {dotted(details['loc'])}: {value_message(details)}") from None


def _values(text: str) -> list[Any]:
    """Split a list at commas into numbers, and texts with a unit."""
    return [float(item) if is_number(item) else item for item in map(str.strip, text.split(","))]
