"""``cellapp trials``: trials on simulated cells and measured series."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.interfaces.cli.check_trial import check
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.cost import cost
from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.options import Jobs, JsonOption, MarkdownFile, ProfilePath, Scheduler, Store, resources_of
from cellapp.interfaces.cli.series_trials import league, signature
from cellapp.interfaces.cli.trial_files import check_bars, check_failed, state_result

trials_app = Commands(help="Trials on simulated cells and measured series.", no_args_is_help=True)


@trials_app.command("coverage")
def coverage(
    profile: ProfilePath,
    n: Annotated[int, typer.Option("--n", min=2, help="Simulated runs.")] = 200,
    stops: Annotated[int, typer.Option("--stops", min=20, help="Stops each is identified from.")] = 100,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    json_file: JsonOption = None,
) -> None:
    """How often the stated 95 % intervals contain the truth, over many simulated arms."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.coverage import coverage_trials

    with Job(json_file) as job:
        result = coverage_trials(
            load_profile(profile), n, stops, resources_of(jobs, scheduler, store), job.listen, job.control
        )
        for name, arm in result.arms.items():
            shares = arm.by_parameter.values()
            job.say(
                f"arm {name}: {100 * arm.share:.2f} % of {arm.intervals} stated 95 % intervals contain the truth"
                f" ({arm.runs} runs; by parameter {100 * min(shares):.1f} to {100 * max(shares):.1f} %)"
            )
        job.result(result)
        check_failed(result.failed)


@trials_app.command("parameter-sets")
def parameter_sets(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated arms.")] = 5,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    json_file: JsonOption = None,
) -> None:
    """The paper's comparison: redundant, paper's and identifiable set; iterations, mean and maximum error."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.parameter_sets import parameter_set_trials
    from cellapp.commands.trials.tables import parameter_set_tables

    with Job(json_file) as job:
        result = parameter_set_trials(
            load_profile(profile), range(seeds), resources_of(jobs, scheduler, store), job.listen, job.control
        )
        job.show(parameter_set_tables(result))
        job.result(result)
        check_failed(result.failed)


@trials_app.command("paper")
def paper(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells.")] = 10,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    json_file: JsonOption = None,
) -> None:
    """The paper's three methods on many simulated cells, and the two networks at another tracker station."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.paper import paper_trials
    from cellapp.commands.trials.tables import paper_tables

    with Job(json_file) as job:
        result = paper_trials(
            load_profile(profile), range(seeds), resources_of(jobs, scheduler, store), job.listen, job.control
        )
        job.show(paper_tables(result))
        job.result(result)
        check_failed(result.failed)


