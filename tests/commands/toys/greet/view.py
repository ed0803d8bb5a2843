"""The result of ``greet`` for people."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Column, Table, number_column
from tests.commands.toys.greet.result import GreetResult


def view(result: GreetResult, request: Request | None = None) -> View:
    """Whom, and how often."""
    rows = tuple((arm, result.times) for arm in result.arms)
    return View((Table("Greeted", (Column("arm"), number_column("times", "d")), rows), "hello to all of them"))
