"""The result of ``docs`` as text."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.docs.result import DocsResult
from cellapp.commands.record import Request, View


def view(result: DocsResult, request: Request | None = None) -> View:
    """Show the text, or how many files were drawn where."""
    if result.text is not None:
        return View((result.text.rstrip("\n"),))
    return View((f"{len(result.files)} {result.topic} in {Path(result.files[0]).parent}",))
