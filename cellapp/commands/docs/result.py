"""Result of ``docs``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class DocsResult(Result):
    """``docs``: a chapter or section of the handbook as Markdown, or the files that were drawn."""

    schema_: Literal["cellapp-docs"] = "cellapp-docs"
    version: Literal[1] = 1
    topic: str
    text: str | None = None
    files: tuple[str, ...] = ()
