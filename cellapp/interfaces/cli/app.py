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
from cellapp.interfaces.cli.check import check
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.correct import correct
from cellapp.interfaces.cli.derived import command_of
from cellapp.interfaces.cli.docs import docs
from cellapp.interfaces.cli.export import export
from cellapp.interfaces.cli.fleet import fleet, recalibrate
from cellapp.interfaces.cli.follow import follow
from cellapp.interfaces.cli.init import init
from cellapp.interfaces.cli.iso9283 import app as iso9283_app
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import (
    JsonOption,
    ProfilePath,
)
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.request_commands import abort, pause, resume, stop
from cellapp.interfaces.cli.runs import compare, runs
from cellapp.interfaces.cli.show import schema
from cellapp.interfaces.cli.trials import trials_app

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


for verb in VERBS:
    app.command(verb.name)(command_of(verb))


for command in (
    check,
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
app.add_typer(iso9283_app, name="iso9283")
