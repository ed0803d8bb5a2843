"""The terminal application: ``cellapp`` without arguments. Importing this package does not load Textual.

Screens and jobs import what they need at first use, so that the first screen does not wait for the rest.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from cellapp.ground.errors import InputError

ESCAPE_WAITS_MS = 15
"""Time for which an Escape byte may be the start of another key's sequence; terminals send the rest at once."""

_SWITCH_S = 0.001
"""Thread switch interval [s]. Several threads run between a key and the brakes: one that computes must yield soon."""


def run_app() -> int:
    """Run the application on the folder ``profiles`` until the user quits. Return the exit code of the last job.

    0 done (or no job was started), 2 bad input, 3 hardware or unexpected error, 4 stopped and resumable.

    Raises
    ------
    InputError
        If keys cannot be read from a terminal, or it cannot be drawn on.
    """
    # Textual reads keys from standard input and draws on standard error
    if not all(stream is not None and stream.isatty() for stream in (sys.__stdin__, sys.__stderr__)):
        raise InputError(
            "the terminal application needs a terminal: standard input or error is not one; 'cellapp run PROFILE'"
            " does the day unattended, 'cellapp --help' lists all commands"
        )
    os.environ["ESCDELAY"] = str(ESCAPE_WAITS_MS)  # Textual reads this at import
    from cellapp.interfaces.tui.app import CellApp

    sys.setswitchinterval(_SWITCH_S)
    app = CellApp(Path("profiles"), ends_process=True)
    app.passes.watch()
    app.run()
    app.leaving.wait_for_job()
    return app.return_code or 0
