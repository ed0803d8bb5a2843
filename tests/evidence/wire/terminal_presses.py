"""Presses at a real pseudo terminal: from the byte to the stop command at every emulated controller.

The terminal application collects in an emulated cell in real time. A key is pressed while all arms move; the emulated
controllers say when the stop command came. What the parser, the screen and the job do meanwhile is in the figure.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from drivers.trackers.bridge_settings import BridgeSettings
from tests.evidence.wire.polling import comes_about
from tests.evidence.wire.pseudo_terminal import PseudoTerminal
from tests.evidence.wire.storm_cell import StormCell, emulated_cell
from tests.evidence.wire.tcp_relay import TcpRelay

COLUMNS, ROWS = 120, 40
RUN = Path("logs") / "presses"
"""The folder of the run, in the folder of the application."""
KEYS: Mapping[str, bytes] = {
    "Escape": b"\x1b",
    "Ctrl-C": b"\x03",
    "Escape (kitty)": b"\x1b[27u",
    "Ctrl-C (kitty)": b"\x1b[99;5u",
    "mouse": f"\x1b[<0;{COLUMNS - 4};1M".encode(),
}
"""What terminals send for a press; the mouse presses STOP in the upper right corner."""
_RELEASED = f"\x1b[<0;{COLUMNS - 4};1m"
_F10, _CTRL_P, _BESIDE = "\x1b[21~", "\x10", f"\x1b[<0;2;{ROWS - 2}M\x1b[<0;2;{ROWS - 2}m"


@dataclass(frozen=True)
class Place:
    """Where a key is pressed: the keys that lead there from Collect, what is drawn then, the keys that lead back."""

    keys: str
    words: str
    back: str


PLACES: Mapping[str, Place] = {
    "Collect": Place("", "", ""),
    "another screen": Place("1", "asks the doctor", "3"),
    "the palette": Place(_CTRL_P, "Search for commands", _BESIDE),
    "the quit question": Place("q", "Quit?", _F10),
    "the handbook": Place("h", "Up and down choose", _F10),
}
_TRIES = 5
_MOVES_WITHIN_S = 8.0
"""Longer than connecting, than a measurement at a stop, and than a way between two stops."""
_BEGINS_WITHIN_S = 30.0
_RESTS_WITHIN_S = 5.0
_QUIET_S = 0.15
"""Screens are drawn ten times a second while a job runs."""
_WATCHED_S = 0.3
"""No motion may begin for this long after the arms came to rest, until resume is pressed."""
_RESUMED_WITHIN_S = 4.0
_RESUMED_AT_LAST_S = 60.0
"""On a busy computer, which may stop the arms again: a driver's process that is not heard of for 0.3 s is a doubt."""
_TOLD = 4
"""Requests of the run that a complaint names."""
_LAST = 2000
"""Characters of what was drawn last that a complaint shows."""


