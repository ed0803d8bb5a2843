"""Result of ``report``, and how a verb gives all current results of a run with its own."""

from __future__ import annotations

from typing import TypeVar

from cellapp.commands.run_results import RunResults


class ReportResult(RunResults, schema="cellapp-report"):
    """``report``: the page, and the results that it shows."""

    page: str


R = TypeVar("R", bound=RunResults)


def shown_by(kind: type[R], stored: RunResults, **more: object) -> R:
    """Return the stored results as the result of a verb that shows them."""
    return kind.model_validate({**{name: getattr(stored, name) for name in stored.model_fields_set}, **more})
