"""The state of a run as results of ``show``; everything here only reads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.in_order import read_in_order
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.cell.run.unseen_arms import unseen_arms
from cellapp.commands.next_command import next_command
from cellapp.commands.out_of_date import complaints_of
from cellapp.commands.run_results import (
    ArmState,
    HistoryResult,
    LogLine,
    LogResult,
    NextVerb,
    OverviewResult,
    PlannedStop,
    StageState,
    StopsResult,
    UnseenArmState,
)
from cellapp.commands.stages import RunStages, StoredStage, read_history, read_stages
from cellapp.ground.results import COMPENSATE


def run_overview(run: RunFile) -> OverviewResult:
    """Profile, arms, current stages, and the command that comes next."""
    stages, arms = read_stages(run), arm_states(run)
    verb, command = next_step(run, stages, arms)
    return OverviewResult(
        run=str(run.folder),
        profile=run.profile.name,
        arms=arms,
        in_order=read_in_order(run),
        stages=tuple(_state(stage, stages) for stage in stages.current.values()),
        in_force=None if stages.in_force is None else stages.in_force.name,
        stale="" if stages.in_force is None else stages.stale_model(),
        next_verb=verb,
        next_step=command,
        complaints=tuple(complaints_of(run, stages)),
        not_seen_at_rest={
            name: UnseenArmState(since=arm.since, reason=arm.reason) for name, arm in unseen_arms(run).items()
        },
    )


def arm_states(run: RunFile) -> dict[str, ArmState]:
    """How much of each arm's plan is measured; readings are counted, not read."""
    planned, measured = run.planned_counts(), run.split_counts()
    states = {}
    for name, arm in run.profile.arms.items():
        splits, total = measured.get(name, {}), planned.get(name, 0)
        states[name] = ArmState(
            type=arm.type.model,
            planned=total - len(run.profile.plan.reserves(total)),
            measured=sum(splits.values()),
            splits={split or "none": n for split, n in splits.items()},
        )
    return states


def next_step(run: RunFile, stages: RunStages, arms: Mapping[str, ArmState]) -> tuple[NextVerb, str]:
    """The verb that comes next and its command; both empty if nothing is left to do."""
    verb = _next_verb(run, stages, arms)
    begun = verb == "collect" and any(arm.measured for arm in arms.values())
    return verb, next_command(verb, run.folder) + (" --resume" if begun else "")


def run_history(run: RunFile) -> HistoryResult:
    """Every stage that was ever stored, oldest first."""
    stages = read_stages(run)
    return HistoryResult(run=str(run.folder), stages=tuple(_state(stage, stages) for stage in read_history(run)))


def planned_stops(run: RunFile) -> StopsResult:
    """Every planned stop, and whether it was measured."""
    plan, done = run.read_plan(), run.stops_done()
    count = max((len(q) for q in plan.values()), default=0)
    return StopsResult(
        run=str(run.folder),
        stops=tuple(
            PlannedStop(
                configuration=stop,
                measured=stop in done,
                q={name: tuple(np.asarray(q[stop]).tolist()) for name, q in plan.items()},
            )
            for stop in range(count)
        ),
    )


def run_log(run: RunFile, level: str | None = None, last: int | None = None) -> LogResult:
    """Lines of the log, oldest first; only those of one ``level``, only the ``last`` ones."""
    lines = [
        LogLine(number=event.number, written=event.written, time_s=event.time_s, level=event.level, text=event.text)
        for event in run.events()
        if level is None or event.level == level
    ]
    return LogResult(run=str(run.folder), lines=tuple(lines if last is None else lines[-last:]))


def _state(stage: StoredStage, stages: RunStages) -> StageState:
    current = stages.current.get(stage.name)
    superseded = current is None or current.number != stage.number
    return StageState(
        number=stage.number,
        name=stage.name,
        written=stage.written,
        program=stage.program,
        digest=stage.digest,
        rests_on=_rests_on(stage),
        superseded=superseded,
        out_of_date=None if superseded else stages.out_of_date.get(stage.name),
    )


def _rests_on(stage: StoredStage) -> tuple[str, ...]:
    """The basis in words; hashes are cut to twelve digits."""
    if stage.basis is None:
        return ("not recorded",)
    basis = stage.basis
    return (
        f"profile {basis.profile[:12]}",
        *(f"{arm.n} readings of {name} {arm.sha256[:12]}" for name, arm in basis.readings.items()),
        *(f"{name} {digest[:12] or 'none'}" for name, digest in basis.stages.items()),
        *(() if basis.targets is None else (f"targets {basis.targets[:12]}",)),
    )


def _next_verb(run: RunFile, stages: RunStages, arms: Mapping[str, ArmState]) -> NextVerb:
    if not any(arm.measured for arm in arms.values()):
        return "collect" if any(arm.planned for arm in arms.values()) else ""  # a run of tests alone has no plan
    sessions = run.sessions()
    ended = sessions[-1].outcome if sessions else None
    if ended == "complete" and _has_new_stops(run):
        return "collect"
    done = ended in ("complete", "accurate enough")
    if not done and not stages.current and any(arm.measured < arm.planned for arm in arms.values()):
        return "collect"
    verb = stages.next_verb()
    if verb == "push" and not any(arm.driver.has_device for arm in run.profile.arms.values()):
        verb = "" if COMPENSATE in stages.current and COMPENSATE not in stages.out_of_date else "compensate"
    return verb or ("" if (run.folder / REPORT_FILE).exists() else "report")


def _has_new_stops(run: RunFile) -> bool:
    """Whether stops are planned that no session has tried, reserves aside: they were added since."""
    total = max(run.planned_counts().values(), default=0)
    tried = run.stops_done() | {one.stop for one in run.outcomes()}
    return any(stop not in tried for stop in range(total) if stop not in run.profile.plan.reserves(total))
