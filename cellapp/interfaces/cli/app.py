"""The verbs as commands: parse, call, print. Slow imports are inside functions, so that commands start quickly."""

from __future__ import annotations

import sys
from functools import cache

from cellapp.commands.registry import ALL, GROUPS, PANEL, name_of, records
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.top import InOrder, add_requests, top
from cellapp.interfaces.cli.verb_commands import add_verb


@cache
def program(verbs: tuple[str, ...] = ALL) -> Commands:
    """Create the program with the commands of some verbs, and the requests to a running job, which are no verbs."""
    app, panels = top(), {name_of(word): panel for word, panel in PANEL.items()}
    groups = {word: Commands(cls=InOrder, help=words, no_args_is_help=True) for word, words in GROUPS.items()}
    add_requests(app, groups["job"])
    for verb in records(verbs):
        word, _, own = verb.name.partition(" ")
        if own:
            add_verb(groups[word], verb, own)
        else:
            add_verb(app, verb, word, panels[word])
    for word, group in groups.items():
        app.add_typer(group, name=word, rich_help_panel=panels[word])
    return app


def main() -> None:
    """Run the program; exit codes as in the handbook, chapter "commands"."""
    run_program(lambda: program(_needed(sys.argv[1:]))(prog_name="cellapp"))


def _needed(arguments: list[str]) -> tuple[str, ...]:
    """Return the verbs that a command line needs: only that which it names; all of them if it names no command."""
    first = arguments[0] if arguments else ""
    if first == "stop":
        return ()
    return tuple(verb for verb in ALL if name_of(verb) == first) or ALL
