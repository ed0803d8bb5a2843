"""The state of a run as results of ``show``. Everything here only reads."""

from __future__ import annotations

import json

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.measurement_order import read_in_order
from cellapp.cell.run.run_arms import unseen_arms
from cellapp.cell.run.sqlite_file import Event
from cellapp.commands.run_state import RunState
from cellapp.commands.show.result import HistoryResult, LogResult, OverviewResult, StageState
from cellapp.commands.stages import RunStages, StoredStage, read_history
from cellapp.ground.counting import counted
from cellapp.ground.removed import without_removed_keys
from cellapp.ground.results import STAGE_NAMES


def run_overview(state: RunState) -> OverviewResult:
    """Return profile, arms, current stages, and the next command."""
    run, stages, after = state.run, state.stages, state.next_step
    return OverviewResult(
        run=str(run.folder),
        profile=run.profile.name,
        arms=state.arms,
        in_order=read_in_order(run),
        stages=tuple(_state(stage, stages) for stage in (*stages.current.values(), *_of_removed_steps(run))),
        in_force=None if stages.in_force is None else stages.in_force.name,
        stale="" if stages.in_force is None else stages.stale_model(),
        next_verb=after.verb,
        next_step=after.short,
        complaints=tuple(state.complaints),
        not_seen_at_rest=unseen_arms(run),
        ignored_keys=tuple(without_removed_keys(json.loads(run.profile_text))[1]),
    )


def run_history(state: RunState) -> HistoryResult:
    """Return every stage that was ever stored, oldest first."""
    stages = tuple(_state(stage, state.stages) for stage in read_history(state.run))
    return HistoryResult(run=str(state.run.folder), stages=stages)


def run_log(run: RunFile, level: str | None = None, last: int | None = None) -> LogResult:
    """Return lines of the log, oldest first; only those of one ``level`` and only the ``last`` ones, if given.

    Sessions of collecting and stages, which the run stores with their times, are lines of it, too, without a number.
    """
    own = [(stage.written, f"'{stage.name}' stored by {stage.program}") for stage in read_history(run)]
    for one in run.sessions():
        what = f"session {one.number} of collecting"
        own += [(one.began, f"{what} began")] + ([(one.ended, f"{what} ended: {one.outcome}")] if one.ended else [])
    found = [*run.events(), *(Event(0, written, None, "info", text) for written, text in own)]
    lines = sorted((one for one in found if level is None or one.level == level), key=lambda one: one.written)
    return LogResult(run=str(run.folder), lines=tuple(lines if last is None else lines[-last:]))


def _of_removed_steps(run: RunFile) -> list[StoredStage]:
    """Return the newest stage of each step that only an earlier version had."""
    return list({stage.name: stage for stage in read_history(run) if stage.name not in STAGE_NAMES}.values())


def _state(stage: StoredStage, stages: RunStages) -> StageState:
    if stage.name not in STAGE_NAMES:
        return StageState.like(
            stage, rests_on=_rests_on(stage), out_of_date="an earlier version made it; this one has no such step"
        )
    current = stages.current.get(stage.name)
    superseded = current is None or current.number != stage.number
    return StageState.like(
        stage,
        rests_on=_rests_on(stage),
        superseded=superseded,
        out_of_date=None if superseded else stages.out_of_date.get(stage.name),
    )


def _rests_on(stage: StoredStage) -> tuple[str, ...]:
    """Return the basis in words, with hashes cut to twelve digits."""
    basis = stage.basis
    return (
        f"profile {basis.profile[:12]}",
        *(f"{counted(arm.n, 'reading')} of {name} {arm.sha256[:12]}" for name, arm in basis.readings.items()),
        *(f"{name} {digest[:12] or 'none'}" for name, digest in basis.stages.items()),
        *(() if basis.targets is None else (f"targets {basis.targets[:12]}",)),
    )
