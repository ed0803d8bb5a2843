"""The verbs as commands: parse, call, print. Slow imports stand where they are used, so that --help is quick."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from cellapp.commands.registry import VERBS
from cellapp.ground.version import __version__
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.derived import add_verbs
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.request_commands import abort, pause, resume, stop
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


add_verbs(app, VERBS)
for request in (pause, resume, stop, abort):
    app.command()(request)
app.add_typer(trials_app, name="trials")
