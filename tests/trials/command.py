"""Each trial of the program as a command of its own: ``python -m tests.trials.NAME``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.program import run_program


def trial_command(trial: Callable[..., Any]) -> Commands:
    """A program that is this one command, with exit codes and JSON as every command of cellapp has them."""
    app = Commands(add_completion=False, pretty_exceptions_enable=False)
    app.command()(trial)
    return app


def run_trial(app: Commands, name: str) -> None:
    """Run the command as the program ``python -m tests.trials.NAME``."""
    run_program(partial(app, prog_name=f"python -m tests.trials.{name}"))
