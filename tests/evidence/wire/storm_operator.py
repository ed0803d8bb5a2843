"""The person of the program storm: starts the collecting program, repairs the cell after a fault, and resumes."""

from __future__ import annotations

import math
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from cellapp.cell.run import RunFile
from cellapp.ground.errors import HardwareError, InputError
from tests.evidence.wire.storm_cell import StormCell, cellapp_process
from tests.evidence.wire.storm_faults import FAULTS, LONGEST_DELAY_S, Event, Scene

COMMANDED_WITHIN_S = 0.1
"""Limit: from the first stop that a controller received to that of every other."""
_POLL_S = 0.02
_READ_EVERY_S = 0.2
"""Time between two looks at the run file."""
_PROGRESS_WITHIN_S = 90.0
"""A program that stores nothing for so long without a fault hangs."""
_REST_WITHIN_S = 5.0
"""From the end of the program to arms at rest: the watchdog, and braking."""
_MOST_FAILURES = 5
"""Sessions in a row that end with an error although no fault was caused."""
_DONE, _UNFINISHED = (0, 1), (3, 4, -signal.SIGINT, -signal.SIGTERM, -signal.SIGKILL)
"""Exit codes; 1: done, but more readings are missing than the profile tolerates."""

Stored = dict[tuple[int, str], tuple[float, ...]]
"""(stop, arm) -> joint positions, point and time of a reading."""


@dataclass
class StormLog:
    """What the person saw.

    Attributes
    ----------
    seen : dict
        Readings that were seen as stored at any time.
    struck, exit_codes : Counter
        Faults by kind, and how sessions ended.
    latest_start_s : float
        Longest time from the first stop that a controller received to the start of a motion of another arm, which had
        been commanded before and was braked then [s].
    """

    seen: Stored = field(default_factory=dict)
    struck: Counter[str] = field(default_factory=Counter)
    exit_codes: Counter[int] = field(default_factory=Counter)
    sessions: int = 0
    motions_after_a_stop: int = 0
    latest_start_s: float = 0.0
    complaints: list[str] = field(default_factory=list)


def stored(folder: Path) -> Stored:
    """Return all readings of a run file, as another program reads it. Raises ``InputError``."""
    found: Stored = {}
    with RunFile.open(folder) as run:
        for name in run.arms():
            readings = run.readings(name)
            for row, stop in enumerate(readings.configuration.tolist()):
                values = (*readings.q[row].tolist(), *readings.p_M[row].tolist(), float(readings.time_s[row]))
                found[int(stop), name] = values
    return found


def lost_and_doubled(seen: Stored, found: Stored) -> tuple[int, int]:
    """Return how many readings that were seen are gone or have changed, and how many of the found are there twice."""
    lost = sum(found.get(key) != values for key, values in seen.items())
    return lost, len(found) - len({(name, values[-4:]) for (_, name), values in found.items()})


