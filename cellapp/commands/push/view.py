"""The result of ``push`` as tables and sentences."""

from __future__ import annotations

from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.compensate.charts import target_charts
from cellapp.commands.compensate.tables import all_measured_tables, verification_tables
from cellapp.commands.compensate.words import push_lines, verify_lines
from cellapp.commands.push.request import PushRequest
from cellapp.commands.record import Request, View
from cellapp.commands.view.parts import Part

_HELD = "the verification held"


def view(result: VerifyResult, request: Request | None = None) -> View:
    """Show what was reached and measured; of a stored verification every target, with charts.

    Only a push that measures can fail.
    """
    if request is None:
        charts = target_charts(result, dict.fromkeys(result.arms))
        return View((*all_measured_tables(result), *verify_lines(result), *charts), result.complaints(), held=_HELD)
    verified = isinstance(request, PushRequest) and request.verify
    parts: tuple[Part, ...] = (*verification_tables(result), *push_lines(result))
    return View(parts, result.complaints(), held=_HELD) if verified else View(parts)
