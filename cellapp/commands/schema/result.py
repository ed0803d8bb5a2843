"""Result of ``schema``."""

from __future__ import annotations

from cellapp.ground.results import Result


class SchemaResult(Result, schema="cellapp-schema"):
    """``schema``: JSON schemas as a text, which is its JSON, too."""

    has_own_schema = False
    text: str

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the schemas themselves."""
        return self.text