class Operator:
    """One person at the cell; ``output`` receives what the programs print."""

    def __init__(self, cell: StormCell, folder: Path, events: Sequence[Event], output: IO[bytes]) -> None:
        self._cell, self._folder, self._events, self._output = cell, folder, list(events), output
        self.log = StormLog()

    def work(self) -> StormLog:
        """Collect until the program reports the end; repair and resume after everything that ends it before.

        Raises
        ------
        HardwareError
            If the cell cannot be repaired, or sessions fail again and again without a fault.
        """
        failures = 0
        while True:
            struck = self.log.struck.total()
            code = self._session()
            self.log.exit_codes[code] += 1
            if code in _DONE:
                return self.log
            if code not in _UNFINISHED:
                self.log.complaints.append(f"session {self.log.sessions} ended with the unexpected exit code {code}")
            failures = failures + 1 if self.log.struck.total() == struck else 0
            if failures >= _MOST_FAILURES:
                raise HardwareError(f"{failures} sessions in a row ended with exit code {code} without any fault")

    # -- one session ---------------------------------------------------------------------------------------------------

    def _session(self) -> int:
        """Run the collecting program once; return its exit code, with the cell repaired and at rest."""
        self.log.sessions += 1
        words = ["collect", str(self._folder), *(["--resume"] if self.log.sessions > 1 else [])]
        program = cellapp_process(self._folder.parent, *words, stdout=self._output, stderr=self._output)
        try:
            last = self._watch(program)
        finally:
            program.kill()
            program.wait()
        self._check_rest(last)
        self._cell.repair()
        return program.returncode

    def _watch(self, program: subprocess.Popen[bytes]) -> tuple[str, float] | None:
        """Cause what is due while the program runs; return the last fault that must stop arms at work, and when."""
        last: tuple[str, float] | None = None
        began_s = ready_s = progress_s = time.monotonic()
        working = False
        read_s = 0.0
        while program.poll() is None:
            now_s = time.monotonic()
            if now_s - read_s > _READ_EVERY_S:
                read_s = now_s
                if self._look():
                    progress_s = now_s
            if not working and self._cell.began(began_s):
                working, ready_s = True, max(ready_s, now_s)
            event = self._events[0] if self._events else None
            if event is not None and self._is_due(event, working, now_s - ready_s, now_s - began_s):
                del self._events[0]
                self._strike(event, program)
                ready_s = progress_s = time.monotonic()
                if FAULTS[event.kind].stops and working:
                    last = event.kind, now_s
            elif now_s - progress_s > _PROGRESS_WITHIN_S:
                self.log.complaints.append(f"session {self.log.sessions} hangs: nothing was stored")
                break
            time.sleep(_POLL_S)
        self._look()
        return last

    def _is_due(self, event: Event, working: bool, idle_s: float, age_s: float) -> bool:
        """``idle_s``: since the last fault, or the first motion; ``age_s``: since the start of the program."""
        if self._finished() < event.at_stop:
            return False
        if working:
            return idle_s >= min(event.delay_s, LONGEST_DELAY_S)
        return event.at_start and age_s >= event.delay_s

    def _strike(self, event: Event, program: subprocess.Popen[bytes]) -> None:
        self.log.struck[event.kind] += 1
        FAULTS[event.kind].strike(Scene(self._cell, event.arm, program, self._folder))

    def _finished(self) -> int:
        return len({stop for stop, _ in self.log.seen})

    def _look(self) -> bool:
        """Read what is stored; return whether there is more than before."""
        with suppress(InputError):  # the program is just changing the file's journal: the next look counts
            found = stored(self._folder)
            lost = [key for key in self.log.seen if found.get(key) != self.log.seen[key]]
            if lost:
                self.log.complaints.append(f"stored readings are gone or have changed: {lost[:3]}")
            more = len(found) > len(self.log.seen)
            self.log.seen |= found
            return more
        return False

    # -- after a session -----------------------------------------------------------------------------------------------

    def _check_rest(self, last: tuple[str, float] | None) -> None:
        """Check that the arms rest, stay at rest, and that no motion began after the stop that ended the session.

        A motion began after the stop if the arm's own controller had received one, or if another controller had for
        longer than the bar of the cell's reaction.
        """
        if not self._cell.wait_at_rest(_REST_WITHIN_S):
            self.log.complaints.append(f"session {self.log.sessions}: an arm still moves {_REST_WITHIN_S:g} s later")
        before = self._cell.status()
        time.sleep(2.0 * _POLL_S)
        for name, status in self._cell.status().items():
            if _place(status) != _place(before[name]):
                self.log.motions_after_a_stop += 1
                self.log.complaints.append(f"session {self.log.sessions}: arm {name} moved after the session's end")
        if last is None:
            return
        kind, struck_s = last
        stops = {name: [one["received_s"] for one in self._cell.control(name, "stops", struck_s)] for name in before}
        first_s = min((received_s for times in stops.values() for received_s in times), default=math.inf)
        for name, times in stops.items():
            for began_s in self._cell.control(name, "starts", struck_s):
                if began_s > min([*times, first_s + COMMANDED_WITHIN_S]):
                    self.log.motions_after_a_stop += 1
                    self.log.complaints.append(
                        f"session {self.log.sessions}: arm {name} began to move {(began_s - first_s) * 1e3:.0f} ms"
                        f" after the stop by '{kind}'"
                    )
                elif began_s > first_s:
                    self.log.latest_start_s = max(self.log.latest_start_s, began_s - first_s)


def _place(status: Mapping[str, Any]) -> tuple[object, ...]:
    return (status["moving"], status["moves"], *status["q"])
