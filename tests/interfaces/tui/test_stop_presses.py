"""Presses at a pseudo terminal reach both emulated controllers; a run says how a person left it."""

from __future__ import annotations

import math
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from tests.evidence.wire.pseudo_terminal import PseudoTerminal
from tests.evidence.wire.terminal_presses import KEYS, PLACES, press_bench
from tests.loopback import free_port, own_address
from tests.twin import PROFILES
from tests.waiting import WAIT_S

pytestmark = pytest.mark.waits

HOSTS = {"127.0.0.2": own_address(67), "127.0.0.3": own_address(68)}
TRACKER_HOST = own_address(67)
FEW = {"stops": "30\n  method: random", **dict.fromkeys(("identify", "train", "validate"), 10)}
"""Of the profile: stops that last for the presses and are soon planned."""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """An emulated cell in a folder of its own, the only profile there."""
    for name in ("arms", "targets"):
        shutil.copytree(PROFILES / name, tmp_path / "profiles" / name)
    text = (PROFILES / "twin-rtde.yaml").read_text("utf-8")
    text = text.replace("127.0.0.1:50960", f"{TRACKER_HOST}:{free_port(TRACKER_HOST)}")
    for before, now in HOSTS.items():
        text = text.replace(before, now)
    path = tmp_path / "profiles" / "twin-rtde.yaml"
    for key, size in FEW.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    path.write_text(text, "utf-8")
    return path


def quit_with_q(terminal: PseudoTerminal) -> None:
    terminal.forget()
    terminal.send("q")
    terminal.until(lambda text: "Quit?" in text, "the question", WAIT_S)
    terminal.quiet(0.3)
    terminal.send("y")


def end(terminal: PseudoTerminal) -> None:
    terminal.process.send_signal(signal.SIGTERM)


def test_each_key_stops_both_controllers_and_nothing_begins_before_resume(profile: Path, tmp_path: Path) -> None:
    with press_bench(profile, tmp_path) as bench:
        bench.begin()
        presses = [bench.press(key, place) for key, place in zip(KEYS, PLACES, strict=False)]
    for press in presses:
        assert all(map(math.isfinite, press.latency_ms.values())), press
        assert set(press.latency_ms) == {"left", "right"}
        assert press.began == 0, press


@pytest.mark.parametrize(
    ("leave", "how"),
    [
        pytest.param(quit_with_q, "a person left the application", marks=pytest.mark.slow),
        (PseudoTerminal.hang_up, "the terminal was closed"),
        pytest.param(end, "the program was asked to end (SIGTERM)", marks=pytest.mark.slow),
    ],
    ids=["q", "closed", "SIGTERM"],
)
def test_a_run_says_how_a_person_left_it(
    profile: Path, tmp_path: Path, leave: Callable[[PseudoTerminal], None], how: str
) -> None:
    with press_bench(profile, tmp_path) as bench:
        bench.begin()
        bench.go_while_moving(PLACES["Collect"], how)
        leave(bench.terminal)
        assert bench.terminal.process.wait(WAIT_S) == 4
        assert all(bench.cell.control(name, "stops") for name in bench.cell.arms)
        assert bench.cell.wait_at_rest(WAIT_S)
    with RunFile.open(tmp_path / "logs" / "presses") as run:
        (session,) = run.sessions()
        said = [reason for _, _, reason in session.requests]
        assert how in said[-1], said
        assert "a person stopped" not in " ".join(said), said
        assert session.outcome == "stopped"
