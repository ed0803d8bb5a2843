"""The result of ``at-rest`` as a sentence."""

from __future__ import annotations

from cellapp.commands.at_rest.result import AtRestResult
from cellapp.commands.record import Request, View


def view(result: AtRestResult, request: Request | None = None) -> View:
    """Say whether the arm counted as moving before."""
    words = "recorded as seen at rest" if result.counted_as_moving else "it did not count as moving"
    return View((f"arm {result.arm}: {words}",))
