"""``cellapp trials``: trials on simulated cells and measured series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellapp.commands.power.request import FEWEST_TRIALS, MINUTES
from cellapp.commands.power.request import TRIALS as TRIALS_OF_EACH
from cellapp.ground.counting import counted
from cellapp.ground.outputs import Writes
from cellapp.ground.time_limit import TimeLimit
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.options import ProfilePath
from cellapp.interfaces.cli.top import TRIALS, InOrder
from cellapp.interfaces.cli.trial_command import trial

if TYPE_CHECKING:
    from cellapp.commands.trials.skeleton import Stated, Work

trials_app = Commands(cls=InOrder, help=TRIALS, no_args_is_help=True)
SimulatedCell = Annotated[Path, typer.Argument(metavar="[PROFILE]", help="A simulated cell, as YAML.")]
DEFAULT_CELL = Path("profiles/twin.yaml")
DrawnCells = Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells, or draws of rows.")]
FirstSeed = Annotated[int, typer.Option("--first", min=0, help="The first seed.")]
Mix = Annotated[bool, typer.Option("--mix", help="Hide compliance, curves and backlash on the arms.")]
SeriesFolder = Annotated[Path, typer.Option("--data", metavar="DIR", help="Folder of the series.")]
SeriesProfiles = Annotated[Path, typer.Option("--profiles", metavar="DIR", help="Folder of their profiles.")]
DATA, PROFILES = Path("tests/fixtures"), Path("profiles")
ALONE = ("jobs", "scheduler", "store", "markdown")
"""Options that a single job does not have."""


@trial(trials_app, "coverage", "markdown")
def coverage(
    work: Work,
    profile: ProfilePath,
    n: Annotated[int, typer.Option("--n", min=2, help="Simulated runs.")] = 200,
    stops: Annotated[int, typer.Option("--stops", min=20, help="Stops each is identified from.")] = 100,
) -> Stated:
    """How often the stated 95 % intervals contain the truth, over many simulated arms."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.coverage import coverage_sentences, coverage_trials
    from cellapp.commands.trials.skeleton import Stated, not_computed

    result = coverage_trials(load_profile(profile), n, stops, work)
    return Stated(result, sentences=coverage_sentences(result), refused=not_computed(result.failed))


@trial(trials_app, "parameter-sets", "markdown")
def parameter_sets(
    work: Work,
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated arms.")] = 5,
) -> Stated:
    """The paper's comparison: redundant, paper's and identifiable set; iterations, mean and maximum error."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.parameter_sets import parameter_set_tables, parameter_set_trials
    from cellapp.commands.trials.skeleton import Stated, not_computed

    result = parameter_set_trials(load_profile(profile), range(seeds), work)
    return Stated(result, parameter_set_tables(result), refused=not_computed(result.failed))


@trial(trials_app, "paper", "markdown")
def paper(
    work: Work,
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells.")] = 10,
) -> Stated:
    """The paper's three methods on many simulated cells, and the two networks at another tracker station."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.paper import paper_tables, paper_trials
    from cellapp.commands.trials.skeleton import Stated, not_computed

    result = paper_trials(load_profile(profile), range(seeds), work)
    return Stated(result, paper_tables(result), refused=not_computed(result.failed))


