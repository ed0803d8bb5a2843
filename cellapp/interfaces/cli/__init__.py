"""The command line: the verbs, the trials, and what all commands share.

A command imports what it needs when it is called, so that help and requests to a running job do not wait for the rest.
"""

from __future__ import annotations

import gc
import os
import sys
from functools import partial

from cellapp.ground.errors import CellappError
from cellapp.interfaces.cli.requests import ask_job, plain_request

_COMPLETION = "_CELLAPP_COMPLETE"
"""Environment variable with which a shell asks typer to complete a command line."""
_COLLECTED_AFTER = (20_000, 10, 10)
"""Thresholds of Python's garbage collector. With its defaults (700, 10, 10) it scans the modules again and again while
they load, and the widgets of the terminal application at every key."""


def main() -> None:
    """Run the program. A plain request to a running job is sent before the rest of the program loads: it may be a stop.

    The list of commands and the terminal application also start without the whole command line. It handles everything
    else, and all errors.
    """
    gc.set_threshold(*_COLLECTED_AFTER)
    if sys.argv[1:] in (["-h"], ["--help"]):
        from cellapp.interfaces.cli.program import run_program
        from cellapp.interfaces.cli.top import overview

        run_program(partial(overview(), prog_name="cellapp"))
        return
    if not sys.argv[1:] and _COMPLETION not in os.environ:
        from cellapp.interfaces.cli.program import run_program
        from cellapp.interfaces.tui import run_app

        run_program(lambda: sys.exit(run_app()))
        return
    request = plain_request(sys.argv[1:])
    if request is None:
        from cellapp.interfaces.cli.app import main as whole_program

        whole_program()
        return
    try:
        ask_job(request)
    except (CellappError, OSError, ValueError, KeyboardInterrupt) as error:
        from cellapp.interfaces.cli.program import end_with

        end_with(error)
