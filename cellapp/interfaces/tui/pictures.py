"""Pictures of the terminal application, drawn without a terminal: its first question and every screen of the day."""

from __future__ import annotations

import asyncio
import re
import tempfile
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.cell.profile.files import write_new
from cellapp.ground.outputs import NEW_ONLY, Outputs

if TYPE_CHECKING:
    from textual.pilot import Pilot


SIZE = (120, 40)
"""Columns and lines of a typical terminal."""
_WAIT_S = 300.0
FIRST_RUN = "first-run"
"""Name of the picture of the question in a folder without profiles; drawn beside the screens."""
_FONT = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
_PLAN_TAB = "tab-design"
"""The most informative tab of the screen Plan."""
_SETTLED = 3
"""Rounds of waiting: a screen draws what a thread has read one message later, and may then begin to read again."""


def screen_file(step: str) -> str:
    """Return the file name of the picture of a step's screen."""
    return f"screen-{step}.svg"


def write_screens(
    profile: Path, run: Path | None, folder: Path, size: tuple[int, int] = SIZE, outputs: Outputs = NEW_ONLY
) -> list[Path]:
    """Draw every screen as an SVG file, with a run or without one; return the paths. The run is not changed.

    The first picture is that of the first start, in a folder without profiles.

    Parameters
    ----------
    profile : Path
        A profile; if ``run`` is given, the one from which it was planned.
    run : Path or None
        Folder of the run.
    folder : Path
        Folder of the pictures.
    size : tuple
        Columns and lines.
    outputs : Outputs
        What may be replaced; default: nothing.

    Raises
    ------
    InputError
        If profile or run cannot be read, or the folder cannot be written.
    """
    from cellapp.cell.profile import load_profile
    from cellapp.cell.run import RunFile

    load_profile(profile)
    if run is not None:
        with RunFile.open(run):
            pass
    pictures = asyncio.run(_pictures(profile, run, size))
    return list(write_new({folder / name: svg for name, svg in pictures.items()}, outputs))


async def _pictures(profile: Path, run: Path | None, size: tuple[int, int]) -> dict[str, str]:
    """Return name -> SVG text of the picture of every screen."""
    from textual.widgets import TabbedContent

    from cellapp.interfaces.tui.app import CellApp
    from cellapp.interfaces.tui.screens import SCREENS

    pictures = {screen_file(FIRST_RUN): await _first_run(size)}
    with _runs_of(run) as runs:
        app = CellApp(profile.parent, runs)
        async with app.run_test(size=size) as pilot:
            await settle(pilot)
            if run is None:
                app.open_profile(profile)
            else:
                app.open_run(run, profile)
            for entry in SCREENS:
                app.action_show(entry.step)
                await settle(pilot)
                if run is not None and entry.step == "plan":
                    app.screen.query_one(TabbedContent).active = _PLAN_TAB
                    await settle(pilot)
                svg = app.export_screenshot(title=f"cellapp: {entry.title}")
                pictures[screen_file(entry.step)] = _without_fonts(svg)
    return pictures


async def _first_run(size: tuple[int, int]) -> str:
    """Return the SVG text of the question in an empty folder."""
    from cellapp.interfaces.tui.app import CellApp

    with tempfile.TemporaryDirectory() as name, chdir(name):  # the question names the folder as people see it
        app = CellApp(Path("profiles"), Path("logs"))
        async with app.run_test(size=size) as pilot:
            await settle(pilot)
            return _without_fonts(app.export_screenshot(title="cellapp"))


@contextmanager
def _runs_of(run: Path | None) -> Iterator[Path]:
    """Yield the folder that the screen Runs lists: only the run itself, or an empty one."""
    if run is not None:
        yield run
        return
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


async def settle(pilot: Pilot[None]) -> None:
    """Wait until the threads that read for the screens have ended and their data are drawn."""
    async with asyncio.timeout(_WAIT_S):
        for _ in range(_SETTLED):
            await pilot.app.workers.wait_for_complete()
            await pilot.pause()


def _without_fonts(svg: str) -> str:
    """Remove web fonts from the picture: any fixed-width font works, as the width of each text is given."""
    return _FONT.sub("", svg).replace("font-family: Fira Code, monospace", "font-family: monospace")
