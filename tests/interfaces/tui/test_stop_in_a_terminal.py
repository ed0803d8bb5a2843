"""STOP as bytes of a pseudo terminal: every encoding, at every place; text and other keys stop nothing."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cellapp.interfaces.tui import ESCAPE_WAITS_MS
from cellapp.interfaces.tui.endings import LEFT
from tests.evidence.wire.polling import comes_about
from tests.evidence.wire.terminal_presses import COLUMNS, KEYS, PLACES, ROWS
from tests.interfaces.tui.terminal import ROOT, Terminal
from tests.waiting import WAIT_S

pytestmark = pytest.mark.waits

QUIET_S = 0.3
"""Three drawings of a running job; a lone Escape is known after a twentieth."""
ENCODINGS = {
    "Escape (modifyOtherKeys)": b"\x1b[27;1;27~",
    "Ctrl-C (modifyOtherKeys)": b"\x1b[27;5;99~",
    "Ctrl-C (num lock)": b"\x1b[99;133u",
    "Ctrl-C (Cyrillic)": b"\x1b[1089;5u",
    "Shift-Escape": b"\x1b[27;2u",
}
PRESSES = 5
"""A person who sees no STOP presses again."""
MOTION, PALETTE = "REAL ARMS WILL MOVE", "Search for commands"


class Held:
    """The application in a terminal, with the calls of the brakes of its job."""

    def __init__(self, terminal: Terminal, file: Path) -> None:
        self.terminal, self._file = terminal, file

    def calls(self) -> list[str]:
        """What reached the brakes."""
        return self._file.read_text("utf-8").splitlines() if self._file.exists() else []

    def press(self, keys: str | bytes, calls: int, times: int = 1) -> None:
        """Press keys, one time after the other; the brakes are called as often as is said each time, and no more."""
        due = len(self.calls())
        for _ in range(times):
            due += calls
            self.terminal.send(keys)
            assert comes_about(lambda: len(self.calls()) >= due, time.monotonic() + WAIT_S), f"{keys!r}"  # noqa: B023
        self.stays(due)

    def stays(self, calls: int, for_s: float = QUIET_S) -> None:
        """Watch for a while that the brakes are not called any more."""
        assert not comes_about(lambda: len(self.calls()) != calls, time.monotonic() + for_s), self.calls()[calls:]

    def says(self, *words: str) -> None:
        """Wait for words on the screen, wherever its lines break."""
        self.terminal.until(lambda text: all(one in " ".join(text.split()) for one in words), f"{words}", WAIT_S)

    def resume(self) -> None:
        """Resume, later than a press that could have been made before the stop."""
        self.stays(len(self.calls()))
        self.terminal.send("c")
        self.says("resumed by a person")


@contextmanager
def held(folder: Path, *options: str) -> Iterator[Held]:
    file = folder / "brakes"
    command = [sys.executable, "-m", "tests.interfaces.tui.held_app", str(file), *options]
    terminal = Terminal(command, ROOT, COLUMNS, ROWS, ESCDELAY=str(ESCAPE_WAITS_MS))
    try:
        app = Held(terminal, file)
        app.says("STOP", {"--no-job": "n goes to the next step", "--asks": MOTION}.get("".join(options), "here"))
        terminal.quiet(QUIET_S, times=2.0)
        yield app
    finally:
        terminal.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Held]:
    """An application whose job runs; each test leaves it so, on the screen Collect."""
    with held(tmp_path_factory.mktemp("held")) as app:
        app.terminal.send("3")
        app.says("STOP", "Search")
        yield app


@pytest.mark.parametrize("place", PLACES)
def test_each_press_stops_once_at_every_place(running: Held, place: str) -> None:
    there = PLACES[place]
    for key, sent in KEYS.items():
        running.terminal.send(there.keys)
        running.says(there.words)
        running.press(sent, 1, times=2)  # a second press is another one
        if key == "mouse":
            running.terminal.send(sent.lower())
        running.terminal.send(there.back)
        running.says("STOP: all arms brake")
        assert set(running.calls()) == {"stop"}
        running.resume()


@pytest.mark.parametrize("name", ENCODINGS)
def test_each_encoding_stops(running: Held, name: str) -> None:
    running.press(ENCODINGS[name], 1)
    running.resume()


def split_arrow(app: Held) -> None:
    """An arrow key whose bytes come in two parts, as fast as one terminal sends them."""
    for _ in range(20):
        began_s = app.terminal.send(b"\x1b")
        app.terminal.send(b"[A")
        if time.monotonic() - began_s < ESCAPE_WAITS_MS / 4e3:
            return
    pytest.skip("this computer is too busy to send two bytes one after the other")


@pytest.mark.parametrize(
    "keys",
    [
        b"\x1b[A\x1b[1;5B\x1b[5~",
        b"\x1b[200~a \x03 b \x1b c \x1b[27u\x1b[201~",
        b"\x1b[200~" + b"\x1bx" * 40 + b"\x03" * 40 + b"\x1b[201~",
        f"\x1b[<0;{COLUMNS // 2};{ROWS // 2}M\x1b[<0;{COLUMNS // 2};{ROWS // 2}m".encode(),
        f"\x1b[<35;{COLUMNS - 4};1M".encode(),
    ],
    ids=["other keys", "pasted text", "pasted controls", "mouse elsewhere", "mouse passes"],
)
def test_what_is_no_press_of_stop_stops_nothing(running: Held, keys: bytes) -> None:
    running.press(keys, 0)
    running.press(b"\x03", 1)
    running.resume()


def test_an_arrow_in_two_parts_stops_nothing(running: Held) -> None:
    before = len(running.calls())
    split_arrow(running)
    running.stays(before)


def test_a_paste_whose_end_is_lost_does_not_hide_stop(running: Held) -> None:
    before = len(running.calls())
    running.terminal.send(b"\x1b[200~half a tex")
    running.stays(before, 1.0)
    for _ in range(PRESSES):  # a busy computer may read the first one together with the text
        running.terminal.send(b"\x03")
        if comes_about(lambda: len(running.calls()) > before, time.monotonic() + 3.0):
            break
    running.stays(before + 1)
    running.resume()


def test_a_resume_that_was_pressed_before_a_stop_does_not_undo_it(running: Held) -> None:
    running.press(b"\x1b", 1)
    running.says("STOPPED")
    running.stays(len(running.calls()))
    running.press(b"c\x03", 1)
    running.says("collect STOPPED")
    running.resume()


def test_five_presses_at_once_are_five_stops(running: Held) -> None:
    running.press(b"\x03" * 5, 5)
    running.resume()


@pytest.mark.parametrize("key", ["Escape", "Ctrl-C", "mouse"])
def test_stop_answers_the_question_before_the_first_motion(tmp_path: Path, key: str) -> None:
    with held(tmp_path, "--asks") as app:
        app.terminal.send("tw")
        app.press(KEYS[key], 1)
        app.says("not confirmed")


def test_ctrl_c_without_a_job_says_how_to_quit(tmp_path: Path) -> None:
    with held(tmp_path, "--no-job") as app:
        app.terminal.send(b"\x03")
        app.says("Ctrl-C stops a job; none runs. q, or Ctrl-Q in a text field, quits.")
        assert "Do you want to quit?" not in app.terminal.text()
        app.terminal.send("\x10")
        app.says(PALETTE)
        app.terminal.send(b"\x1b")
        app.terminal.until(lambda text: PALETTE not in text, "Escape closes the palette")
        app.terminal.send("q")
        assert app.terminal.process.wait(WAIT_S) == 0


def quits(key: str) -> Callable[[Terminal], None]:
    def leave(terminal: Terminal) -> None:
        terminal.send(key)
        terminal.until(lambda text: "Quit?" in text, "the question", WAIT_S)
        terminal.quiet(QUIET_S, times=2.0)
        terminal.send("y")

    return leave


def ends(number: int) -> Callable[[Terminal], None]:
    return lambda terminal: terminal.process.send_signal(number)


@pytest.mark.parametrize(
    ("leave", "how"),
    [
        (quits("q"), LEFT),
        (quits("\x11"), LEFT),
        (Terminal.hang_up, "the terminal was closed"),
        (ends(signal.SIGHUP), "the terminal was closed"),
        (ends(signal.SIGTERM), "the program was asked to end (SIGTERM)"),
    ],
    ids=["q", "Ctrl-Q", "closed", "SIGHUP", "SIGTERM"],
)
def test_leaving_stops_first_and_says_what_it_was(tmp_path: Path, leave: Callable[[Terminal], None], how: str) -> None:
    with held(tmp_path) as app:
        leave(app.terminal)
        assert comes_about(lambda: bool(app.calls()), time.monotonic() + WAIT_S)
        assert app.terminal.process.wait(WAIT_S) == 4
        assert set(app.calls()) == {f"stop {how}"}
