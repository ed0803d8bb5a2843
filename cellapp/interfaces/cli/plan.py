"""What ``cellapp plan`` was asked for: a new plan, a plan from a file, a file to check, a plan to extend or to redo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.job import Job, open_run

if TYPE_CHECKING:
    from cellapp.cell.planning.records import PlanCheckResult


@dataclass(frozen=True)
class PlanChoice:
    """The arguments of ``plan`` as they were given."""

    profile: Path | None
    folder: Path | None
    source: Path | None
    keep: Path | None
    check: Path | None
    add: int | None
    replan: bool
    freeze: str | None
    view: bool

    def refusal(self) -> str:
        """Why these arguments do not belong together; empty if they do."""
        given = {
            "--from": self.source is not None,
            "--keep": self.keep is not None,
            "--check": self.check is not None,
            "--add": self.add is not None,
            "--replan": self.replan,
            "--freeze": self.freeze is not None,
            "--view": self.view,
        }
        words = [word for word, is_given in given.items() if is_given]
        if len(words) > 1:
            return f"{' and '.join(words)} do not go together; give one of them"
        changes_run = given["--add"] or given["--replan"] or given["--freeze"]
        if changes_run and (self.profile is not None or self.folder is None):
            return f"{words[0]} changes the plan of a run by the profile in it: give --run DIR and no PROFILE"
        if not changes_run and self.profile is None:
            return "PROFILE is missing; name the cell's YAML file"
        only_reads = given["--check"] or given["--view"]
        if only_reads and self.folder is not None:
            return f"{words[0]} makes no run; leave out --run"
        if not (changes_run or only_reads) and self.folder is None:
            return "--run DIR is missing; name the folder of the new run"
        return ""


def run_plan(job: Job, choice: PlanChoice) -> None:
    """Do what was asked for and print it.

    Raises
    ------
    typer.BadParameter
        If arguments do not belong together.
    InputError
        As the verbs do.
    CheckFailed
        If a hand-edited plan is refused.
    """
    from cellapp.cell.profile import load_profile
    from cellapp.commands.plan.design_view import plan_lines, plan_result_tables
    from cellapp.commands.plan.run import (
        extend_plan,
        freeze_stops,
        plan_around_file,
        plan_from_file,
        plan_new_run,
        replan,
        stop_numbers,
    )

    if refusal := choice.refusal():
        raise typer.BadParameter(refusal)
    if choice.check is not None:
        _check_file(job, choice)
        return
    if choice.view:
        _show_view(job, choice)
        return
    if choice.add is not None or choice.replan or choice.freeze is not None:
        assert choice.folder is not None
        with open_run(choice.folder, write=True) as run:
            if choice.freeze is not None:
                result = freeze_stops(run, stop_numbers(choice.freeze), job.control)
            elif choice.add is not None:
                result = extend_plan(run, choice.add, job.listen, job.control)
            else:
                result = replan(run, job.listen, job.control)
    else:
        assert choice.profile is not None
        assert choice.folder is not None
        profile = load_profile(choice.profile)
        if choice.source is not None:
            result = plan_from_file(profile, choice.source, choice.folder, job.listen, job.control)
        elif choice.keep is not None:
            result = plan_around_file(profile, choice.keep, choice.folder, job.listen, job.control)
        else:
            result = plan_new_run(profile, choice.folder, job.listen, job.control)
    job.show(plan_result_tables(result))
    job.say(*plan_lines(result))
    job.result(result)


def state_check(job: Job, result: PlanCheckResult) -> None:
    """Say what the safety gate refuses in a plan. Raises ``CheckFailed`` if it is anything."""
    from cellapp.commands.plan.view import check_sentences

    verdict, *offences = check_sentences(result)
    job.say(*offences)
    job.result(result)
    if not result.is_safe:
        raise CheckFailed(f"plan: {verdict}")
    job.say(verdict)


def _check_file(job: Job, choice: PlanChoice) -> None:
    from cellapp.cell.profile import load_profile
    from cellapp.commands.plan.run import check_plan_file

    assert choice.profile is not None
    assert choice.check is not None
    state_check(job, check_plan_file(load_profile(choice.profile), choice.check, job.listen, job.control))


def _show_view(job: Job, choice: PlanChoice) -> None:
    from cellapp.cell.planning.view import view_workspace
    from cellapp.cell.profile import load_profile
    from cellapp.commands.plan.tracker_view import view_sentences, view_tables

    assert choice.profile is not None
    result = view_workspace(load_profile(choice.profile), job.listen, job.control)
    job.show(view_tables(result))
    job.say(*view_sentences(result))
    job.result(result)
