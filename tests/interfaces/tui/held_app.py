"""A job that moves nothing and notes how it is braked: ``python -m tests.interfaces.tui.held_app FILE``.

A line of the file is a call of the brakes: what was asked, and how the person left. With ``--asks`` the job asks before
its first motion; with ``--no-job`` nothing runs. What screens and jobs will need is not loaded ahead: it is not needed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cellapp.interfaces.tui
from cellapp.interfaces.tui.app import CellApp
from tests.interfaces.tui.pilot import PROFILES, MovingJob


class WrittenJob(MovingJob):
    """Writes each call of the brakes into a file."""

    file: Path

    def _brake(self, verb: str) -> None:
        with self.file.open("a", encoding="utf-8") as file:
            file.write(f"{verb} {self.control.departure}".rstrip() + "\n")


class HeldApp(CellApp):
    """Starts the job as soon as a profile is open."""

    CSS_PATH = str(Path(cellapp.interfaces.tui.__file__).with_name("app.tcss"))

    def __init__(self, moving: WrittenJob | None) -> None:
        super().__init__(PROFILES, ends_process=True)
        self._moving = moving

    def _preload(self) -> None:  # type: ignore[override]
        """Load nothing."""

    def draw_all(self) -> None:
        """Draw, and start the job once."""
        super().draw_all()
        moving = self._moving
        if moving and self.workspace.profile is not None and not moving.began.is_set() and not self.jobs.running:
            self.start_job(moving.job(Path("here")))


def main(file: str, *options: str) -> int:
    """Run the application; return its exit code."""
    moving = WrittenJob(asks="--asks" in options)
    moving.file = Path(file)
    app = HeldApp(None if "--no-job" in options else moving)
    app.run()
    app.leaving.wait_for_job()
    return app.return_code or 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
