"""Result of ``at-rest``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class AtRestResult(Result):
    """``at-rest``: the arm that a person has seen at rest, and whether it counted as moving."""

    schema_: Literal["cellapp-at-rest"] = "cellapp-at-rest"
    version: Literal[1] = 1
    run: str
    arm: str
    counted_as_moving: bool
