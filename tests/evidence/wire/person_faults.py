"""What a person meets beside the keys: a dead tracker, a lost dashboard, a dead cell, stops from elsewhere.

Each function causes one thing at an emulated cell and returns a time [ms] or a number, infinite for what never came.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from cellapp.cell.run import RunFile
from tests.evidence.wire.polling import comes_about
from tests.evidence.wire.pseudo_terminal import PseudoTerminal
from tests.evidence.wire.storm_cell import StormCell, cellapp_process
from tests.evidence.wire.tcp_relay import Way
from tests.evidence.wire.terminal_presses import COLUMNS, PLACES, ROWS, RUN, PressBench

_WITHIN_S = 30.0
_STOPS_WITHIN_S = 10.0
_WATCHED_S = 1.0
_UNDER_WAY_S = 0.05
"""A motion that was commanded before a link is lost may begin this much later."""
_IS_NOT_RUNNING = re.compile("NO DATA|STOPPED|NOT SEEN AT REST")
_CALM = PLACES["Collect"]


def dead_tracker(bench: PressBench, way: Way) -> float:
    """Time until both controllers are told to stop after the tracker is gone or silent [ms]."""
    bench.go_while_moving(_CALM, f"tracker {way}")
    struck_s = time.monotonic()
    bench.tracker.set(way)
    stopped_ms = bench.cell.stop_ms(struck_s)
    bench.tracker.set("open")
    bench.cell.wait_at_rest(_STOPS_WITHIN_S)
    bench.resume(_CALM, f"tracker {way}")
    return stopped_ms


def lost_dashboard(bench: PressBench, how: Literal["refuse", "silent"], name: str) -> tuple[float, float]:
    """Let the dashboard of an arm refuse all connections, or answer nothing, while all arms move.

    Returns the time to the stop at the other arms [ms], and the number of motions that began beside the doubt.
    """
    bench.go_while_moving(_CALM, f"dashboard {how}")
    struck_s = time.monotonic()
    bench.cell.control(name, "fault", "dashboard", how)
    stopped_ms = bench.cell.stop_ms(struck_s, [other for other in bench.cell.arms if other != name])
    bench.cell.wait_at_rest(_STOPS_WITHIN_S)
    time.sleep(_WATCHED_S)
    began = bench.cell.began(struck_s + _UNDER_WAY_S)
    bench.cell.repair()
    bench.resume(_CALM, f"dashboard {how}")
    return stopped_ms, float(began)


def dead_cell(bench: PressBench) -> float:
    """Time until the screen of Collect no longer says that the job runs, after the whole cell is gone [ms]. Ends it."""
    bench.go_while_moving(_CALM, "dead cell")
    bench.terminal.forget()
    struck_s = time.monotonic()
    os.kill(bench.cell.pid, signal.SIGKILL)
    said_s = bench.terminal.until(lambda text: bool(_IS_NOT_RUNNING.search(text)), "that nothing runs", _WITHIN_S)
    return (said_s - struck_s) * 1e3


def stop_command(bench: PressBench) -> tuple[float, float]:
    """Stop with ``cellapp stop`` from another process while all arms move.

    Returns the time from its start to the stop at all controllers, and its processor time [ms].
    """
    bench.go_while_moving(_CALM, "cellapp stop")
    began_s = time.monotonic()
    process = cellapp_process(bench.folder, "stop", str(RUN))
    stopped_ms = bench.cell.stop_ms(began_s)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    bench.cell.wait_at_rest(_STOPS_WITHIN_S)
    bench.resume(_CALM, "cellapp stop")
    return stopped_ms, (used.ru_utime + used.ru_stime) * 1e3


def watched_escapes(bench: PressBench, n: int) -> list[float]:
    """Times from Escape in an application that watches the job to the stop at all controllers [ms], ``n`` times."""
    other = PseudoTerminal([sys.executable, "-m", "cellapp"], bench.folder, COLUMNS, ROWS)
    found = []
    try:
        other.until(lambda text: "a goes on with the last run" in text, "the line of the last run", _WITHIN_S)
        other.quiet(0.3)
        other.send("a")
        other.until(lambda text: "WATCHED" in text, "the badge", _WITHIN_S)
        other.quiet(0.3)
        for _ in range(n):
            bench.go_while_moving(_CALM, "watched")
            sent_s = other.send(b"\x1b")
            found.append(bench.cell.stop_ms(sent_s))
            bench.cell.wait_at_rest(_STOPS_WITHIN_S)
            bench.resume(_CALM, "watched")
    finally:
        other.close()
    return found


# -- leaving -----------------------------------------------------------------------------------------------------------


def _quit(terminal: PseudoTerminal) -> float:
    terminal.forget()
    terminal.send("\x11")
    terminal.until(lambda text: "Quit?" in text, "the question", _WITHIN_S)
    terminal.quiet(0.15)
    return terminal.send("y")


@dataclass(frozen=True)
class Leave:
    """A way to leave the application; ``recorded`` is what the run then says."""

    act: Callable[[PseudoTerminal], float]
    recorded: str


LEAVES: Mapping[str, Leave] = {
    "Ctrl-Q and yes": Leave(_quit, "a person left the application"),
    "terminal closed": Leave(PseudoTerminal.hang_up, "the terminal was closed"),
}


def left(bench: PressBench, leave: Leave) -> tuple[float, float]:
    """Leave while all arms move. Ends the application.

    Returns the time to the stop at all controllers [ms], and 1 if the run says something else than what was done,
    otherwise 0.
    """
    bench.go_while_moving(_CALM, leave.recorded)
    left_s = leave.act(bench.terminal)
    stopped_ms = bench.cell.stop_ms(left_s)
    bench.terminal.process.wait(_WITHIN_S)
    with RunFile.open(bench.folder / RUN) as run:
        requests = run.sessions()[-1].requests
    said = requests[-1].reason if requests else ""
    return stopped_ms, float(leave.recorded not in said)


# -- connecting --------------------------------------------------------------------------------------------------------


def interrupted_connecting(cell: StormCell, folder: Path, random: np.random.Generator) -> tuple[float, float]:
    """Press Ctrl-C in the terminal of ``cellapp collect`` at a random moment while it connects the arms.

    Returns the time from there to the end of the process [ms], and the number of arms that started afterwards.
    """
    moves = {name: one["moves"] for name, one in cell.status().items()}
    terminal = PseudoTerminal([sys.executable, "-m", "cellapp", "collect", str(RUN)], folder, COLUMNS, ROWS)
    try:
        comes_about(
            lambda: any(any(one["connections"].values()) for one in cell.status().values()),
            time.monotonic() + _WITHIN_S,
        )
        time.sleep(random.uniform(0.0, 0.4))
        pressed_s = time.monotonic()
        terminal.send(b"\x03")
        try:
            terminal.process.wait(_WITHIN_S)
        except subprocess.TimeoutExpired:
            return float("inf"), 0.0
        ended_ms = (time.monotonic() - pressed_s) * 1e3
        comes_about(lambda: _runs(cell, moves) > 0, time.monotonic() + _WATCHED_S)
        return ended_ms, float(_runs(cell, moves))
    finally:
        terminal.close()


def _runs(cell: StormCell, moves: Mapping[str, int]) -> int:
    """Number of arms whose controller runs a program, or which have begun a motion."""
    return sum(one["runtime_state"] != "STOPPED" or one["moves"] > moves[name] for name, one in cell.status().items())
