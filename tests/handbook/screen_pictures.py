"""Pictures of the terminal application, drawn without a terminal: its first question and every screen of the day."""

from __future__ import annotations

import asyncio
import re
import tempfile
from contextlib import chdir
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import TabbedContent

from cellapp.ground.outputs import RENEWED, write_new
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.screens import SCREENS

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


def write_screens(profile: Path, run: Path, folder: Path) -> list[Path]:
    """Draw every screen with a run as an SVG file; return the paths. The run is not changed.

    The first picture is that of the first start, in a folder without profiles.
    """
    pictures = asyncio.run(_pictures(profile, run))
    return list(write_new({folder / name: svg for name, svg in pictures.items()}, RENEWED))


async def _pictures(profile: Path, run: Path) -> dict[str, str]:
    """Return name -> SVG text of the picture of every screen."""
    pictures = {screen_file(FIRST_RUN): await _first_run()}
    app = CellApp(profile.parent, run)
    async with app.run_test(size=SIZE) as pilot:
        await settle(pilot)
        app.open_run(run, profile)
        for entry in SCREENS:
            app.action_show(entry.step)
            await settle(pilot)
            if entry.step == "plan":
                app.screen.query_one(TabbedContent).active = _PLAN_TAB
                await settle(pilot)
            pictures[screen_file(entry.step)] = _without_fonts(app.export_screenshot(title=f"cellapp: {entry.title}"))
    return pictures


async def _first_run() -> str:
    """Return the SVG text of the question in an empty folder."""
    with tempfile.TemporaryDirectory() as name, chdir(name):  # the question names the folder as people see it
        app = CellApp(Path("profiles"), Path("logs"))
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            return _without_fonts(app.export_screenshot(title="cellapp"))


async def settle(pilot: Pilot[None]) -> None:
    """Wait until the threads that read for the screens have ended and their data are drawn."""
    async with asyncio.timeout(_WAIT_S):
        for _ in range(_SETTLED):
            await pilot.app.workers.wait_for_complete()
            await pilot.pause()


def _without_fonts(svg: str) -> str:
    """Remove web fonts from the picture: any fixed-width font works, as the width of each text is given."""
    return _FONT.sub("", svg).replace("font-family: Fira Code, monospace", "font-family: monospace")
