"""A day on the small twin as the screens show it, recorded as text at three sizes.

    python -m tests.interfaces.tui.recorded_day FOLDER [SIZE ...]

writes ``FOLDER/SIZE/NUMBER-MOMENT.txt``; sizes are ``80x24``, ``120x40``, ``200x60``. The keys are those of a person:
from a folder with profiles to a calibrated, verified and judged run, with a pause, a stop, and a stop measured again.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import chdir
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from textual.pilot import Pilot
from textual.screen import ModalScreen
from textual.widgets import TabbedContent, TabPane

from cellapp.ground.control import JobControl
from cellapp.ground.progress import Listener, PointMeasured, Progress
from cellapp.ground.results import Result
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.jobs import Ask, Job
from cellapp.interfaces.tui.screens import SCREENS
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import PROFILES, SIZES, shown_text, turned_to, until

JOB_S = 120.0
"""What a whole job may compute; each step of it is soon."""
PROFILE = "twin-small"
FEW, ALL = 24, 10_000
"""Stops that are let pass: twelve of each arm; more than the day has."""


@dataclass
class PacedStops:
    """Lets a job go on after a stop only as often as it is told: the screens of a slow machine are kept, too."""

    app: CellApp
    _passes: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))

    def let(self, count: int) -> None:
        """Let that many further stops pass."""
        self._passes.release(count)

    def start(self, job: Job, control: JobControl | None = None) -> None:
        """Start a job as the application does, with its stops held."""

        def work(listen: Listener, control: JobControl, ask: Ask) -> Result | None:
            def heard(event: Progress) -> None:
                listen(event)
                if isinstance(event.detail, PointMeasured):
                    self._passes.acquire(timeout=JOB_S)

            return job.work(heard, control, ask)

        type(self.app.jobs).start(self.app.jobs, replace(job, work=work), control)


@dataclass
class Recorder:
    """Presses keys and writes what the screen shows into a folder, a file for each moment."""

    pilot: Pilot[None]
    app: CellApp
    folder: Path
    written: list[Path] = field(default_factory=list)

    async def press(self, *keys: str) -> None:
        """Press keys one after the other, each once the screen rests."""
        for key in keys:
            await self.pilot.press(key)
            await self.pilot.pause()

    async def until(self, holds: Callable[[], Any], what: str) -> None:
        """Wait for a condition."""
        await until(self.pilot, holds, what, JOB_S)

    async def begin(self, step: str, key: str = "b", answer: str = "b") -> None:
        """Begin the work of a screen, and answer the question that comes before it, if one does."""
        await self.press(step)
        await settle(self.pilot)
        before = self.app.record.since
        await self.press(key)
        await self.until(lambda: self.asked or self.app.record.since != before, "a question or the job")
        if self.asked:
            self.keep(f"asked-{step}-{key}")
            await self.press(answer)
            await self.until(lambda: self.app.record.since != before, "the job")

    @property
    def asked(self) -> bool:
        """Whether a question is shown."""
        return isinstance(self.app.screen, ModalScreen)

    async def says(self, text: str) -> None:
        """Wait until the screen says something, wherever its lines break."""
        await self.until(lambda: text in " ".join(shown_text(self.app).split()), text)

    async def ended(self) -> None:
        """Wait until no job runs and what it stored is drawn."""
        await self.until(lambda: not self.app.jobs.running, "the end of the job")
        await settle(self.pilot)

    def keep(self, moment: str) -> None:
        """Keep what is shown."""
        self.written.append(self.folder / f"{len(self.written) + 1:03}-{moment}.txt")
        self.written[-1].write_text(shown_text(self.app) + "\n", encoding="utf-8")

    async def keep_screens(self, moment: str, *, tabs: bool = False) -> None:
        """Keep every screen, on request with all its tabs."""
        for entry in SCREENS:
            await self.press(entry.key)
            await settle(self.pilot)
            self.keep(f"{moment}-{entry.step}")
            names = [tab.id or "" for tab in self.app.screen.query(TabPane).results()] if tabs else []
            for name in names[1:]:
                self.app.screen.query_one(TabbedContent).active = name
                await self.pilot.pause()
                self.keep(f"{moment}-{entry.step}-{name}")


async def recorded(size: tuple[int, int], folder: Path) -> list[Path]:
    """Record a day in the present folder, which holds profiles; the files that were written into ``folder``."""
    app = CellApp(Path("profiles"))
    async with app.run_test(size=size) as pilot:
        day, stops = Recorder(pilot, app, folder), PacedStops(app)
        app.jobs.start = stops.start  # type: ignore[method-assign]
        await day.until(lambda: app.workspace.profile is not None, "a profile")
        app.open_profile(Path("profiles") / f"{PROFILE}.yaml")
        await day.until(lambda: app.workspace.profile is not None and app.workspace.profile.name == PROFILE, PROFILE)
        await day.keep_screens("empty")
        await planned_and_collected(day, stops)
        await calibrated(day)
        await accepted(day)
        return day.written


async def planned_and_collected(day: Recorder, stops: PacedStops) -> None:
    """Plan; collect with a pause and a stop on the way; a look at every screen at each of them."""
    app = day.app
    await day.begin("2", answer="enter")
    await day.until(lambda: app.record.latest is not None, "the plan's progress")
    day.keep("planning")
    await day.ended()
    await day.keep_screens("planned")
    stops.let(FEW)
    await day.begin("3")
    await day.until(lambda: "collect" in app.record.progress and app.record.progress["collect"].done >= 10, "ten stops")
    day.keep("collecting")
    await day.press("p")
    stops.let(FEW)
    await day.until(lambda: app.record.state == "paused", "the pause")
    await day.keep_screens("paused")
    await day.press("3", "c")
    await day.until(lambda: app.record.state == "running", "running")
    await day.press("escape")
    stops.let(ALL)
    await day.until(lambda: app.record.state == "stopped", "the stop")
    await day.keep_screens("stopped")
    await day.press("3", "x")
    await day.ended()
    await day.keep_screens("part")
    await day.begin("3")
    await day.ended()
    await day.keep_screens("complete")


async def calibrated(day: Recorder) -> None:
    """Calibrate and search, seen from their screens and from another one; a stop is measured again; both again."""
    app = day.app
    await day.begin("4")
    day.keep("calibrating")
    await day.ended()
    await day.begin("5")
    await day.press("4")
    await day.until(lambda: app.record.latest is not None and app.record.latest.job == "discover", "the search")
    day.keep("discovering-seen-from-calibrate")
    await day.ended()
    await day.keep_screens("discovered")
    await day.press("3")
    await turned_to(day.pilot, "stops")
    await day.press("s", "s", "space")
    day.keep("marked")
    await day.begin("3", "r")
    await day.ended()
    await day.keep_screens("out-of-date")
    for step in ("4", "5"):
        await day.begin(step)
        await day.ended()


async def accepted(day: Recorder) -> None:
    """Compensate, verify, check, test by ISO 9283, write the report."""
    await day.begin("6")
    await day.ended()
    await day.begin("6", "m")
    await day.until(lambda: day.app.record.latest is not None and day.app.record.latest.job == "verify", "verifying")
    day.keep("verifying")
    await day.ended()
    await day.begin("7", "k")
    await day.ended()
    await day.begin("7", "m")
    await day.until(lambda: day.app.record.latest is not None and day.app.record.latest.job == "iso9283", "testing")
    day.keep("testing")
    await day.ended()
    await day.keep_screens("finished", tabs=True)


def write_day(folder: Path, sizes: Sequence[tuple[int, int]]) -> list[Path]:
    """Record the day at each size; the files that were written."""
    written: list[Path] = []
    for size in sizes:
        place = folder / f"{size[0]}x{size[1]}"
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as home, chdir(home):
            shutil.copytree(PROFILES, "profiles")
            written += asyncio.run(recorded(size, place))
    return written


def main(arguments: Sequence[str]) -> int:
    """Write the day into the folder that is named."""
    named = {f"{width}x{height}": (width, height) for width, height in SIZES}
    if not arguments or set(arguments[1:]) - named.keys():
        sys.stderr.write(f"python -m tests.interfaces.tui.recorded_day FOLDER [{' | '.join(named)} ...]\n")
        return 2
    written = write_day(Path(arguments[0]).resolve(), [named[size] for size in arguments[1:] or named])
    sys.stdout.write(f"{len(written)} texts below {arguments[0]}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
