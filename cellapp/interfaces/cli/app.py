"""The verbs as commands: parse, call, print. Slow imports are inside functions, so that commands start quickly."""

from __future__ import annotations

from functools import partial

from cellapp.commands.registry import VERBS
from cellapp.interfaces.cli.derived import add_verbs
from cellapp.interfaces.cli.program import run_program
from cellapp.interfaces.cli.top import REQUESTS, top
from cellapp.interfaces.cli.trials import trials_app

app = top()
add_verbs(app, VERBS)
for request in REQUESTS:
    app.command()(request)
app.add_typer(trials_app, name="trials")


def main() -> None:
    """Run the program; exit codes as in the handbook, chapter "commands"."""
    run_program(partial(app, prog_name="cellapp"))
