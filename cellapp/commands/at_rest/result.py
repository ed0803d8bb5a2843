"""Result of ``at-rest``."""

from __future__ import annotations

from cellapp.ground.results import Result


class AtRestResult(Result, schema="cellapp-at-rest"):
    """``at-rest``: the arm that a person has seen at rest, and whether it counted as moving."""

    run: str
    arm: str
    counted_as_moving: bool
