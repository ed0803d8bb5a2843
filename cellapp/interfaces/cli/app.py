"""The verbs as commands: parse, call, print. Slow imports stand where they are used, so that --help is quick."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cellapp import __version__
from cellapp.commands.registry import VERBS
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.interfaces.cli.at_rest import at_rest
from cellapp.interfaces.cli.certificate import certificate, check_certificate, sign_key
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.correct import correct
from cellapp.interfaces.cli.derived import command_of, group_of
from cellapp.interfaces.cli.docs import docs
from cellapp.interfaces.cli.export import export
from cellapp.interfaces.cli.fleet import fleet, recalibrate
from cellapp.interfaces.cli.follow import follow
from cellapp.interfaces.cli.init import init
from cellapp.interfaces.cli.job import Job, open_run, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import (
    AllowMotion,
    JsonOption,
    NewRun,
    OutOfDate,
    PriorOption,
    ProfilePath,
    RunFolder,
    TargetsPath,
)
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.report import report
from cellapp.interfaces.cli.request_commands import abort, pause, resume, stop
from cellapp.interfaces.cli.runs import compare, runs
from cellapp.interfaces.cli.show import schema, show, show_discovery
from cellapp.interfaces.cli.trials import trials_app
from cellapp.interfaces.cli.whole_run import demo, run

app = Commands(
    help="Calibrate a dual-arm robot cell with a laser tracker, and name the physics that the model is missing.",
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """The program; exit codes as in the handbook, chapter "commands"."""
    run_program(partial(app, prog_name="cellapp"))


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"cellapp {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def tui(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Without a command: the terminal application."""
    if context.invoked_subcommand is None:
        from cellapp.interfaces.tui import run_app

        raise typer.Exit(run_app())


for whole in (run, demo):
    app.command()(whole)


@app.command()
def doctor(
    profile: ProfilePath,
    cell: Annotated[bool, typer.Option("--cell", help="First print what the profile says of the cell.")] = False,
    json_file: JsonOption = None,
) -> None:
    """What is reachable, what is missing, what would be refused; nothing moves."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.doctor.doctor import examine_run
    from cellapp.commands.doctor.profile_view import profile_tables

    with Job(json_file) as job:
        described = load_profile(profile)
        if cell:
            job.show(profile_tables(described))
        result = examine_run(described)
        job.say(*(f"{finding.status:8} {finding.subject}: {finding.text}" for finding in result.findings))
        job.result(result)
        if result.failed:
            raise CheckFailed(f"{len(result.failed)} of {len(result.findings)} checks failed")


@app.command()
def plan(
    profile: Annotated[Path | None, typer.Argument(metavar="PROFILE", help="The cell, as YAML.")] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--run",
            metavar="DIR",
            help="Folder of the new run; with --add, --replan, --freeze that of the run to change.",
        ),
    ] = None,
    source: Annotated[
        Path | None, typer.Option("--from", metavar="FILE", help="Take the plan from FILE exactly as it is written.")
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", metavar="FILE", help="Freeze the stops of FILE; design the rest around."),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option("--check", metavar="FILE", help="Only check the plan in FILE; exit code 1 if unsafe."),
    ] = None,
    add: Annotated[
        int | None, typer.Option("--add", metavar="N", min=1, max=100_000, help="Append N stops to the plan of a run.")
    ] = None,
    replan: Annotated[
        bool, typer.Option("--replan", help="Design the stops of a run that are not measured again.")
    ] = False,
    freeze: Annotated[
        str | None,
        typer.Option(
            "--freeze", metavar="LIST", help="Configurations, as 0-9,12, that later designs of the run leave."
        ),
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Only say what the tracker sees of each arm's workspace; nothing is stored.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Plan the stops of a run: visible to the tracker, safe to stand at and to reach.

    'cellapp export DIR --plan FILE' writes a plan as CSV, to be edited by hand.
    """
    from cellapp.interfaces.cli.plan import PlanChoice, run_plan

    with Job(json_file) as job:
        run_plan(job, PlanChoice(profile, folder, source, keep, check, add, replan, freeze, view))


