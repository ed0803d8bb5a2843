"""The verbs as commands: parse, call, print. Slow imports are inside functions, so that commands start quickly."""

from __future__ import annotations

import sys
from functools import cache

from cellapp.commands.registry import ALL, PANEL, name_of, records
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.top import add_requests, top
from cellapp.interfaces.cli.trials import trials_app
from cellapp.interfaces.cli.verb_commands import add_verb

_TRIALS = "trials"


@cache
def program(verbs: tuple[str, ...] = ALL) -> Commands:
    """Create the program with the commands of some verbs, and those that are no verb."""
    app = top()
    job = add_requests(app)
    for word, verb in zip(verbs, records(verbs), strict=True):
        if word == "job":
            add_verb(job, verb, verb.name.removeprefix("job "))
        else:
            add_verb(app, verb, verb.name, PANEL[word])
    app.add_typer(trials_app, name=_TRIALS, rich_help_panel=PANEL[_TRIALS])
    return app


def main() -> None:
    """Run the program; exit codes as in the handbook, chapter "commands"."""
    run_program(lambda: program(_needed(sys.argv[1:]))(prog_name="cellapp"))


def _needed(arguments: list[str]) -> tuple[str, ...]:
    """Return the verbs that a command line needs: only that which it names; all of them if it names no command."""
    first = arguments[0] if arguments else ""
    if first in (_TRIALS, "stop"):
        return ()
    return tuple(verb for verb in ALL if name_of(verb) == first) or ALL
