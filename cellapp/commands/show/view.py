"""View of what ``show`` found, by the verb that made it."""

from __future__ import annotations

import json

from cellapp.cell.profile import profile_to_json
from cellapp.cell.run.measurement_order import order_sentences
from cellapp.cell.run.run_arms import UnseenArm
from cellapp.commands.collect.result import CollectionResult
from cellapp.commands.collect.view import recording_tables, stored_view
from cellapp.commands.compensate.target_list import stored_state
from cellapp.commands.compensate.view import target_parts
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.record import View
from cellapp.commands.registry import STORING, records
from cellapp.commands.show.comparison import RunComparison, comparison_sentences, comparison_tables
from cellapp.commands.show.request import ShowRequest
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult, RecordingsResult, Shown, StageState
from cellapp.commands.view.table import Table, table_of, with_rows
from cellapp.ground.profile import Profile
from cellapp.ground.removed import VERSION
from cellapp.ground.results import second_of
from cellapp.ground.shell import shell_word


def overview_tables(state: OverviewResult) -> list[Table]:
    """Show the stops of each arm, and every current stage with whether it holds."""
    return [
        table_of(
            f"Run {state.run}, profile {state.profile}",
            state.arms.items(),
            ("arm", lambda row: row[0]),
            ("type", lambda row: row[1].type),
            ("planned", lambda row: row[1].planned, "d"),
            ("measured", lambda row: row[1].measured, "d"),
            ("splits", lambda row: ", ".join(f"{n} {word}" for word, n in row[1].splits.items())),
        ),
        *with_rows(
            table_of(
                "Stored results",
                state.stages,
                ("stage", "name"),
                ("when (UTC)", lambda stage: second_of(stage.written)),
                ("by", "program"),
                ("state", _holds),
            )
        ),
    ]


def overview_sentences(state: OverviewResult) -> list[str]:
    """State what follows from the order of the readings, what is out of date, the model in force, the next command."""
    sentences = [
        *(unseen_sentence(name, arm, state.run) for name, arm in state.not_seen_at_rest.items()),
        *order_sentences(state.in_order),
        *(
            f"the stored profile has {key}, which version {VERSION} ignores: it was removed"
            for key in state.ignored_keys
        ),
        *(f"OUT OF DATE: {one}" for one in state.complaints),
    ]
    if state.in_force is not None:
        sentences.append(f"model in force: that of '{state.in_force}' (calibration.json)")
    if state.stale:
        sentences.append(f"do not use it as it is: {state.stale}")
    then = f", then 'cellapp {state.next_verb} DIR TARGETS'" if state.next_step == "cellapp docs targets" else ""
    sentences.append(f"next: {state.next_step}{then}" if state.next_step else "next: nothing is left to do")
    return sentences


def unseen_sentence(name: str, arm: UnseenArm, run: str) -> str:
    """State the danger of an arm that was not seen at rest, and how to settle it."""
    return (
        f"arm {name}: NOT SEEN AT REST since {second_of(arm.since)} UTC: treat it as moving ({arm.reason.rstrip('.')})."
        " A job that sees it at rest settles this, or a person who has seen it: 'cellapp job confirm-rest"
        f" {shell_word(run)} {name}'"
    )


def history_lines(history: HistoryResult) -> list[str]:
    """Return every stored stage, oldest first, each with its basis."""
    lines = []
    for stage in history.stages:
        when, digest = second_of(stage.written), stage.digest[:12]
        lines.append(f"{stage.number:>4}  {stage.name:10}  {when}  {digest}  {stage.program}")
        lines.append(f"      {_holds(stage)}")
        lines.append(f"      rests on: {', '.join(stage.rests_on)}")
    return lines


def log_lines(log: LogResult) -> list[str]:
    """Return the log, one line each."""
    return [f"{line.written}  {line.level:8} {line.text}" for line in log.lines]


def profile_text(profile: Profile) -> str:
    """Return the profile as indented JSON."""
    return json.dumps(json.loads(profile_to_json(profile)), indent=1)


def _holds(stage: StageState) -> str:
    if stage.superseded:
        return "superseded"
    return "holds" if stage.out_of_date is None else f"out of date: {stage.out_of_date}"


def view(found: Shown, request: ShowRequest | None = None) -> View:
    """Show the part, and whether it still holds."""
    shown = _view_of(found, request)
    old = (f"out of date: {found.out_of_date}; repeat it with {found.made_by}",) if found.out_of_date else ()
    if shown.failed and found.part == "plan":
        return View((*shown.parts, *old), shown.failed, shown.checks)
    return View((*shown.parts, *old), found.complaints)


def _view_of(found: Shown, request: ShowRequest | None) -> View:
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
        case RunComparison():
            return View((*comparison_tables(found.result), *comparison_sentences(found.result)))
        case CollectionResult():
            return stored_view(found.result)
    target = None if request is None else request.target
    if target is not None and found.results is not None and (state := stored_state(found.results, target)):
        return View(target_parts(found.results, state))
    stored = ((verb, how) for verb in records(STORING) for how in verb.stored if how.part == found.part)
    verb, how = next(stored, (PLAN, None))
    return verb.view(found.result) if how is None else verb.stored_view(how, found.result)