@app.command()
def collect(
    folder: RunFolder,
    resume: Annotated[bool, typer.Option("--resume", help="Continue a run that was interrupted.")] = False,
    accept_drift: Annotated[
        bool, typer.Option("--accept-drift", help="Count drift from new reference measurements on.")
    ] = False,
    allow_motion: AllowMotion = False,
    json_file: JsonOption = None,
) -> None:
    """Drive the planned stops and measure; every stop is committed before the next move."""
    from cellapp.commands.collect.run import collect_stops
    from cellapp.commands.collect.view import collect_lines, other_notes

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        ask = asking(job, opened.profile.name, allowed=allow_motion)
        result = collect_stops(opened, job.listen, job.control, resume=resume, accept_drift=accept_drift, ask=ask)
        job.say(*collect_lines(result), *other_notes(result, result.notes))
        job.result(result)
        require_none(result.complaints(), "collect")


@app.command()
def replay(
    folder: RunFolder,
    speed: Annotated[
        float, typer.Option("--speed", metavar="X", help="Times the recorded pace, from 1 to 100.")
    ] = 10.0,
    json_file: JsonOption = None,
) -> None:
    """Play the collecting of a run back: the same events, the same running model; nothing moves, nothing is written."""
    from cellapp.cell.driving.replay import replay_run
    from cellapp.commands.collect.view import replay_lines

    with Job(json_file) as job, open_run(folder) as opened:
        result = replay_run(opened, job.listen, job.control, speed=speed)
        job.say(*replay_lines(result))
        job.result(result)