class PressBench:
    """The application that collects in a pseudo terminal, and its emulated cell.

    ``tracker`` is the way to the tracker, ``folder`` the folder of the application. ``random`` draws how long after the
    begin of a motion a key is pressed.
    """

    def __init__(
        self, terminal: PseudoTerminal, cell: StormCell, tracker: TcpRelay, folder: Path, random: np.random.Generator
    ) -> None:
        self.terminal, self.cell, self.tracker, self.folder, self._random = terminal, cell, tracker, folder, random

    def begin(self) -> None:
        """Open the first run of the folder and begin to collect."""
        terminal = self.terminal
        for keys, words in (("", "ULATED"), ("8", "not begun"), ("\r", "Next (n): collect"), ("3", "READY")):
            terminal.send(keys)
            terminal.until(partial(_contains, words), words)
            terminal.quiet(2.0 * _QUIET_S)
        terminal.forget()
        terminal.send("b")
        terminal.until(partial(_contains, "Begin to collect?"), "the question")
        terminal.quiet(_QUIET_S)
        terminal.send("b")
        comes_about(partial(self.cell.began, 0.0), time.monotonic() + _BEGINS_WITHIN_S)

    def _go(self, place: Place) -> None:
        """Go from Collect to a place."""
        if place.keys:
            self.terminal.forget()
            self.terminal.send(place.keys)
            self.terminal.until(partial(_contains, place.words), f"what '{place.words}' is drawn on")

    def moves(self) -> bool:
        """Wait until all arms move; return whether that came about."""
        return comes_about(
            lambda: all(one["moving"] for one in self.cell.status().values()), time.monotonic() + _MOVES_WITHIN_S
        )

    def go_while_moving(self, place: Place, what: str) -> None:
        """Go to a place and wait until all arms move there; a busy computer may stop them meanwhile: then resume."""
        for _ in range(_TRIES):
            self._go(place)
            if self.moves():
                time.sleep(self._random.uniform(0.0, 0.3))  # another part of motion and drawing each time
                if self.moves():
                    return
            self.resume(place, what)
        raise HardwareError(f"{what}: the arms do not move\n{self.terminal.text()[-_LAST:]}")

    def press(self, key: str, place: str) -> tuple[float, int]:
        """Press a key at a place while all arms move, watch the controllers, and resume.

        Returns the time from the byte to the stop command at the last controller [ms], infinite if one had none, and
        the number of motions that began between the stop commands and the resume.

        Raises
        ------
        HardwareError
            If the arms do not move before, do not rest after the stop, or do not move again after resume.
        """
        self.go_while_moving(PLACES[place], f"{key}, {place}")
        sent_s = self.terminal.send(KEYS[key])
        stop_ms = self.cell.stop_ms(sent_s)
        if key == "mouse":
            self.terminal.send(_RELEASED)
        if not self.cell.wait_at_rest(_RESTS_WITHIN_S):
            raise HardwareError(f"{key}, {place}: no stop came, or the arms do not rest: {stop_ms:g} ms")
        time.sleep(_WATCHED_S)
        began = self.cell.began(sent_s + stop_ms / 1e3)
        self.resume(PLACES[place], f"{key}, {place}")
        return stop_ms, began

    def resume(self, place: Place, what: str) -> None:
        """Go back to Collect and resume. Raises ``HardwareError`` if no motion begins."""
        since_s = time.monotonic()
        self.terminal.send(place.back)
        end_s = since_s + _RESUMED_AT_LAST_S
        while time.monotonic() < end_s:
            self.terminal.quiet(_QUIET_S, times=2.0)
            self.terminal.send("c")
            if comes_about(partial(self.cell.began, since_s), time.monotonic() + _RESUMED_WITHIN_S):
                return
        raise HardwareError(
            f"{what}: no motion begins after resume; the run says: {self._last_requests()}\n"
            f"{self.terminal.text()[-_LAST:]}"
        )

    def _last_requests(self) -> str:
        """What the run has recorded last, and so why nothing moves."""
        with RunFile.open(self.folder / RUN) as run:
            sessions = run.sessions()
        said = [f"{one.kind}: {one.reason}" for session in sessions for one in session.requests]
        return "; ".join(said[-_TOLD:]) or "nothing"


def _contains(words: str, text: str) -> bool:
    return words in text


@contextmanager
def press_bench(profile_path: Path, folder: Path, seed: int = 1) -> Iterator[PressBench]:
    """Plan a run in ``folder/logs``, emulate its cell in real time, and open the application in ``folder``.

    ``profile_path`` is a profile in ``folder/profiles`` whose arms and tracker are emulated; the tracker's address is
    changed in it. Raises ``InputError`` for another one, ``HardwareError`` if what must be drawn never is.
    """
    profile = load_profile(profile_path)
    with (
        emulated_cell(profile, 1.0, watch_clearance=False) as cell,
        TcpRelay((cell.bridge.host, cell.bridge.port)) as tracker,
    ):
        _reach_through(tracker, profile, profile_path)
        new_planned_run(load_profile(profile_path), folder / RUN).close()
        terminal = PseudoTerminal([sys.executable, "-m", "cellapp"], folder, COLUMNS, ROWS)
        try:
            yield PressBench(terminal, cell, tracker, folder, np.random.default_rng(seed))
        except TimeoutError as error:
            raise HardwareError(f"the terminal application: {error}") from error
        finally:
            terminal.close()


def _reach_through(relay: TcpRelay, profile: Profile, profile_path: Path) -> None:
    """Write the relay's address into the file of the profile: a run remembers from which profile it was planned."""
    driver = profile.tracker.driver
    text = profile_path.read_text("utf-8")
    if not isinstance(driver, BridgeSettings) or driver.url not in text:
        raise InputError(f"{profile_path.name}: tracker.driver: presses need kind 'bridge' with a url on this computer")
    profile_path.write_text(text.replace(driver.url, f"socket://{relay.host}:{relay.port}"), "utf-8")