@trial(trials_app, "seal", *ALONE)
def seal(
    work: Work,
    profile: ProfilePath,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder of the trials."), Writes.OWN_FOLDER],
    n: Annotated[int, typer.Option("--n", min=1, help="Runs.")] = 200,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Draws everything; left out, a secret one is drawn.")
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            "--kind", metavar="KIND", help="What is hidden: one, none, outside, pair, triple, hard, motion, mixed."
        ),
    ] = "one",
    noise: Annotated[
        str, typer.Option("--noise", metavar="NOISE", help="gaussian, heavy (tails) or repeatability (8 µrad a joint).")
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
    sweeps: Annotated[
        int | None,
        typer.Option("--sweeps", min=1, help="Stops with a sweep of each arm on record; others at rest judge them."),
    ] = None,
) -> Stated:
    """Write runs of simulated cells whose hidden effects are stated in a sealed file only."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.sealed import SEAL_FILE, TRUTH_FILE, seal_trials
    from cellapp.commands.trials.sealed_setup import Setup
    from cellapp.commands.trials.skeleton import Stated

    setup = Setup(
        kind=kind, noise=noise, laws=laws, stops=stops, ranges=ranges, mass_error=mass_error,
        stated=not unstated, flip_approach=flip_approach, plan_method=plan, sweeps=sweeps,
    )  # fmt: skip
    result = seal_trials(load_profile(profile), out, n, setup, seed=seed, listener=work.listener, cancel=work.cancel)
    said = (
        f"{counted(result.runs, 'run')} in {out}; their truth is in {out / TRUTH_FILE}: open it with 'trials judge'"
        " only",
        f"SHA-256 of the truth, also in {out / SEAL_FILE}: {result.sha256}",
    )
    return Stated(result, sentences=said)


@trial(trials_app, "judge", "store")
def judge(
    work: Work,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the trials.")],
    again: Annotated[bool, typer.Option("--again", help="Judge again also what was judged before.")] = False,
) -> Stated:
    """Calibrate and discover on every sealed run, then open the truth and compare; continues where it was stopped."""
    from cellapp.commands.trials.judge import judge_trials
    from cellapp.commands.trials.skeleton import Stated
    from cellapp.commands.trials.tables import judge_sentences, judge_tables, refused

    result = judge_trials(folder, work, again=again)
    return Stated(result, judge_tables(result), judge_sentences(result), refused(result))


@trial(trials_app, "benchmark")
def benchmark(
    work: Work,
    profile: SimulatedCell = DEFAULT_CELL,
    method: Annotated[
        str, typer.Option("--method", metavar="LIST", help="Names of methods, as cellapp,ard; all: every one.")
    ] = "cellapp",
    problems: Annotated[
        Path,
        typer.Option("--problems", metavar="DIR", help="Folder of the problems; those that lack are made."),
        Writes.OWN_FOLDER,
    ] = Path("trials/benchmark"),
    n: Annotated[int, typer.Option("--n", min=1, help="Runs of each kind to make, two arms each.")] = 10,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Draws the problems; left out, a secret one is drawn.")
    ] = None,
    cells: Annotated[
        str,
        typer.Option("--cells", metavar="LIST", help="Further simulated cells, as profiles/twin-6d.yaml: a set each."),
    ] = "",
    sweeps: Annotated[
        int | None,
        typer.Option("--sweeps", min=1, help="A set in motion too: stops with a sweep of each arm on record."),
    ] = None,
    real: Annotated[
        str, typer.Option("--real", metavar="LIST", help="Real series of the league too, as C,UR5: held-out errors.")
    ] = "",
    rows: Annotated[str, typer.Option("--rows", metavar="N", help="With --real: rows to learn from, or all.")] = "300",
    draws: Annotated[int, typer.Option("--draws", min=1, help="With --real: draws of rows.")] = 2,
    data: SeriesFolder = DATA,
    profiles: SeriesProfiles = PROFILES,
) -> Stated:
    """Name the missing effect: methods on sealed problems; exact and false names, odds, held-out error, time."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.benchmark.real import records_words
    from cellapp.commands.trials.benchmark.trial import RealProblems, benchmark_table, benchmark_trials, refused
    from cellapp.commands.trials.league.series import parse_rows, series_texts
    from cellapp.commands.trials.skeleton import Stated

    names, further, series = (
        [word.strip() for word in text.split(",") if word.strip()] for text in (method, cells, real)
    )
    texts = RealProblems(series_texts(series, data, profiles), parse_rows(rows)[0], draws) if series else None
    result = benchmark_trials(
        load_profile(profile), problems, names, n, seed, work,
        cells=[load_profile(Path(path)) for path in further], real=texts, sweeps=sweeps,
    )  # fmt: skip
    return Stated(result, (benchmark_table(result),), records_words(series), refused(result))


@trial(trials_app, "blind-matrix", "store")
def blind_matrix(
    work: Work,
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
) -> Stated:
    """Sealed trials of every kind under many conditions; continues where it was stopped."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials import blind_matrix as matrix
    from cellapp.commands.trials.skeleton import Stated
    from cellapp.commands.trials.tables import matrix_sentences, matrix_tables, refused

    cells = matrix.matrix_cells(only)
    result = matrix.blind_matrix(load_profile(profile), out, n, cells, work, seed=seed)
    return Stated(result, matrix_tables(result), matrix_sentences(result), refused(result))


@trial(trials_app, "truth", "store")
def truth(
    work: Work,
    profile: SimulatedCell = DEFAULT_CELL,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of the sealed runs, by set."), Writes.OWN_FOLDER
    ] = Path("trials/truth"),
    runs: Annotated[
        str,
        typer.Option("--runs", metavar="LIST", help="Runs of sets in place of the usual, as clean=50,few=0."),
    ] = "",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws everything.")] = 0,
    minutes: Annotated[
        float | None, typer.Option("--minutes", min=0.0, help="Begin no block after that; the next call goes on.")
    ] = None,
) -> Stated:
    """1300 sealed runs in sets (clean, single, pair, outside, narrow, unstated, few stops), stated with intervals."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.skeleton import Stated, not_computed
    from cellapp.commands.trials.truth import sizes_of, truth_sentence, truth_table, truth_trials

    result = truth_trials(load_profile(profile), out, sizes_of(runs), seed, work, TimeLimit.from_now(minutes))
    return Stated(result, (truth_table(result),), (truth_sentence(result),), not_computed(result.failed))


