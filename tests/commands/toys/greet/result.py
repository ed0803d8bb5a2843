"""Result of ``greet``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class GreetResult(Result):
    """``greet``: whom it greeted, and how often."""

    schema_: Literal["toy-greet"] = "toy-greet"
    version: Literal[1] = 1
    arms: tuple[str, ...]
    times: int
