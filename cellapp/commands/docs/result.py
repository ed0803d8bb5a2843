"""Result of ``docs``."""

from __future__ import annotations

from cellapp.ground.results import Result


class DocsResult(Result, schema="cellapp-docs"):
    """``docs``: a chapter or section of the handbook as Markdown, or the files that were drawn."""

    topic: str
    text: str | None = None
    files: tuple[str, ...] = ()
