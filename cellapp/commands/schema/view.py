"""The JSON schemas as text."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.schema.result import SchemaResult


def view(result: SchemaResult, request: Request | None = None) -> View:
    """Show the schemas."""
    return View((result.text,), is_json=True)
