"""Top level of the command line: the program's own help and options, and the order of the commands.

``stop`` and ``job pause``, ``resume``, ``abort`` as regular commands, with help, options and usage errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from cellapp.commands.registry import PANEL, help_of, name_of
from cellapp.ground.errors import InputError
from cellapp.ground.job_client import Verb
from cellapp.ground.removed import removed_command
from cellapp.ground.version import __version__
from cellapp.interfaces.cli.command_outputs import HELP_OPTIONS, JSON, Commands, JsonOption, RunFolder, calling, forcing
from cellapp.interfaces.cli.requests import JobRequest, ask_job

REQUESTS: Mapping[Verb, str] = {
    "stop": "Brake all arms of the job that runs in DIR now. It can be resumed.",
    "pause": "Let the job that runs in DIR finish the present stop, then wait with the arms at rest.",
    "resume": "Let a paused job continue, or a stopped one that waits for it.",
    "abort": "Brake all arms of the job that runs in DIR now, and end the job.",
}
"""Request to a running job -> its help."""


def _asking(verb: Verb) -> Callable[..., None]:
    """Return the command of a request."""

    def ask(folder: RunFolder, json_file: JsonOption = None, force: Annotated[bool, forcing("--json")] = False) -> None:
        with calling({"folder": folder, "json_file": json_file}, JSON, ["DIR"], force=force):
            ask_job(JobRequest(verb, folder, json_file, force))

    ask.__name__ = verb
    return ask


def add_requests(app: Commands, job: Commands) -> None:
    """Add ``stop``, and to the group ``job`` the other requests to a running job."""
    for verb, words in REQUESTS.items():
        if verb == "stop":
            app.command(verb, help=words, rich_help_panel=PANEL[verb])(_asking(verb))
        else:
            job.command(verb, help=words)(_asking(verb))


class InOrder(TyperGroup):
    """A group that lists commands and subgroups in the order of the work, and answers for removed commands."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if removed := removed_command(" ".join([*ctx.command_path.split()[1:], cmd_name])):
            raise InputError(removed)
        return super().get_command(ctx, cmd_name)

    def list_commands(self, ctx: Any) -> list[str]:
        work = [name_of(word) for word in PANEL]
        return sorted(super().list_commands(ctx), key=lambda name: work.index(name) if name in work else len(work))


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"cellapp {__version__}")
        raise typer.Exit


def top() -> Commands:
    """Create the program without its commands."""
    app = Commands(
        cls=InOrder,
        help="Calibrate a dual-arm robot cell with a laser tracker, and name the physics that the model is missing.",
        no_args_is_help=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": HELP_OPTIONS},
    )
    app.callback(invoke_without_command=True)(_tui)
    return app


def _tui(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Without a command: the terminal application."""
    if context.invoked_subcommand is None:
        from cellapp.interfaces.tui import run_app

        raise typer.Exit(run_app())


def overview() -> Commands:
    """Create the program for its help page: commands have only their help text, so little is loaded."""
    app = top()
    for word, panel in PANEL.items():
        words = REQUESTS["stop"] if word == "stop" else help_of(word)
        app.command(name_of(word), help=words, rich_help_panel=panel)(lambda: None)
    return app
