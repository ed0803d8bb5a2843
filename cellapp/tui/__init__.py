"""The terminal application: ``cellapp`` without arguments. Importing this package does not load Textual."""

from __future__ import annotations

from pathlib import Path


def run_app(folder: Path = Path("profiles")) -> int:
    """Run the application on the profiles of a folder until the user quits. Returns the exit code of the last job.

    0 done (or no job was started), 2 bad input, 3 hardware or unexpected error, 4 stopped and resumable.
    """
    from cellapp.tui.app import CellApp

    app = CellApp(folder)
    app.run()
    app.wait_for_job()
    return app.return_code or 0