@trial(trials_app, "plans")
def plans(
    work: Work,
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Seeds, from 0 on.")] = 10,
    stops: Annotated[int, typer.Option("--stops", min=10, help="Designed stops that are compared with random.")] = 100,
    whole: Annotated[int, typer.Option("--whole", min=0, help="Stops of whole plans; 0: none.")] = 400,
    bounded: Annotated[int, typer.Option("--bounded", min=0, help="Seeds with the best possible values; slow.")] = 1,
) -> Stated:
    """Designed plans against random ones: what they tell, travel, correlations, and collisions by another library."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.plan_tables import plan_trial_sentences, plan_trial_tables
    from cellapp.commands.trials.plan_trial import plan_trials
    from cellapp.commands.trials.skeleton import Stated, complained

    result = plan_trials(load_profile(profile), range(seeds), stops, bounded, whole, work)
    return Stated(result, plan_trial_tables(result), plan_trial_sentences(result), complained("plans", result))


@trial(trials_app, "targets")
def targets(
    work: Work,
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells.")] = 10,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the first; the next has the next one.")] = 0,
    count: Annotated[int, typer.Option("--targets", min=1, help="New targets of each arm.")] = 200,
    pairs: Annotated[int, typer.Option("--pairs", min=0, help="Cooperative targets; 0: none.")] = 200,
) -> Stated:
    """Whole simulated cells with mixed hidden effects: errors at new targets that are measured, against bars."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.skeleton import Stated, complained
    from cellapp.commands.trials.target_tables import target_trial_sentences, target_trial_tables
    from cellapp.commands.trials.target_trial import target_trials

    result = target_trials(load_profile(profile), range(seed, seed + seeds), count, pairs, work)
    return Stated(result, target_trial_tables(result), target_trial_sentences(result), complained("targets", result))


