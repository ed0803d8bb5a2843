"""A person at a real pseudo terminal, in front of an emulated cell whose arms all move: from the act, a key or a fault,
to the stop command at the last controller. Presses are spread over screens, a text field, the palette, a question and
the handbook. Emulated controllers and the thread that presses run before all other programs."""

from __future__ import annotations

import argparse
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cellapp.ground.errors import HardwareError
from drivers.priority import in_real_time
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table
from tests.evidence.wire.person_faults import (
    LEAVES,
    Leave,
    dead_cell,
    dead_tracker,
    interrupted_connecting,
    left,
    lost_dashboard,
    stop_command,
    watched_escapes,
)
from tests.evidence.wire.terminal_presses import KEYS, PLACES, PressBench, press_bench

TITLE = "From a key to the brakes"
ALONE = True
PROFILE = ROOT / "profiles" / "twin-rtde.yaml"
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
OPTIONS = {"presses": 50, "repeats": 10, "busy": 0}
"""``presses``: of each key; ``repeats``: of everything else; ``busy``: processes that compute beside it."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"person": {key: getattr(asked, key) for key in OPTIONS}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Press each key ``presses`` times over all places, and do everything else ``repeats`` times, while arms move.

    A part in which the arms do not move, rest or resume is not measured, and the result says so.
    """
    trial = _Trial(case["presses"], case["repeats"], case["busy"] > 0)
    rows: list[dict[str, Any]] = []
    not_measured = []
    with busy(case["busy"]), in_real_time():  # else this process's own delays were in the figures
        for part in (trial.pressed, trial.lost, trial.from_elsewhere, trial.left, trial.connecting):
            try:
                rows += part()
            except HardwareError as error:
                what = str(error).partition("\n")[0]  # the rest is what was drawn last
                not_measured.append(f"{part.__name__.replace('_', ' ')}: {what}")
    return {"rows": rows, "not_measured": not_measured}


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


def _row(
    what: str, values: Sequence[float], worst_bar: float, median_bar: float = math.inf, unit: str = "ms"
) -> dict[str, Any]:
    """One row of the table, of at least one value; infinite is what never came."""
    median, worst = float(np.median(values)), float(max(values))
    shown = [f"{value:.0f} {unit}".strip() if math.isfinite(value) else "never" for value in (median, worst)]
    cells = [what, str(len(values)), *shown, f"{worst_bar:g} {unit}".strip()]
    return {"cells": cells, "kept": worst <= worst_bar and median <= median_bar}


@dataclass(frozen=True)
class _Trial:
    """The parts of the trial, each with an application of its own."""

    presses: int
    repeats: int
    is_busy: bool

    @property
    def _worst_ms(self) -> float:
        return WORST_BUSY_MS if self.is_busy else WORST_MS

    def _each(self, measure: Callable[[], T]) -> list[T]:
        return [measure() for _ in range(self.repeats)]

    def pressed(self) -> list[dict[str, Any]]:
        """Each key at each place, and what begins before a resume."""
        places, keys = tuple(PLACES), tuple(KEYS)
        stopped_ms: dict[str, list[float]] = {key: [] for key in keys}
        began = []
        with _collecting() as bench:
            for number in range(self.presses):
                for shift, key in enumerate(keys):
                    stop_ms, motions = bench.press(key, places[(number + shift) % len(places)])
                    stopped_ms[key].append(stop_ms)
                    began.append(float(motions))
        rows = [_row(key, its, self._worst_ms, MEDIAN_MS) for key, its in stopped_ms.items()]
        return [*rows, _row("motions before resume", began, 0.0, unit="")]

    def lost(self) -> list[dict[str, Any]]:
        """The tracker, a dashboard, and at last the whole cell."""
        with _collecting() as bench:
            gone = self._each(lambda: dead_tracker(bench, "closed"))
            silent = self._each(lambda: dead_tracker(bench, "silent"))
            name = bench.cell.arms[-1]
            refused = self._each(lambda: lost_dashboard(bench, "refuse", name))
            mute = self._each(lambda: lost_dashboard(bench, "silent", name))
        return [
            _row("tracker closed", gone, CLOSED_MS),
            _row("tracker silent", silent, SILENT_MS),
            _row("dashboard closed: other arm", [stop_ms for stop_ms, _ in refused], DASHBOARD_MS),
            _row("dashboard silent: other arm", [stop_ms for stop_ms, _ in mute], DASHBOARD_MS),
            _row("motions beside a lost dashboard", [began for _, began in (*refused, *mute)], 0.0, unit=""),
            _row("whole cell dead: screen", self._each(_dead_cell), DEAD_MS),
        ]

    def from_elsewhere(self) -> list[dict[str, Any]]:
        """``cellapp stop``, and Escape in an application that watches the job."""
        with _collecting() as bench:
            stopped_ms, processor_ms = zip(*self._each(lambda: stop_command(bench)), strict=True)
            watched = watched_escapes(bench, self.repeats)
        most_ms = COMMAND_BUSY_MS if self.is_busy else COMMAND_MS
        return [
            _row("cellapp stop", stopped_ms, most_ms),
            _row("cellapp stop: processor time", processor_ms, PROCESSOR_MS),
            _row("Escape, watched", watched, self._worst_ms + WATCHED_MS),
        ]

    def left(self) -> list[dict[str, Any]]:
        """Each way to leave, and what the run says of it."""
        found = {how: self._each(partial(_left, leave)) for how, leave in LEAVES.items()}
        rows = [_row(how, [stop_ms for stop_ms, _ in its], self._worst_ms) for how, its in found.items()]
        wrongly = [wrong for its in found.values() for _, wrong in its]
        return [*rows, _row("leaving not recorded as that", wrongly, 0.0, unit="")]

    def connecting(self) -> list[dict[str, Any]]:
        """Ctrl-C in the terminal of a batch command while it connects the arms."""
        random = np.random.default_rng(1)
        with _bench() as bench:
            bench.terminal.close()
            connecting = partial(interrupted_connecting, bench.cell, bench.folder, random)
            ended_ms, started = zip(*self._each(connecting), strict=True)
        return [
            _row("Ctrl-C while connecting: end", ended_ms, CONNECTING_MS),
            _row("programs run afterwards", started, 0.0, unit=""),
        ]


def _dead_cell() -> float:
    with _collecting() as bench:
        return dead_cell(bench)


def _left(leave: Leave) -> tuple[float, float]:
    with _collecting() as bench:
        return left(bench, leave)


@contextmanager
def _bench() -> Iterator[PressBench]:
    """The application in a folder of its own that has this profile only."""
    with tempfile.TemporaryDirectory(prefix="cellapp-person-") as folder:
        profiles = Path(folder) / "profiles"
        profiles.mkdir()
        shutil.copy(PROFILE, profiles)
        for part in PROFILE.parent.iterdir():
            if part.is_dir():
                shutil.copytree(part, profiles / part.name)
        with press_bench(profiles / PROFILE.name, Path(folder)) as bench:
            yield bench


@contextmanager
def _collecting() -> Iterator[PressBench]:
    """As ``_bench``, with the job begun."""
    with _bench() as bench:
        bench.begin()
        yield bench


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows, not_measured = results[0]["rows"], results[0]["not_measured"]
    missed = len(not_measured) + sum(not row["kept"] for row in rows)
    title, columns = f"Beside {asked.busy} busy processes", ["from the act", "n", "median", "worst", "limit"]
    limit = Limit("rows that missed their limit, or were not measured", missed, 0)
    return Evidence(tables=[Table(title, columns, [row["cells"] for row in rows])], limits=[limit], said=not_measured)
