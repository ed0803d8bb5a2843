"""View of what ``show`` found, by the verb that made it."""

from __future__ import annotations

from cellapp.cell.driving.records import CollectionResult
from cellapp.commands.collect.view import stored_view
from cellapp.commands.compensate.details import details_tables, stored_state, target_details
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.record import Request, View
from cellapp.commands.registry import STORING, records
from cellapp.commands.show.request import ShowRequest
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult, RecordingsResult, Shown
from cellapp.commands.show.tables import history_lines, log_lines, overview_sentences, overview_tables
from cellapp.commands.view.recordings import recording_tables


def view(found: Shown, request: Request | None = None) -> View:
    """Show the part, and whether it still holds."""
    shown = _view_of(found, request)
    old = (f"out of date: {found.out_of_date}; repeat it with '{found.made_by}'",) if found.out_of_date else ()
    if shown.failed and found.part == "plan":
        return View((*shown.parts, *old), shown.failed, shown.checks)
    return View((*shown.parts, *old), found.complaints)


def _view_of(found: Shown, request: Request | None) -> View:
    match found.result:
        case None:
            return View((found.text,))
        case OverviewResult():
            return View((*overview_tables(found.result), *overview_sentences(found.result)))
        case HistoryResult():
            return View(history_lines(found.result))
        case RecordingsResult():
            return View(recording_tables(found.result.recordings))
        case LogResult():
            return View(log_lines(found.result) or ("no log lines to show",))
        case CollectionResult():
            return stored_view(found.result)
    asked = request if isinstance(request, ShowRequest) else None
    target = None if asked is None else asked.target
    if target is not None and found.results is not None and (state := stored_state(found.results, target)):
        details = target_details(state)
        return View((*details_tables(details), *details.sentences))
    stored = ((verb, how) for verb in records(STORING) for how in verb.stored if how.part == found.part)
    verb, how = next(stored, (PLAN, None))
    return verb.view(found.result) if how is None else verb.stored_view(how, found.result)
