"""``cellapp trials``: trials on simulated cells, emulated devices and measured series."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.cli.check_trial import check
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.cost import cost
from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.options import Jobs, JsonOption, MarkdownFile, ProfilePath, Scheduler, Store, resources_of
from cellapp.interfaces.cli.series_trials import league, signature
from cellapp.interfaces.cli.trial_files import check_bars, check_failed, state_result

trials_app = Commands(help="Trials on simulated cells, emulated devices and measured series.", no_args_is_help=True)


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


@trials_app.command("links")
def links(
    moves: Annotated[int, typer.Option("--moves", min=2, help="Motions in all, of two arms at once.")] = 1000,
    every: Annotated[int, typer.Option("--every", min=2, help="Motions to each fault.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws targets and faults.")] = 0,
    person: Annotated[
        Path | None, typer.Option("--person", metavar="PROFILE", help="Press STOP in a terminal on this emulated cell.")
    ] = None,
    presses: Annotated[int, typer.Option("--presses", min=1, help="With --person: presses of each key.")] = 50,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="With --person: of each way to leave.")] = 10,
    busy: Annotated[int, typer.Option("--busy", min=0, help="With --person: processes that compute beside it.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Two emulated UR arms under the real client, random faults: how soon every arm of the cell stops."""
    from cellapp.commands.trials.links import link_trials
    from cellapp.commands.trials.tables import link_tables

    with Job(json_file) as job:
        if person is not None:
            _person(job, person, presses, repeats, busy)
            return
        result = link_trials(moves, every, seed, job.listen, job.control)
        job.show(link_tables(result))
        job.say(f"{result.moves} moves, {result.faults} faults, {len(result.complaints)} complaints")
        if result.host_stalls:
            job.say(
                f"this computer stalled in {result.host_stalls} motions; the controllers' watchdogs stopped the arms"
            )
        job.say(*result.complaints)
        job.result(result)
        if result.complaints:
            raise CheckFailed(f"trials links: {len(result.complaints)} things were not as specified; see above")


def _person(job: Job, profile: Path, presses: int, repeats: int, busy: int) -> None:
    from cellapp.commands.trials.person import person_trial
    from cellapp.commands.trials.person_results import person_table

    result = person_trial(profile, presses, repeats, busy, job.listen, job.control)
    job.show([person_table(result)])
    job.result(result)
    if result.missed():
        raise CheckFailed(f"trials links: bars were missed, or not measured: {'; '.join(result.missed())}")


@trials_app.command("bridge")
def bridge(
    profile: ProfilePath,
    measurements: Annotated[int, typer.Option("--measurements", min=1, help="Measurements in all.")] = 1000,
    every: Annotated[int, typer.Option("--every", min=1, help="Measurements to each fault.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the faults.")] = 0,
    serial: Annotated[
        tuple[str, str] | None,
        typer.Option("--serial", metavar="BRIDGE CLIENT", help="Both ends of a serial cable, to use that instead."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Many measurements over the tracker bridge with random faults: none may be lost, doubled or mixed up."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.bridge import bridge_trial
    from cellapp.commands.trials.tables import bridge_table

    with Job(json_file) as job:
        result = bridge_trial(load_profile(profile), measurements, every, seed, serial, job.listen, job.control)
        job.show([bridge_table(result)])
        job.say(
            f"{result.asked} measurements asked for, {result.delivered} delivered; {result.lost} lost,"
            f" {result.doubled} doubled, {result.strange} mixed up"
        )
        job.result(result)
        if result.lost or result.doubled or result.strange:
            raise CheckFailed("trials bridge: measurements were lost, doubled or mixed up")


@trials_app.command("storm")
def storm(
    profile: Annotated[Path, typer.Argument(metavar="PROFILE", help="Profile with loopback devices.")] = Path(
        "profiles/twin-rtde.yaml"
    ),
    stops: Annotated[int, typer.Option("--stops", min=2, help="Planned stops.")] = 400,
    faults: Annotated[int, typer.Option("--faults", min=0, help="Faults of all kinds.")] = 200,
    kills: Annotated[int, typer.Option("--kills", min=0, help="SIGKILLs of the collecting program.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the faults and their moments.")] = 0,
    pace: Annotated[
        float, typer.Option("--pace", metavar="X", min=1.0, max=100.0, help="Simulated seconds for each real one.")
    ] = 50.0,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", metavar="DIR", help="New folder that keeps the runs and what was printed."),
        Writes.OWN_FOLDER,
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """A whole collection over the wire in a storm of faults: nothing lost, nothing doubled, no motion after a stop."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.storm import storm_trial
    from cellapp.commands.trials.tables import storm_tables

    with Job(json_file) as job:
        result = storm_trial(load_profile(profile), stops, faults, kills, seed, pace, keep, job.listen, job.control)
        job.show(storm_tables(result))
        job.say(
            f"{result.readings} readings at {result.stops} stops, {len(result.missing)} missing with their reason;"
            f" {result.lost} lost, {result.doubled} doubled; {result.motions_after_a_stop} motions after a stop"
        )
        job.say(*result.complaints)
        job.result(result)
        if result.complaints:
            raise CheckFailed(f"trials storm: {len(result.complaints)} things were not as specified; see above")


@trials_app.command("campaigns")
def campaigns(
    profile: Annotated[Path, typer.Argument(metavar="[PROFILE]", help="A simulated cell, as YAML.")] = Path(
        "profiles/twin.yaml"
    ),
    n: Annotated[int, typer.Option("--n", min=1, help="Campaigns.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first; the next has the next one.")] = 0,
    stops: Annotated[int, typer.Option("--stops", min=30, help="Stops of each campaign.")] = 400,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    store: Store = None,
    json_file: JsonOption = None,
) -> None:
    """The whole engine on simulated devices, disk and person, with seeded faults of all kinds on simulated time."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.campaigns.trial import campaign_trials
    from cellapp.commands.trials.tables import campaign_tables

    with Job(json_file) as job:
        result = campaign_trials(
            load_profile(profile), n, seed, stops, resources_of(jobs, scheduler, store), job.listen, job.control
        )
        job.show(campaign_tables(result))
        job.say(
            f"{result.n - len(result.failed)} of {result.n} campaigns as they should be; {result.missing} planned"
            f" readings are missing with a reason; a campaign took {result.seconds_mean:.2f} s, at most"
            f" {result.seconds_worst:.2f} s, for {3600 * result.simulated_h / result.n:.0f} s of simulated time"
        )
        for failed in result.failed:
            job.say(f"seed {failed.seed}: {'; '.join(failed.failures[:3])}")
            job.say(f"  again: cellapp trials campaigns {profile} --n 1 --seed {failed.seed} --stops {stops}")
        job.result(result)
        check_failed(result.not_run)
        if result.failed:
            raise CheckFailed(f"trials campaigns: {len(result.failed)} of {result.n} campaigns failed; see above")


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
