"""The verb ``push``: refuse what does not fit the run, send commands, store what was measured even if it is stopped."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.cell_checks import check_cell
from cellapp.cell.driving.motion import Confirm
from cellapp.cell.driving.push import Visited, push
from cellapp.cell.run import RunFile
from cellapp.cell.targets.command import Command
from cellapp.cell.targets.records import VerifyResult
from cellapp.cell.targets.targets import Target
from cellapp.commands.certificate.evidence import evidence_of
from cellapp.commands.stages import StoredStage, append_stage, basis_on_model, read_results
from cellapp.commands.stored_model import model_of
from cellapp.estimation.uncertainty.conditions import measured_conditions
from cellapp.estimation.uncertainty.judging import Judge
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, Listener
from cellapp.ground.results import PUSH, VERIFY

MOST_ROUNDS = 20
"""Corrections of one target: each more than halves what remains, so that more only follow the noise."""


@dataclass(frozen=True)
class PushJob:
    """What is pushed: the commands that ``model`` gave for ``targets``, and how.

    ``profile`` is that of the run, with the tracker of a simulated cell where it stands now.
    ``notes`` are those of the commands. ``rounds`` and ``verify`` are as in ``push``; ``out_of_date`` accepts a
    controller whose own D-H has changed.
    """

    run: RunFile
    profile: Profile
    model: StoredStage
    commands: tuple[Command, ...]
    targets: tuple[Target, ...]
    notes: tuple[str, ...]
    verify: bool
    rounds: int
    out_of_date: bool


def check_rounds(iterate: int | None, *, verify: bool) -> None:
    """Raise ``InputError`` unless a number of corrections makes sense; None asks for none."""
    if iterate is None:
        return
    if not 1 <= iterate <= MOST_ROUNDS:
        raise InputError(f"push: --iterate: expected 1 to {MOST_ROUNDS} rounds, got {iterate}; nothing was moved")
    if not verify:
        raise InputError("push: --iterate corrects what was measured; add --verify. Nothing was moved")


def push_commands(job: PushJob, listener: Listener, control: JobControl, confirm: Confirm | None) -> VerifyResult:
    """Push, and store the result; where the job is stopped, what was measured until then.

    Raises as ``push`` and ``check_cell`` do.
    """
    run, notes, visited = job.run, list(job.notes), Visited()
    judge = judge_of(run, job.profile)

    def opened(cell: Cell) -> None:
        notes.extend(check_cell(run, cell, job.commands, changed_controller=job.out_of_date))

    try:
        pushed = push(
            job.profile,
            model_of(run, job.model),
            job.commands,
            listener,
            control,
            verify=job.verify,
            rounds=job.rounds,
            repeatability_m=_repeatability_m(run),
            judge=judge,
            confirm=confirm,
            opened=opened,
            visited=visited,
        )
    except (CellappError, Cancelled) as error:
        if visited.targets:
            asked = len(dict.fromkeys(command.target.name for command in job.commands))
            done = len(dict.fromkeys(target.name for target in visited.targets))
            with suppress(InputError):  # the reason of the stop is the one to report
                _store(job, judge, visited.result(f"stopped after {done} of {asked} targets: {error}"), notes)
        raise
    return _store(job, judge, pushed, notes)


def judge_of(run: RunFile, profile: Profile) -> Judge:
    """Who decides on tolerances in a run: with the uncertainty that its results and readings give."""
    results = read_results(run)
    measured = measured_conditions({name: run.readings(name) for name in run.arms()})
    return Judge(profile, {name: evidence_of(results, name, measured.get(name)) for name in profile.arms})


def _store(job: PushJob, judge: Judge, pushed: VerifyResult, notes: list[str]) -> VerifyResult:
    said = [f"target {target.name}: {target.note}" for target in pushed.targets if target.note]
    judged = list(dict.fromkeys(one.arm for one in pushed.targets if one.tolerance_mm is not None))
    stated = {"rule": judge.rule, "not_given": judge.not_given(judged) if job.verify else ()}
    result = pushed.model_copy(update={"notes": tuple([*notes, *said]), **stated})
    basis = basis_on_model(job.run, job.model, job.targets)
    append_stage(job.run, VERIFY if job.verify else PUSH, result, basis)
    return result


def _repeatability_m(run: RunFile) -> dict[str, float]:
    """Standard deviation of a coordinate over repeated stops of each arm [m], tracker included; only where known."""
    calibrated = read_results(run).calibrate
    if calibrated is None:
        return {}
    return {
        name: arm.repeatability_mm.coordinate * 1e-3
        for name, arm in calibrated.arms.items()
        if arm.repeatability_mm is not None
    }
