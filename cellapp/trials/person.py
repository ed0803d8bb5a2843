"""What a person meets at an emulated cell: presses at a real pseudo terminal, just after resume, and leaving."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.trials.person_results import PersonResult, PersonRow
from cellapp.trials.pseudo_terminal import PseudoTerminal
from cellapp.trials.terminal_presses import KEYS, PLACES, Press, PressBench, press_bench

MEDIAN_MS, WORST_MS, WORST_BUSY_MS = 50.0, 100.0, 200.0
"""Bars from the byte in the pseudo terminal to the stop command at the last controller."""
BEFORE: Mapping[str, str] = {
    "Escape": "114 to 655 ms, median 168",
    "Ctrl-C": "no stop",
    "Escape (kitty)": "12 to 16 ms",
    "began": "up to 0.37 s after Escape",
}
_WAIT_S = 30.0


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


def _quit(terminal: PseudoTerminal) -> float:
    terminal.forget()
    terminal.send("\x11")
    terminal.until(lambda text: "Quit?" in text, "the question", _WAIT_S)
    terminal.quiet(0.15)
    return terminal.send("y")


def _close(terminal: PseudoTerminal) -> float:
    left_s = time.monotonic()
    terminal.hang_up()
    return left_s


LEAVES: Mapping[str, Callable[[PseudoTerminal], float]] = {"Ctrl-Q and yes": _quit, "terminal closed": _close}


def person_trial(
    profile_path: Path,
    presses: int = 50,
    repeats: int = 10,
    beside: int = 0,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> PersonResult:
    """Press each key ``presses`` times over all places, and leave ``repeats`` times in each way, while arms move.

    ``beside`` processes compute meanwhile. Raises ``HardwareError`` if the arms do not move, rest or resume.
    """
    cancel = cancel or CancelToken()
    worst_ms = WORST_BUSY_MS if beside else WORST_MS
    with busy(beside):
        pressed = _presses(profile_path, presses, listener, cancel)
        rows = [
            PersonRow.of(
                f"{key}: to the stop command", BEFORE.get(key, ""),
                [one.worst_ms for one in pressed if one.key == key], worst_ms, MEDIAN_MS,
            )
            for key in KEYS
        ]  # fmt: skip
        began = [float(one.began) for one in pressed]
        rows.append(PersonRow.of("motions begun between stop and resume", BEFORE["began"], began, 0.0, unit=""))
        for how, leave in LEAVES.items():
            took_ms = []
            for number in range(repeats):
                cancel.check()
                listener(Progress(how, number, repeats))
                took_ms.append(_leave(profile_path, leave))
            rows.append(PersonRow.of(f"{how}: to the stop command", "", took_ms, worst_ms))
    return PersonResult(busy=beside, rows=tuple(rows))


def _presses(profile_path: Path, n: int, listener: Listener, cancel: CancelToken) -> list[Press]:
    places, found = tuple(PLACES), []
    with _bench(profile_path) as bench:
        for number in range(n):
            listener(Progress("presses", number, n))
            for shift, key in enumerate(KEYS):
                cancel.check()
                found.append(bench.press(key, places[(number + shift) % len(places)]))
    return found


def _leave(profile_path: Path, leave: Callable[[PseudoTerminal], float]) -> float:
    """Time from leaving to the stop command at the last controller [ms]."""
    with _bench(profile_path) as bench:
        bench.moves()
        left_s = leave(bench.terminal)
        return max(bench.stop_ms(name, left_s) for name in bench.cell.arms)


@contextmanager
def _bench(profile_path: Path) -> Iterator[PressBench]:
    """The application in a folder of its own that has this profile only, collecting."""
    with tempfile.TemporaryDirectory(prefix="cellapp-person-") as folder:
        profiles = Path(folder) / "profiles"
        profiles.mkdir()
        shutil.copy(profile_path, profiles)
        for part in profile_path.parent.iterdir():
            if part.is_dir():
                shutil.copytree(part, profiles / part.name)
        with press_bench(profiles / profile_path.name, Path(folder)) as bench:
            bench.begin()
            yield bench
