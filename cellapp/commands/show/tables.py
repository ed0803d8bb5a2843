"""Tables and sentences of ``show``: the state of a run, its history, plan and log."""

from __future__ import annotations

import json

from cellapp.cell.profile import profile_to_json
from cellapp.cell.run.in_order import order_sentences
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult, StageState, UnseenArmState
from cellapp.commands.view.table import Column, Table, number_column
from cellapp.ground.profile import Profile
from cellapp.ground.times import second_of


def overview_tables(state: OverviewResult) -> list[Table]:
    """Stops of each arm, and every current stage with whether it holds."""
    arms = Table(
        f"Run {state.run}, profile {state.profile}",
        (
            Column("arm"),
            Column("type"),
            number_column("planned", "d"),
            number_column("measured", "d"),
            Column("splits"),
        ),
        tuple(
            (name, arm.type, arm.planned, arm.measured, ", ".join(f"{n} {word}" for word, n in arm.splits.items()))
            for name, arm in state.arms.items()
        ),
    )
    if not state.stages:
        return [arms]
    columns = (Column("stage"), Column("when (UTC)"), Column("by"), Column("state"))
    rows = tuple((stage.name, second_of(stage.written), stage.program, _holds(stage)) for stage in state.stages)
    return [arms, Table("Stored results", columns, rows)]


def overview_sentences(state: OverviewResult) -> list[str]:
    """What was derived from the order of the readings, what is out of date, the model in force, the next command."""
    sentences = [
        *(unseen_sentence(name, arm, state.run) for name, arm in state.not_seen_at_rest.items()),
        *order_sentences(state.in_order),
        *(f"OUT OF DATE: {one}" for one in state.complaints),
    ]
    if state.in_force is not None:
        sentences.append(f"model in force: that of '{state.in_force}' (calibration.json)")
    if state.stale:
        sentences.append(f"do not use it as it is: {state.stale}")
    sentences.append(f"next: {state.next_step}" if state.next_step else "next: nothing is left to do")
    return sentences


def unseen_sentence(name: str, arm: UnseenArmState, run: str) -> str:
    """What a person must know of an arm that was not seen at rest, and how it is settled."""
    return (
        f"arm {name}: NOT SEEN AT REST since {second_of(arm.since)} UTC: treat it as moving ({arm.reason.rstrip('.')})."
        f" A job that sees it at rest settles this, or a person who has seen it: 'cellapp at-rest {run} {name}'"
    )


def history_lines(history: HistoryResult) -> list[str]:
    """Every stored stage, oldest first, each with what it rests on."""
    lines = []
    for stage in history.stages:
        number = str(stage.number) if stage.number else "-"
        lines.append(f"{number:>4}  {stage.name:10}  {second_of(stage.written)}  {stage.digest[:12]}  {stage.program}")
        lines.append(f"      {_holds(stage)}")
        lines.append(f"      rests on: {', '.join(stage.rests_on)}")
    return lines


def log_lines(log: LogResult) -> list[str]:
    """The log, one line each."""
    return [f"{line.written}  {line.level:8} {line.text}" for line in log.lines]


def profile_text(profile: Profile) -> str:
    """The profile as indented JSON."""
    return json.dumps(json.loads(profile_to_json(profile)), indent=1)


def _holds(stage: StageState) -> str:
    if stage.superseded:
        return "superseded"
    return "holds" if stage.out_of_date is None else f"out of date: {stage.out_of_date}"
