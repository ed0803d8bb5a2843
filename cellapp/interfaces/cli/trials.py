"""``cellapp trials``: effects hidden in the user's own simulated cell, by its own plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellapp.ground.counting import counted
from cellapp.ground.errors import CheckFailed
from cellapp.ground.executors import TimeLimit
from cellapp.ground.outputs import Writes
from cellapp.interfaces.cli.command_outputs import Commands, Jobs, JsonOption, ProfilePath, Scheduler
from cellapp.interfaces.cli.job import CommandJob
from cellapp.interfaces.cli.top import TRIALS, InOrder

if TYPE_CHECKING:
    from cellapp.ground.executors import PoolWork

trials_app = Commands(cls=InOrder, help=TRIALS, no_args_is_help=True)
_NAMED = 10
"""Most failures that are named one by one."""


@trials_app.command("seal")
def seal(
    profile: ProfilePath,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder of the trials."), Writes.OWN_FOLDER],
    n: Annotated[int, typer.Option("--n", min=1, help="Runs.")] = 200,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Fixes all that is random; left out, a secret one is taken.")
    ] = None,
    kind: Annotated[
        str,
        typer.Option("--kind", metavar="KIND", help="What is hidden: one, none, outside, pair, triple, hard, mixed."),
    ] = "one",
    laws: Annotated[
        str, typer.Option("--laws", metavar="LAWS", help="same: shaped as the library's; other: by other shapes.")
    ] = "same",
    stops: Annotated[int | None, typer.Option("--stops", help="Stops of each run, instead of the profile's.")] = None,
    ranges: Annotated[
        str, typer.Option("--ranges", metavar="RANGES", help="full, or narrow: every joint moves over 10 to 50 deg.")
    ] = "full",
    unstated: Annotated[bool, typer.Option("--unstated", help="Readings do not state their uncertainty.")] = False,
    plan: Annotated[
        str, typer.Option("--plan", metavar="PLAN", help="How stops are chosen: random or designed.")
    ] = "random",
    json_file: JsonOption = None,
) -> None:
    """Write runs of simulated cells whose hidden effects are stated in a sealed file only."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.sealed import SEAL_FILE, TRUTH_FILE, seal_trials
    from cellapp.commands.trials.sealed_setup import Setup

    setup = Setup(
        kind=kind, laws=laws, stops=stops, ranges=ranges,
        stated=not unstated, plan_method=plan,
    )  # fmt: skip
    with CommandJob(json_file) as job:
        result = seal_trials(load_profile(profile), out, n, setup, seed=seed, job=job.control)
        job.say(
            f"{counted(result.runs, 'run')} in {out}; their truth is in {out / TRUTH_FILE}: open it with 'trials judge'"
            " only",
            f"SHA-256 of the truth, also in {out / SEAL_FILE}: {result.sha256}",
        )
        job.result(result)


@trials_app.command("judge")
def judge(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the trials.")],
    again: Annotated[bool, typer.Option("--again", help="Judge again also what was judged before.")] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    json_file: JsonOption = None,
) -> None:
    """Calibrate and discover on every sealed run, then open the truth and compare; continues where it was stopped."""
    from cellapp.commands.trials.judge import judge_trials
    from cellapp.commands.trials.scoring import judge_sentences, judge_tables

    with CommandJob(json_file) as job:
        result = judge_trials(folder, _work(job, jobs, scheduler), again=again)
        job.show_view((*judge_tables(result), *judge_sentences(result)))
        job.result(result)
        _refuse_failed(result.failed)
        if result.missed:
            raise CheckFailed(f"limits missed: {'; '.join(f'{one.kind}: {one.target}' for one in result.missed)}")


@trials_app.command("power")
def power(
    where: Annotated[
        Path, typer.Argument(metavar="PROFILE|DIR", help="The cell, as YAML, or a run, which keeps the result.")
    ],
    trials: Annotated[int, typer.Option("--trials", min=8, max=400, help="Trials of each effect and arm.")] = 16,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.1, help="Time; what fits is shared among the effects.")
    ] = 10.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Fixes laws, true geometry and noise.")] = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    results: Annotated[
        Path | None,
        typer.Option("--results", metavar="FILE", help="Keep trials in FILE; what it holds is not repeated."),
        Writes.STORE,
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Before measuring: which effects of which size a cell, its plan and its tracker would have named."""
    from cellapp.commands.trials.detectability import detectability_at, detectability_sentence, detectability_table

    with CommandJob(json_file) as job:
        work = _work(job, jobs, scheduler, results)
        result = detectability_at(where, trials, seed, work, TimeLimit.from_now(minutes))
        tables = (detectability_table(name, arm) for name, arm in result.arms.items())
        job.show_view((*tables, detectability_sentence(result)))
        job.result(result)
        _refuse_failed(result.failed)


def _work(job: CommandJob, jobs: int | None, scheduler: str | None, results: Path | None = None) -> PoolWork:
    from cellapp.ground.executors import PoolWork, kept_results

    kept_results(results)  # one that is none is refused before hours of work
    return PoolWork(jobs, scheduler, results, job.control)


def _refuse_failed(failed: Sequence[str]) -> None:
    """Name the first tasks that failed. Raises ``CheckFailed`` if any did."""
    if failed:
        more = f"; and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
        raise CheckFailed(f"{len(failed)} could not be computed: {'; '.join(failed[:_NAMED])}{more}")
