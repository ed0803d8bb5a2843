"""The screen: ``cellapp`` without arguments. Importing this package is cheap; Textual is loaded when it opens."""

from __future__ import annotations

from pathlib import Path


def run_app(folder: Path = Path("profiles")) -> int:
    """Open the screen on the profiles of a folder and stay until the person leaves. Returns the exit code.

    The code is that of the last run: 0 done (or none was started), 2 bad input, 3 hardware or an unexpected error,
    4 stopped and resumable.
    """
    from cellapp.tui.app import CellApp

    app = CellApp(folder)
    app.run()
    return app.return_code or 0
