"""The result of ``at-rest`` as a sentence."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.run_results import AtRestResult


def view(result: AtRestResult, request: Request | None = None) -> View:
    """Whether the arm counted as moving."""
    words = "recorded as seen at rest" if result.counted_as_moving else "it did not count as moving"
    return View((f"arm {result.arm}: {words}",))
