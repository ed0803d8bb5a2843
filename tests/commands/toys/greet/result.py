"""Result of ``greet``."""

from __future__ import annotations

from cellapp.ground.results import Result


class GreetResult(Result, schema="toy-greet"):
    """``greet``: whom it greeted, and how often."""

    arms: tuple[str, ...]
    times: int
