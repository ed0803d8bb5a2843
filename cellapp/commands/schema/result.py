"""Result of ``schema``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class SchemaResult(Result):
    """``schema``: JSON schemas as a text, which is its JSON, too."""

    has_own_schema = False
    schema_: Literal["cellapp-schema"] = "cellapp-schema"
    version: Literal[1] = 1
    text: str

    def to_json(self, *, indent: int | None = None) -> str:
        """The schemas themselves."""
        return self.text