@trial(trials_app, "check")
def check(
    work: Work,
    profile: SimulatedCell = DEFAULT_CELL,
    seeds: DrawnCells = 10,
    first: FirstSeed = 0,
    earlier: Annotated[int, typer.Option("--earlier", min=40, help="Stops of the calibration.")] = 400,
    stops: Annotated[int, typer.Option("--stops", min=6, help="Stops of a check at most.")] = 20,
    unchanged: Annotated[int, typer.Option("--unchanged", min=0, help="Checks of each cell as it was.")] = 50,
    mix: Mix = False,
    anew: Annotated[bool, typer.Option("--anew", help="The tracker was set up anew before each check.")] = False,
    real: Annotated[
        str, typer.Option("--real", metavar="LIST", help="Check series of real robots instead, as C,D,UR5.")
    ] = "",
    data: SeriesFolder = DATA,
    profiles: SeriesProfiles = PROFILES,
) -> Stated:
    """How often the ten-minute check finds and names a change, and how often it finds one where there is none."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.check_real import real_check_trials
    from cellapp.commands.trials.check_tables import check_trial_sentences, check_trial_tables
    from cellapp.commands.trials.check_trial import CheckPlan, check_trials
    from cellapp.commands.trials.league.series import series_texts
    from cellapp.commands.trials.skeleton import Stated, complained

    chosen = range(first, first + seeds)
    if real:
        texts = series_texts([name.strip() for name in real.split(",")], data, profiles)
        result = real_check_trials(texts, chosen, work, rows=earlier, planned=stops, checks=unchanged)
    else:
        plan = CheckPlan(
            profile=load_profile(profile), earlier=earlier, planned=stops, unchanged=unchanged, mix=mix,
            station_free=anew,
        )  # fmt: skip
        result = check_trials(plan, chosen, work)
    return Stated(result, check_trial_tables(result), check_trial_sentences(result), complained("check", result))


@trial(trials_app, "league")
def league(
    work: Work,
    series: Annotated[str, typer.Option("--series", metavar="LIST", help="Series, separated by commas.")] = "C,D,UR5",
    rows: Annotated[
        str, typer.Option("--rows", metavar="LIST", help="Numbers of rows to learn from, separated by commas.")
    ] = "100,300,all",
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Draws of each.")] = 8,
    first: FirstSeed = 0,
    network: Annotated[bool, typer.Option("--network", help="Train the residual networks too; slow.")] = False,
    curve: Annotated[bool, typer.Option("--curve", help="Also a learning curve of series C.")] = False,
    data: SeriesFolder = DATA,
    profiles: SeriesProfiles = PROFILES,
) -> Stated:
    """Real robots, measured by others: geometry, network and discovery on rows that were held out, against bars."""
    from cellapp.commands.trials.league.series import parse_rows
    from cellapp.commands.trials.league.tables import league_sentences, league_tables
    from cellapp.commands.trials.league.trial import league_trials
    from cellapp.commands.trials.skeleton import Stated, complained

    names = [name.strip() for name in series.split(",")]
    chosen, sizes = range(first, first + seeds), parse_rows(rows)
    result = league_trials(names, sizes, chosen, work, data=data, profiles=profiles, network=network, curve=curve)
    return Stated(result, league_tables(result), league_sentences(result), complained("league", result))


@trial(trials_app, "signature")
def signature(
    work: Work,
    profile: SimulatedCell = DEFAULT_CELL,
    seeds: DrawnCells = 10,
    first: FirstSeed = 0,
    earlier: Annotated[int, typer.Option("--earlier", min=40, help="Stops of the earlier calibration.")] = 400,
    few: Annotated[int, typer.Option("--few", min=5, help="Stops with the earlier calibration.")] = 30,
    many: Annotated[int, typer.Option("--many", min=10, help="Stops without it, to compare with.")] = 150,
    held_out: Annotated[int, typer.Option("--held-out", min=10, help="Stops to compare on.")] = 120,
    mix: Mix = False,
    real: Annotated[bool, typer.Option("--real", help="Series D of a real UR10 with series C as prior.")] = False,
    rows: Annotated[
        str, typer.Option("--rows", metavar="LIST", help="With --real: numbers of rows, separated by commas.")
    ] = "30,60,100",
    data: SeriesFolder = DATA,
    profiles: SeriesProfiles = PROFILES,
) -> Stated:
    """What an arm's earlier calibration is worth when it is calibrated again from few stops, mounted elsewhere."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.league.series import parse_rows
    from cellapp.commands.trials.signature import TwinPlan, real_trials, twin_trials
    from cellapp.commands.trials.signature_tables import signature_sentences, signature_tables
    from cellapp.commands.trials.skeleton import Stated, complained

    chosen = range(first, first + seeds)
    if real:
        result = real_trials(parse_rows(rows), chosen, work, data=data, profiles=profiles)
    else:
        plan = TwinPlan(profile=load_profile(profile), earlier=earlier, few=few, many=many, held_out=held_out, mix=mix)
        result = twin_trials(plan, chosen, work)
    return Stated(result, signature_tables(result), signature_sentences(result), complained("signature", result))


@trial(trials_app, "cost", *ALONE)
def cost(
    work: Work,
    store: Annotated[Path, typer.Argument(metavar="FILE", help="A store that trials wrote with --store.")],
    tasks: Annotated[int, typer.Option("--tasks", min=1, help="Number of tasks to estimate.")] = 1_000_000,
) -> Stated:
    """Processor time and memory of the tasks in a store, and what as many as asked for would need."""
    from cellapp.commands.trials.cost import cost_of, cost_table
    from cellapp.commands.trials.skeleton import Stated

    result = cost_of(store, tasks)
    return Stated(result, [cost_table(result)])


@trial(trials_app, "power")
def power(
    work: Work,
    profile: ProfilePath,
    trials: Annotated[
        int, typer.Option("--trials", min=FEWEST_TRIALS, max=400, help="Trials of each effect and arm.")
    ] = TRIALS_OF_EACH,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.1, help="Time; what fits is shared among the effects.")
    ] = MINUTES,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws laws, true geometry and noise.")] = 0,
) -> Stated:
    """Before measuring: which effects of which size this cell, plan and tracker would have named."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.trials.power.rounds import power_of_profile
    from cellapp.commands.trials.power.tables import power_sentence, power_table
    from cellapp.commands.trials.skeleton import Stated, not_computed

    limit = TimeLimit.from_now(minutes)
    result = power_of_profile(load_profile(profile), trials, seed, work, limit)
    tables = [power_table(name, arm) for name, arm in result.arms.items()]
    return Stated(result, tables, [power_sentence(result)], not_computed(result.failed))
