"""Faults of ``trials storm``: what happens to the cell, the computer and the person, and when."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellapp.ground.errors import CellappError
from cellapp.ground.job_client import Verb, ask_running_job
from tests.evidence.wire.storm_cell import StormCell

KILL = "program killed"
_SLIDER_S, _PAUSE_S, _STALL_S = 0.4, 0.4, 0.8
"""How long the slider stays low, a pause lasts, and this computer stalls: longer than heartbeats may be late."""
LONGEST_DELAY_S = 0.4
"""From the moment from which a fault is due to the fault: about the time of a stop, with its motion and measurement."""
_AT_START, _LONGEST_START_S = 0.15, 4.0
"""Share of the faults that are due after the start of a program rather than after its first motion, and their delay."""
_LAST_STOP = 0.8
"""No fault is due later than at this share of the stops: the run must not end before it."""


@dataclass
class Scene:
    """What a fault may strike: the cell, one of its arms, the collecting program, and its run's folder; and what other
    programs said."""

    cell: StormCell
    arm: str
    program: subprocess.Popen[Any]
    folder: Path
    words: str = ""

    @property
    def children(self) -> list[int]:
        """The processes that hold the arms' clients."""
        found = Path(f"/proc/{self.program.pid}/task/{self.program.pid}/children").read_text("ascii")
        return [int(pid) for pid in found.split()]


Strike = Callable[[Scene], None]


@dataclass(frozen=True)
class StormFault:
    """One kind of fault. ``stops`` tells whether the arms must rest after it until a person resumes."""

    strike: Strike
    stops: bool


def command(name: str, *arguments: object) -> Strike:
    """A command to the emulated controller of the arm."""
    return lambda scene: scene.cell.control(scene.arm, name, *arguments)


def _tracker(kind: str) -> Strike:
    return lambda scene: scene.cell.tracker_fault(kind)


def signals(*numbers: signal.Signals) -> Strike:
    """Signals to the program."""

    def strike(scene: Scene) -> None:
        for number in numbers:
            scene.program.send_signal(number)

    return strike


def _request(*verbs: Verb) -> Strike:
    """Ask the running job as another terminal would; a job that does not listen yet, or no more, is left alone."""

    def strike(scene: Scene) -> None:
        for number, verb in enumerate(verbs):
            if number:
                time.sleep(_PAUSE_S)
            with suppress(CellappError):
                ask_running_job(scene.folder, verb)

    return strike


def _low_slider(fraction: float) -> Strike:
    """Lower the speed slider for a while, as a person at the pendant does."""

    def strike(scene: Scene) -> None:
        scene.cell.control(scene.arm, "slider", fraction)
        time.sleep(_SLIDER_S)
        scene.cell.control(scene.arm, "slider", 1.0)

    return strike


def hang(for_s: float) -> Strike:
    """Let the program hang for a while; its arms' processes go on."""

    def strike(scene: Scene) -> None:
        scene.program.send_signal(signal.SIGSTOP)
        time.sleep(for_s)
        scene.program.send_signal(signal.SIGCONT)

    return strike


def kill_worker(scene: Scene) -> None:
    """Kill one of the processes that hold the arms' clients."""
    with suppress(OSError):
        for pid in scene.children[:1]:
            os.kill(pid, signal.SIGKILL)


FAULTS: Mapping[str, StormFault] = {
    "link closed": StormFault(command("drop", "rtde", "fin"), True),
    "link reset": StormFault(command("drop", "rtde", "rst"), True),
    "link silent": StormFault(command("fault", "rtde", "silent"), True),
    "host silent": StormFault(command("fault", "*", "silent"), True),
    "protective stop": StormFault(command("protective", "now"), True),
    "emergency stop": StormFault(command("estop"), True),
    "slider at 0": StormFault(_low_slider(0.0), False),
    "slider at 30 %": StormFault(_low_slider(0.3), False),
    "worker killed": StormFault(kill_worker, True),
    "computer stalls": StormFault(hang(_STALL_S), True),
    "Ctrl-C": StormFault(signals(signal.SIGINT), True),
    "Ctrl-C twice": StormFault(signals(signal.SIGINT, signal.SIGINT), True),
    "terminated": StormFault(signals(signal.SIGTERM), True),
    "stop asked": StormFault(_request("stop"), True),
    "abort asked": StormFault(_request("abort"), True),
    "pause asked": StormFault(_request("pause", "resume"), False),
    "beam broken": StormFault(_tracker("beam"), False),
    "bridge drops": StormFault(_tracker("drop"), False),
    "bridge garbles": StormFault(_tracker("garbage"), False),
    "bridge silent": StormFault(_tracker("silence"), False),
    "bridge cuts a line": StormFault(_tracker("truncate"), False),
    "bridge repeats": StormFault(_tracker("repeat"), False),
    "bridge restarts": StormFault(_tracker("reboot"), False),
    "tracker restarts": StormFault(_tracker("tracker-reboot"), False),
    KILL: StormFault(signals(signal.SIGKILL), True),
}
"""Faults by name; ``KILL`` is counted apart."""


@dataclass(frozen=True)
class Event:
    """A fault.

    It is due ``delay_s`` after ``at_stop`` stops are stored, or after the program was started again: after its first
    motion, with ``at_start`` after the start of the program itself.
    """

    kind: str
    arm: str
    at_stop: int
    delay_s: float
    at_start: bool


def sampled_events(
    stops: int, faults: int, kills: int, arms: tuple[str, ...], random: np.random.Generator
) -> list[Event]:
    """Draw the events of a run of ``stops`` stops in the order in which they are due, all kinds about equally often."""
    kinds = [kind for kind in FAULTS if kind != KILL]
    names = [*random.permutation(np.resize(np.array(kinds), faults)).tolist(), *[KILL] * kills]
    at_stops = np.sort(random.integers(0, max(1, int(_LAST_STOP * stops)), len(names)))
    events = []
    for kind, at_stop in zip(random.permutation(names), at_stops, strict=True):
        at_start = bool(random.random() < _AT_START)
        delay_s = float(random.uniform(0.0, _LONGEST_START_S if at_start else LONGEST_DELAY_S))
        events.append(Event(str(kind), str(random.choice(arms)), int(at_stop), delay_s, at_start))
    return events