@app.command("import")
def import_(
    profile: ProfilePath,
    csv: Annotated[Path, typer.Argument(metavar="CSV", help="Readings; 'cellapp docs files' has the columns.")],
    folder: NewRun,
    in_order: Annotated[
        bool,
        typer.Option(
            "--in-order",
            help="Rows stand in the order of measurement (with time_s: by time); derive missing approach and step.",
        ),
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Make a run from readings that were measured elsewhere."""
    from cellapp.cell.profile import load_profile
    from cellapp.commands.import_.run import import_new_run

    with Job(json_file) as job:
        result = import_new_run(load_profile(profile), csv, folder, in_order=in_order)
        job.say(*(f"arm {name}: {count} readings" for name, count in result.readings.items()), *result.notes)
        job.result(result)


@app.command()
def calibrate(
    folder: RunFolder,
    parameters: Annotated[
        bool, typer.Option("--parameters", help="Print the parameters too; 'show DIR parameters' prints stored ones.")
    ] = False,
    prior: PriorOption = None,
    json_file: JsonOption = None,
) -> None:
    """Identify arms and pair, evaluate on held-out stops, write calibration.json."""
    from cellapp.commands.calibrate.run import calibrate_run
    from cellapp.commands.calibrate.view import calibration_tables, parameter_tables, tracker_sentences
    from cellapp.commands.show.tables import merged_sentences

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        result = calibrate_run(opened, job.listen, job.control, prior=prior)
        job.show(calibration_tables(result))
        if parameters:
            job.show(parameter_tables(result))
            job.say(*merged_sentences(result))
        job.say(*tracker_sentences(result), *result.notes)
        job.result(result)


@app.command()
def discover(
    folder: RunFolder,
    propose: Annotated[
        int | None,
        typer.Option(
            "--propose", metavar="N", min=1, max=1000, help="Plan N further stops that best resolve what is open."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Find where model and measurement disagree, name the missing effect, add it, show the gap shrink."""
    from cellapp.commands.discover.proposal_view import proposal_lines
    from cellapp.commands.discover.run import discover_run, propose_run

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        if propose is None:
            result = discover_run(opened, job.listen, job.control)
        else:
            result = propose_run(opened, propose, job.listen, job.control)
        show_discovery(job, result)
        if result.proposal is not None:
            job.say("", *proposal_lines(result.proposal))
        job.result(result)


for verb in VERBS:
    if verb.variants:
        app.add_typer(group_of(verb), name=verb.name)
    else:
        app.command(verb.name)(command_of(verb))


@app.command()
def compensate(folder: RunFolder, targets: TargetsPath, json_file: JsonOption = None) -> None:
    """Joint positions that bring the real arms to Cartesian targets, from the calibrated model."""
    from cellapp.cell.targets.targets import load_targets
    from cellapp.commands.compensate.run import compensate_run
    from cellapp.commands.compensate.tables import predicted_tables
    from cellapp.commands.compensate.words import compensate_lines

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        result = compensate_run(opened, load_targets(targets, opened.profile))
        job.show(predicted_tables(result))
        job.say(*compensate_lines(result))
        job.result(result)


@app.command()
def push(
    folder: RunFolder,
    targets: TargetsPath,
    verify: Annotated[bool, typer.Option("--verify", help="Measure where the SMR really goes.")] = False,
    iterate: Annotated[
        int | None,
        typer.Option("--iterate", metavar="N", help="Correct what remains by measuring, at most N times a target."),
    ] = None,
    out_of_date: OutOfDate = False,
    allow_motion: AllowMotion = False,
    json_file: JsonOption = None,
) -> None:
    """Move the arms to compensated targets; with --verify, measure them before and after compensation."""
    from cellapp.cell.targets.targets import load_targets
    from cellapp.commands.calibrate.view import verification_tables
    from cellapp.commands.compensate.words import push_lines
    from cellapp.commands.push.run import push_run

    with Job(json_file) as job, open_run(folder, write=True) as opened:
        listed = load_targets(targets, opened.profile)
        ask = asking(job, opened.profile.name, allowed=allow_motion)
        result = push_run(
            opened,
            listed,
            job.listen,
            job.control,
            verify=verify,
            iterate=iterate,
            out_of_date=out_of_date,
            ask=ask,
        )
        job.show(verification_tables(result))
        job.say(*push_lines(result))
        job.result(result)
        if verify:
            require_none(result.complaints(), "verification")


for command in (
    report,
    follow,
    init,
    export,
    correct,
    pause,
    resume,
    stop,
    abort,
    at_rest,
    runs,
    compare,
    fleet,
    recalibrate,
    show,
    schema,
    docs,
):
    app.command()(command)
for of_certificates in (certificate, sign_key, check_certificate):
    app.command()(of_certificates)


@app.command()
def emulate(
    profile: ProfilePath,
    pace: Annotated[
        float, typer.Option("--pace", metavar="X", min=0.1, max=1000.0, help="Simulated seconds for each real one.")
    ] = 1.0,
    json_file: JsonOption = None,
) -> None:
    """Emulate this cell's controllers and, behind a bridge, its tracker, on loopback until interrupted."""
    from dataclasses import asdict

    from cellapp.cell.profile import load_profile
    from cellapp.commands.doctor.result import EmulateResult
    from cellapp.commands.emulate.emulate import EmulatedArm, EmulatedTracker
    from cellapp.commands.emulate.emulate import emulate as serve

    with Job(json_file) as job:
        trackers: list[EmulatedTracker] = []

        def announce(arms: Sequence[EmulatedArm]) -> None:
            job.say(*(str(arm) for arm in arms), *(str(tracker) for tracker in trackers), "Ctrl-C ends this")
            tracker = asdict(trackers[0]) if trackers else None
            served = {"pace": pace, "arms": [asdict(arm) for arm in arms], "tracker": tracker}
            job.result(EmulateResult.model_validate(served))

        serve(load_profile(profile), job.control, announce, pace=pace, announce_tracker=trackers.append)


@app.command("tracker-bridge")
def tracker_bridge(
    profile: ProfilePath,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; one that other machines reach needs a token.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, help="TCP port; else 50960, or none beside --serial.")
    ] = None,
    serial: Annotated[
        str | None, typer.Option("--serial", metavar="PORT", help="A serial port to serve, as COM3 or /dev/ttyUSB0.")
    ] = None,
    baud: Annotated[int, typer.Option("--baud", min=300, help="Of the serial port.")] = 115200,
    token_file: Annotated[
        Path | None, typer.Option("--token-file", metavar="FILE", help="The shared token; only you may read the file.")
    ] = None,
    token_env: Annotated[
        str | None, typer.Option("--token-env", metavar="NAME", help="Environment variable that holds the token.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Serve the tracker that this computer is wired to, to the cell PC, until interrupted."""
    from dataclasses import asdict

    from cellapp.cell.profile import load_profile
    from cellapp.commands.doctor.result import TrackerBridgeResult
    from cellapp.commands.tracker_bridge.tracker_bridge import DEFAULT_PORT, ServedTracker, serve_tracker

    with Job(json_file) as job:
        if token_file is not None and token_env is not None:
            raise InputError("tracker-bridge: give --token-file or --token-env, not both")

        def announce(served: ServedTracker) -> None:
            job.say(str(served), "Ctrl-C ends this")
            job.result(TrackerBridgeResult.model_validate(asdict(served)))

        serve_tracker(
            load_profile(profile),
            job.control,
            announce,
            host=host,
            port=DEFAULT_PORT if port is None and serial is None else port,
            serial=serial,
            baud=baud,
            token_file=token_file,
            token_env=token_env,
        )


app.add_typer(trials_app, name="trials")