@trials_app.command("seal")
def seal(
    profile: ProfilePath,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder of the trials."), Writes.OWN_FOLDER],
    n: Annotated[int, typer.Option("--n", min=1, help="Runs.")] = 200,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Draws everything; left out, a secret one is drawn.")
    ] = None,
    kind: Annotated[
        str, typer.Option("--kind", metavar="KIND", help="What is hidden: one, none, outside, pair, triple or mixed.")
    ] = "one",
    noise: Annotated[
        str, typer.Option("--noise", metavar="NOISE", help="gaussian, heavy (tails) or repeatability (8 urad a joint).")
    ] = "gaussian",
    laws: Annotated[
        str, typer.Option("--laws", metavar="LAWS", help="same: shaped as the library's; other: by other shapes.")
    ] = "same",
    stops: Annotated[int | None, typer.Option("--stops", help="Stops of each run, instead of the profile's.")] = None,
    ranges: Annotated[
        str, typer.Option("--ranges", metavar="RANGES", help="full, or narrow: every joint moves over 10 to 50 deg.")
    ] = "full",
    mass_error: Annotated[
        float, typer.Option("--mass-error", help="Standard deviation of true link masses, relative.")
    ] = 0.05,
    unstated: Annotated[bool, typer.Option("--unstated", help="Readings do not state their uncertainty.")] = False,
    flip_approach: Annotated[
        bool, typer.Option("--flip-approach", help="Backlash or friction, approach signs by the opposite convention.")
    ] = False,
    plan: Annotated[
        str, typer.Option("--plan", metavar="PLAN", help="How stops are chosen: random or designed.")
    ] = "random",
    json_file: JsonOption = None,
) -> None:
    """Write runs of simulated cells whose hidden effects are stated in a sealed file only."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.sealed import SEAL_FILE, TRUTH_FILE, seal_trials
    from cellapp.commands.trials.sealed_setup import Setup

    with Job(json_file) as job:
        setup = Setup(
            kind=kind, noise=noise, laws=laws, stops=stops, ranges=ranges, mass_error=mass_error,
            stated=not unstated, flip_approach=flip_approach, plan_method=plan,
        )  # fmt: skip
        result = seal_trials(load_profile(profile), out, n, setup, seed=seed, listener=job.listen, cancel=job.control)
        job.say(f"{result.runs} runs in {out}; their truth is in {out / TRUTH_FILE}: open it with 'trials judge' only")
        job.say(f"SHA-256 of the truth, also in {out / SEAL_FILE}: {result.sha256}")
        job.result(result)


@trials_app.command("judge")
def judge(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the trials.")],
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    again: Annotated[bool, typer.Option("--again", help="Judge again also what was judged before.")] = False,
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """Calibrate and discover on every sealed run, then open the truth and compare; continues where it was stopped."""
    from cellapp.commands.trials.judge import judge_trials
    from cellapp.commands.trials.tables import judge_sentences, judge_tables

    with Job(json_file) as job:
        result = judge_trials(
            folder, resources=resources_of(jobs, scheduler), again=again, listener=job.listen, cancel=job.control
        )
        state_result(job, result, judge_tables(result), judge_sentences(result), markdown)
        check_bars(result.failed, result.missed)


@trials_app.command("blind-matrix")
def blind_matrix(
    profile: ProfilePath,
    out: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Folder with a folder of trials for each cell."),
        Writes.OWN_FOLDER,
    ],
    n: Annotated[int, typer.Option("--n", min=1, help="Runs of each cell.")] = 40,
    only: Annotated[
        str, typer.Option("--only", metavar="PATTERN", help="Only cells of such names, as 'other.*' or '*.one'.")
    ] = "*",
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Draws everything; left out, secret ones are drawn.")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """Sealed trials of every kind under many conditions; continues where it was stopped."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.blind_matrix import blind_matrix as run_matrix
    from cellapp.commands.trials.blind_matrix import matrix_cells
    from cellapp.commands.trials.tables import matrix_sentences, matrix_tables

    with Job(json_file) as job:
        cells = matrix_cells(only)
        result = run_matrix(
            load_profile(profile),
            out,
            n,
            cells,
            seed=seed,
            resources=resources_of(jobs, scheduler),
            listener=job.listen,
            cancel=job.control,
        )
        state_result(job, result, matrix_tables(result), matrix_sentences(result), markdown)
        check_bars(result.failed, result.missed)


@trials_app.command("plans")
def plans(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Seeds, from 0 on.")] = 10,
    stops: Annotated[int, typer.Option("--stops", min=10, help="Designed stops that are compared with random.")] = 100,
    whole: Annotated[int, typer.Option("--whole", min=0, help="Stops of whole plans; 0: none.")] = 400,
    bounded: Annotated[int, typer.Option("--bounded", min=0, help="Seeds with the best possible values; slow.")] = 1,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """Designed plans against random ones: what they tell, travel, correlations, and collisions by another library."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.plan_tables import plan_trial_sentences, plan_trial_tables
    from cellapp.commands.trials.plan_trial import plan_trials

    with Job(json_file) as job:
        resources = resources_of(jobs, scheduler, store)
        result = plan_trials(
            load_profile(profile), range(seeds), stops, bounded, whole, resources, job.listen, job.control
        )
        state_result(job, result, plan_trial_tables(result), plan_trial_sentences(result), markdown)
        require_none(result.complaints(), "trials plans")


@trials_app.command("targets")
def targets(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells.")] = 10,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first; the next has the next one.")] = 0,
    count: Annotated[int, typer.Option("--targets", min=1, help="New targets of each arm.")] = 200,
    pairs: Annotated[int, typer.Option("--pairs", min=0, help="Cooperative targets; 0: none.")] = 200,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    markdown: MarkdownFile = None,
    json_file: JsonOption = None,
) -> None:
    """Whole simulated cells with mixed hidden effects: errors at new targets that are measured, against bars."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.target_tables import target_trial_sentences, target_trial_tables
    from cellapp.commands.trials.target_trial import target_trials

    with Job(json_file) as job:
        chosen = range(seed, seed + seeds)
        result = target_trials(
            load_profile(profile), chosen, count, pairs, resources_of(jobs, scheduler, store), job.listen, job.control
        )
        state_result(job, result, target_trial_tables(result), target_trial_sentences(result), markdown)
        require_none(result.complaints(), "trials targets")


for command in (check, league, signature, cost):
    trials_app.command()(command)
