"""What a person meets at an emulated cell: presses at a real pseudo terminal, faults, stops from elsewhere, leaving."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np

from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import UNATTENDED, JobToken
from drivers.priority import in_real_time
from tests.evidence.wire.person_faults import (
    LEAVES,
    Leave,
    Left,
    dead_cell,
    dead_tracker,
    interrupted_connecting,
    left,
    lost_dashboard,
    stop_command,
    watched_escapes,
)
from tests.evidence.wire.person_results import PersonResult, PersonRow
from tests.evidence.wire.terminal_presses import KEYS, PLACES, Press, PressBench, press_bench

MEDIAN_MS, WORST_MS, WORST_BUSY_MS = 50.0, 100.0, 200.0
"""Bars from the byte in the pseudo terminal to the stop command at the last controller."""
CLOSED_MS, SILENT_MS, DASHBOARD_MS = 100.0, 500.0, 1000.0
"""Bars from the loss of a tracker, closed or silent, and of a dashboard to the stop command at the last controller."""
DEAD_MS, CONNECTING_MS = 1500.0, 1000.0
"""Bars until the screen shows a dead cell, and until a process ends that was stopped while it connected."""
COMMAND_MS, COMMAND_BUSY_MS, PROCESSOR_MS = 300.0, 1000.0, 100.0
"""Bars of ``cellapp stop`` until the last controller has its command, and of its processor time."""
WATCHED_MS = 50.0
"""What Escape may take longer in an application that watches the job."""
T = TypeVar("T")
BEFORE: Mapping[str, str] = {
    "Escape": "655",
    "Ctrl-C": "never",
    "Escape (kitty)": "16",
    "began": "some",
    "tracker": "2200",
    "dashboard": "1500",
    "beside": "some",
    "dead": "36000",
    "recorded": "all",
    "command": "13000",
    "processor": "600",
    "watched": "never",
    "connecting": "9000",
    "uploaded": "one",
}
"""What was met on 2026-11-23, before: the worst time [ms], or how often."""


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Processes that compute without a pause."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def person_trial(
    profile_path: Path, presses: int = 50, repeats: int = 10, beside: int = 0, job: JobToken = UNATTENDED
) -> PersonResult:
    """Press each key ``presses`` times over all places, and do everything else ``repeats`` times, while arms move.

    ``beside`` processes compute meanwhile. A part in which the arms do not move, rest or resume is not measured, and
    the result says so.
    """
    trial = _Trial(profile_path, presses, repeats, beside > 0, job)
    rows: list[PersonRow] = []
    not_measured = []
    with busy(beside), in_real_time():  # else this process's own delays were in the figures
        for part in (trial.pressed, trial.lost, trial.from_elsewhere, trial.left, trial.connecting):
            try:
                rows += part()
            except HardwareError as error:
                what = str(error).partition("\n")[0]  # the rest is what was drawn last
                not_measured.append(f"{part.__name__.replace('_', ' ')}: {what}")
    return PersonResult(busy=beside, rows=tuple(rows), not_measured=tuple(not_measured))


class _Trial:
    """The parts of the trial, each with an application of its own."""

    def __init__(self, profile_path: Path, presses: int, repeats: int, is_busy: bool, job: JobToken) -> None:
        self._profile_path, self._presses, self._repeats = profile_path, presses, repeats
        self._job = job
        self._is_busy = is_busy
        self._worst_ms = WORST_BUSY_MS if is_busy else WORST_MS

    def _each(self, what: str, n: int, measure: Callable[[], T]) -> list[T]:
        found = []
        for number in range(n):
            self._job.check()
            self._job.tell(what, number, n)
            found.append(measure())
        return found

    def pressed(self) -> list[PersonRow]:
        """Each key at each place, and what begins before a resume."""
        places, keys = tuple(PLACES), tuple(KEYS)
        found: list[Press] = []
        with _collecting(self._profile_path) as bench:

            def press() -> None:
                number, shift = divmod(len(found), len(keys))
                found.append(bench.press(keys[shift], places[(number + shift) % len(places)]))

            self._each("presses", self._presses * len(keys), press)
        rows = [
            PersonRow.of(
                key, BEFORE.get(key, ""),
                [one.worst_ms for one in found if one.key == key], self._worst_ms, MEDIAN_MS,
            )
            for key in keys
        ]  # fmt: skip
        began = [float(one.began) for one in found]
        return [*rows, PersonRow.of("motions before resume", BEFORE["began"], began, 0.0, unit="")]

    def lost(self) -> list[PersonRow]:
        """The tracker, a dashboard, and at last the whole cell."""
        n = self._repeats
        with _collecting(self._profile_path) as bench:
            gone = self._each("tracker closed", n, lambda: dead_tracker(bench, "closed"))
            silent = self._each("tracker silent", n, lambda: dead_tracker(bench, "silent"))
            name = bench.cell.arms[-1]
            refused = self._each("dashboard refused", n, lambda: lost_dashboard(bench, "refuse", name))
            mute = self._each("dashboard silent", n, lambda: lost_dashboard(bench, "silent", name))
        dead = self._each("dead cell", n, self._dead_cell)
        began = [one.began for one in (*refused, *mute)]
        return [
            PersonRow.of("tracker closed", BEFORE["tracker"], gone, CLOSED_MS),
            PersonRow.of("tracker silent", BEFORE["tracker"], silent, SILENT_MS),
            PersonRow.of(
                "dashboard closed: other arm", BEFORE["dashboard"],
                [one.stopped_ms for one in refused], DASHBOARD_MS,
            ),
            PersonRow.of(
                "dashboard silent: other arm", BEFORE["dashboard"],
                [one.stopped_ms for one in mute], DASHBOARD_MS,
            ),
            PersonRow.of("motions beside a lost dashboard", BEFORE["beside"], began, 0.0, unit=""),
            PersonRow.of("whole cell dead: screen", BEFORE["dead"], dead, DEAD_MS),
        ]  # fmt: skip

    def _dead_cell(self) -> float:
        with _collecting(self._profile_path) as bench:
            return dead_cell(bench)

    def from_elsewhere(self) -> list[PersonRow]:
        """``cellapp stop``, and Escape in an application that watches the job."""
        with _collecting(self._profile_path) as bench:
            commands = self._each("cellapp stop", self._repeats, lambda: stop_command(bench))
            watched = watched_escapes(bench, self._repeats)
        return [
            PersonRow.of(
                "cellapp stop", BEFORE["command"], [one.stopped_ms for one in commands],
                COMMAND_BUSY_MS if self._is_busy else COMMAND_MS,
            ),
            PersonRow.of(
                "cellapp stop: processor time", BEFORE["processor"], [one.processor_ms for one in commands],
                PROCESSOR_MS,
            ),
            PersonRow.of(
                "Escape, watched", BEFORE["watched"], watched, self._worst_ms + WATCHED_MS,
            ),
        ]  # fmt: skip

    def left(self) -> list[PersonRow]:
        """Each way to leave, and what the run says of it."""
        rows, wrongly = [], []
        for how, leave in LEAVES.items():

            def measure(leave: Leave = leave) -> Left:
                with _collecting(self._profile_path) as bench:
                    return left(bench, leave)

            found = self._each(how, self._repeats, measure)
            stopped_ms = [one.stopped_ms for one in found]
            rows.append(PersonRow.of(how, "", stopped_ms, self._worst_ms))
            wrongly += [one.wrongly_recorded for one in found]
        return [*rows, PersonRow.of("leaving not recorded as that", BEFORE["recorded"], wrongly, 0.0, unit="")]

    def connecting(self) -> list[PersonRow]:
        """Ctrl-C in the terminal of a batch command while it connects the arms."""
        random = np.random.default_rng(1)
        with _bench(self._profile_path) as bench:
            bench.terminal.close()
            found = self._each(
                "connecting", self._repeats, lambda: interrupted_connecting(bench.cell, bench.folder, random)
            )
        started = [one.started for one in found]
        return [
            PersonRow.of(
                "Ctrl-C while connecting: end", BEFORE["connecting"],
                [one.ended_ms for one in found], CONNECTING_MS,
            ),
            PersonRow.of("programs run afterwards", BEFORE["uploaded"], started, 0.0, unit=""),
        ]  # fmt: skip


@contextmanager
def _bench(profile_path: Path) -> Iterator[PressBench]:
    """The application in a folder of its own that has this profile only."""
    with tempfile.TemporaryDirectory(prefix="cellapp-person-") as folder:
        profiles = Path(folder) / "profiles"
        profiles.mkdir()
        shutil.copy(profile_path, profiles)
        for part in profile_path.parent.iterdir():
            if part.is_dir():
                shutil.copytree(part, profiles / part.name)
        with press_bench(profiles / profile_path.name, Path(folder)) as bench:
            yield bench


@contextmanager
def _collecting(profile_path: Path) -> Iterator[PressBench]:
    """As ``_bench``, with the job begun."""
    with _bench(profile_path) as bench:
        bench.begin()
        yield bench
