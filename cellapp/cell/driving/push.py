"""Push compensated targets to the arms; with verification, measure the SMRs there and correct remaining errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import require_same_arms
from cellapp.cell.driving.motion import Confirm
from cellapp.cell.driving.supervision import Opened, moving_cell
from cellapp.cell.driving.target_visit import Driver, TargetVisit
from cellapp.cell.driving.verification import Agreement, Findings, by_arm, summary_of
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.records import MeasuredPair, MeasuredTarget, VerifyResult
from cellapp.estimation.uncertainty.budget import Judge
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Listener, Progress, ignore
from cellapp.robot.model import CellModel


@dataclass
class Visited:
    """Results so far; the caller keeps them if the job is stopped."""

    targets: list[MeasuredTarget] = field(default_factory=list)
    pairs: list[MeasuredPair] = field(default_factory=list)

    def add(self, found: Findings, judge: Judge, *, verify: bool) -> None:
        """Add the findings of one target."""
        self.targets += found.targets(judge)
        pair = found.pair(judge) if verify else None
        if pair is not None:
            self.pairs.append(pair)

    def result(self, stopped: str = "") -> VerifyResult:
        """Return the result so far; ``stopped`` says why targets are missing."""
        return VerifyResult(
            arms=by_arm(self.targets),
            targets=tuple(self.targets),
            pairs=tuple(self.pairs),
            cooperative=summary_of(self.pairs),
            stopped=stopped,
        )


def push(
    profile: Profile,
    model: CellModel,
    commands: Sequence[Command],
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    verify: bool,
    rounds: int = 0,
    repeatability_m: Mapping[str, float] | None = None,
    judge: Judge | None = None,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    open_with: Opened | None = None,
    visited: Visited | None = None,
) -> VerifyResult:
    """Send every command to its arm, the other arms at home; if ``verify``, drive both commands and measure.

    The two arms of a cooperative target go there together and are measured while both rest. ``rounds`` is the maximum
    number of corrections of the remaining error. ``repeatability_m`` is the standard deviation of a coordinate of each
    arm's SMR over repeated motions [m], zero if unknown; smaller errors are not corrected.

    ``judge`` decides on tolerances; if None, by the profile alone. ``opened`` is called with the open cell before
    anything moves; an exception from it ends the job. ``confirm`` is called before the first motion. ``open_with``
    opens the cell. Each target is added to ``visited`` when it is done.

    Raises
    ------
    InputError
        If no target can be commanded, or commands, model and profile are of different arms or SMR mounts.
    HardwareError
        If an arm or the tracker fails; all arms have been stopped.
    Stopped, Aborted
        On request; the arms have been braked.
    """
    control, visited = control or JobControl(), visited or Visited()
    require_same_arms(profile, model, commands)
    if not any(command.q_compensated is not None for command in commands):
        raise InputError("push: none of the targets can be commanded: " + commands[0].refusal)
    with moving_cell(profile, model, control, confirm=confirm, opened=opened, open_with=open_with) as moving:
        visit = TargetVisit(
            model=model,
            driver=Driver(moving.mover, home_positions(profile)),
            control=control,
            hold=moving.hold,
            verify=verify,
            rounds=rounds,
            repeatability_m=repeatability_m or {},
        )
        stopped = _visit_all(visit, judge or Judge(profile), commands, visited, listener)
        moving.mover.go_home()
    total = len(dict.fromkeys(command.target.name for command in commands))
    listener(Progress("push", total, total, "done"))
    return visited.result(stopped)


def _visit_all(
    visit: TargetVisit, judge: Judge, commands: Sequence[Command], visited: Visited, listener: Listener
) -> str:
    """Visit all targets in order; return why the rest was left out if measurements contradict the model, else empty."""
    by_target = grouped((command.target.name, command) for command in commands)
    agreement, total = Agreement(), len(by_target)
    for done, (name, own) in enumerate(by_target.items()):
        visit.hold()
        visit.driver.mover.slow_start(done)
        listener(Progress("push", done, total, name))
        found = visit.to(own)
        visited.add(found, judge, verify=visit.verify)
        agreement.add(found.contradictions())
        if stopped := agreement.broken(ended=done + 1 == total):
            return stopped
    return ""
