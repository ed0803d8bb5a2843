"""The real program collects with two emulated UR controllers (CB3, e-Series; watchdog 5 Hz) and a tracker while both
arms move, and is attacked: keys, commands, links, the network, processes, other accounts and other programs. Then the
cell is repaired and the run resumed. The controllers say when each stop came and whether anything moved after it; the
run, which readings were lost or stored twice, or differ from an undisturbed run's. No real arm was moved."""

from __future__ import annotations

import argparse
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.profile import Profile
from drivers.arms.ur_links import stop_program
from drivers.priority import in_real_time
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table
from tests.evidence.wire.polling import comes_about
from tests.evidence.wire.storm import SAME_RAD, deviation, undisturbed
from tests.evidence.wire.storm_cell import StormCell, emulated_cell, wire_profile
from tests.evidence.wire.storm_operator import Stored, stored
from tests.twin import altered, with_arm

TITLE = "Attacks on the wire"
ALONE = True
HOSTS, TRACKER = ("127.0.46.2", "127.0.46.3"), "socket://127.0.46.4:50946"
"""Addresses of the arms and the tracker, which no profile and no test has."""
KEY_MS, COMMAND_MS, LOST_MS, SILENT_MS = 50.0, 300.0, 100.0, 350.0
_BY_WATCHDOG_MS = 350.0
"""Limit of a stop that only the watchdog gives: its period, some control cycles, and what waits for a processor."""
_SUSPENDED_MS = 700.0
"""Limit of a stop of a program that is silent for 0.5 s."""
_PATIENT_S, _ENDS_WITHIN_S, _STOPS_WITHIN_S, _WATCHED_S = 120.0, 40.0, 6.0, 0.5
_ON_THE_WAY_S = 0.5
_UNDER_WAY_S = 0.02
"""A motion that was commanded before a stop may begin this much later."""
_NOISE = re.compile(r"^\W*(cellapp: )?|\s+")
_AS_NOBODY = (
    "-c",
    "import os, pwd, cellapp.interfaces.cli.program; from cellapp.interfaces.cli import main; os.setuid(65534); main()",
)
"""The program of another account, which may not read this one's Python: it has loaded what it needs before."""
_SIGMAS = 6.0
_SHOWN = 110
"""Characters of a message that the table shows."""


@dataclass
class Scene:
    """A session under attack: the cell, the collecting program, its run, a second run, and what others said."""

    cell: StormCell
    program: subprocess.Popen[str]
    run: Path
    other_run: Path
    words: str = ""

    @property
    def children(self) -> list[int]:
        """The processes that hold the arms' clients."""
        found = Path(f"/proc/{self.program.pid}/task/{self.program.pid}/children").read_text("ascii")
        return [int(pid) for pid in found.split()]


Strike = Callable[[Scene], None]


@dataclass(frozen=True)
class Attack:
    """What happens, and the longest time until both controllers have a stop [ms]; nan if none is to come.

    ``when``: while both arms move, while they are connected, or while they rest and are measured.
    """

    strike: Strike
    most_ms: float = math.nan
    when: Literal["moving", "connecting", "measuring"] = "moving"


def _signal(number: signal.Signals) -> Strike:
    return lambda scene: scene.program.send_signal(number)


def _command(*command: object) -> Strike:
    """A command to the emulated controller of the first arm."""
    return lambda scene: scene.cell.control(scene.cell.arms[0], *map(str, command))


def _cellapp(folder: Path, *words: str, program: Sequence[str] = ("-m", "cellapp")) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *program, *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def _last_line(program: subprocess.Popen[str]) -> str:
    lines = [line for line in program.communicate()[1].splitlines() if line.startswith("cellapp: ")]
    told = [line for line in lines if "to report this" not in line]
    return " ".join(_NOISE.sub(" ", told[-1] if told else "").split())


def _stop_command(scene: Scene) -> None:
    _cellapp(scene.run.parent, "stop", str(scene.run))


def _stop_of_another(scene: Scene) -> None:
    """Another account asks the job to stop, which it cannot; then the person at the terminal does."""
    scene.words = _last_line(_cellapp(scene.run.parent, "stop", str(scene.run), program=_AS_NOBODY))
    _still_moves(scene)


def _second_program(scene: Scene) -> None:
    """A second program wants the same arms for another run, and is refused; then the first one is stopped."""
    scene.words = _last_line(_cellapp(scene.other_run.parent, "collect", str(scene.other_run)))
    _still_moves(scene)


def _still_moves(scene: Scene) -> None:
    if scene.program.poll() is not None:
        scene.words += " THE JOB ENDED"
    scene.program.send_signal(signal.SIGINT)


def _kill_all(scene: Scene) -> None:
    for pid in (*scene.children, scene.program.pid):
        os.kill(pid, signal.SIGKILL)


def _kill_worker(scene: Scene) -> None:
    os.kill(scene.children[0], signal.SIGKILL)


def _hang(for_s: float) -> Strike:
    def strike(scene: Scene) -> None:
        scene.program.send_signal(signal.SIGSTOP)
        time.sleep(for_s)
        scene.program.send_signal(signal.SIGCONT)

    return strike


def _push_and_back(scene: Scene) -> None:
    _command("push", 1e-2, 0.3)(scene)
    time.sleep(0.1)
    _command("push", -1e-2, 0.3)(scene)


ATTACKS: dict[str, Attack] = {
    "Ctrl-C": Attack(_signal(signal.SIGINT), KEY_MS),
    "SIGTERM": Attack(_signal(signal.SIGTERM), KEY_MS),
    "cellapp stop": Attack(_stop_command, COMMAND_MS),
    "stop of another account, then Ctrl-C": Attack(_stop_of_another),
    "second cellapp, then Ctrl-C": Attack(_second_program),
    "Ctrl-C while connecting, program starts 0.6 s late": Attack(_signal(signal.SIGINT), when="connecting"),
    "RTDE closed": Attack(_command("drop", "rtde", "fin"), LOST_MS),
    "RTDE reset": Attack(_command("drop", "rtde", "rst"), LOST_MS),
    "RTDE silent": Attack(_command("fault", "rtde", "silent"), SILENT_MS),
    "cable of one arm cut": Attack(_command("fault", "*", "silent"), SILENT_MS),
    "malformed packet, size 0": Attack(_command("send", "rtde", "000055"), LOST_MS),
    "network 0.1 s late": Attack(_command("network", 0.1)),
    "network loses 5 %": Attack(_command("network", 0.005, 0.05)),
    "stopped on the pendant": Attack(lambda scene: stop_program(HOSTS[0], 1.0)),
    "protective stop": Attack(_command("protective", "now"), LOST_MS),
    "driver process killed": Attack(_kill_worker, _BY_WATCHDOG_MS),
    "program killed": Attack(_signal(signal.SIGKILL), LOST_MS),
    "all processes killed": Attack(_kill_all, _BY_WATCHDOG_MS),
    "program suspended for 2 s": Attack(_hang(2.0)),
    "program suspended for 5 s while measuring": Attack(_hang(5.0), _SUSPENDED_MS, "measuring"),
    "arm pushed by 10 mrad while measured": Attack(_command("push", 1e-2, 0.3), SILENT_MS, "measuring"),
    "arm pushed by 10 mrad and back while measured": Attack(_push_and_back, SILENT_MS, "measuring"),
    "arm moved by a step of 1 mrad while measured": Attack(_command("push", 1e-3, 1e3), SILENT_MS, "measuring"),
    "arm creeps by 4 mrad/s while measured": Attack(_command("push", 1e-2, 4e-3), SILENT_MS, "measuring"),
}


@dataclass
class Struck:
    """What one attack led to; ``programs``: controllers on which a program runs at the end."""

    attack: str
    stop_ms: list[float]
    motions: int
    programs: int
    lost: int
    doubled: int
    code: int | None
    said: str


@dataclass
class Bench:
    """Attacks the collecting of one run again and again; ``seen`` are its readings as last stored."""

    cell: StormCell
    run: Path
    other_run: Path
    random: np.random.Generator
    sessions: int = 0
    seen: Stored = field(default_factory=dict)

    def attack(self, name: str) -> Struck:
        """Collect, attack, let the program end, and repair the cell."""
        attack, cell = ATTACKS[name], self.cell
        for arm in cell.arms if attack.when == "connecting" else ():
            cell.control(arm, "start-delay", 0.6)
        scene = Scene(cell, self._collect(), self.run, self.other_run)
        before = sum(one["moves"] for one in cell.status().values())
        moves = partial(self._moves, before + int(self.random.integers(4, 14)))  # so that there are readings to lose
        ready: Mapping[str, Callable[[], bool]]
        ready = {"connecting": self._connects, "moving": moves, "measuring": partial(self._measures, before)}
        comes_about(lambda: ready[attack.when]() or scene.program.poll() is not None, time.monotonic() + _PATIENT_S)
        time.sleep(self.random.uniform(0.0, 1.0 if attack.when == "measuring" else 0.2))
        struck_s = time.monotonic()
        attack.strike(scene)
        stop_ms = [] if math.isnan(attack.most_ms) else [self._stop_ms(arm, struck_s) for arm in cell.arms]
        for _ in range(2):  # a program that goes on beside the attack is ended by a person
            with suppress(subprocess.TimeoutExpired):
                scene.program.wait(_ENDS_WITHIN_S)
                break
            scene.program.send_signal(signal.SIGINT)
        code = scene.program.poll()
        scene.program.kill()
        said = "; ".join(filter(None, (scene.words, _last_line(scene.program)))).replace(f"{self.run.parent}/", "")
        cell.wait_at_rest(_STOPS_WITHIN_S)
        rested_s = time.monotonic()
        time.sleep(_WATCHED_S if attack.when != "connecting" else 1.0)
        since_s = struck_s + max(stop_ms) / 1e3 + _UNDER_WAY_S if stop_ms else rested_s
        motions = 0 if math.isinf(since_s) else sum(len(cell.control(arm, "starts", since_s)) for arm in cell.arms)
        programs = sum(one["runtime_state"] != "STOPPED" for one in cell.status().values())
        for arm in cell.arms:
            cell.control(arm, "network", 0)
            cell.control(arm, "start-delay", 0.05)
        cell.repair()
        return Struck(name, stop_ms, motions, programs, *self._look(), code, said)

    def complete(self) -> int:
        """Collect the rest of the run undisturbed; return the exit code."""
        return self._collect().wait()

    def _collect(self) -> subprocess.Popen[str]:
        self.sessions += 1
        return _cellapp(self.run.parent, "collect", str(self.run), *(["--resume"] if self.sessions > 1 else []))

    def _moves(self, moves: int) -> bool:
        """Return whether both arms move, after so many motions of both."""
        now = self.cell.status().values()
        return all(one["moving"] for one in now) and sum(one["moves"] for one in now) >= moves

    def _measures(self, moves: int) -> bool:
        """Return whether the arms have rested for longer than between two parts of a way, after ``moves`` motions."""
        before = self.cell.status()
        time.sleep(_ON_THE_WAY_S)
        now = self.cell.status()
        moved = sum(one["moves"] for one in before.values()) > moves + 1
        return (
            moved and not any(one["moving"] for one in now.values()) and all(before[k]["q"] == now[k]["q"] for k in now)
        )

    def _connects(self) -> bool:
        return any(one["connections"]["rtde"] for one in self.cell.status().values())

    def _stop_ms(self, arm: str, struck_s: float) -> float:
        """Time to the stop at a controller [ms]; infinite if none comes."""
        deadline_s = struck_s + _STOPS_WITHIN_S
        if not comes_about(lambda: bool(self.cell.control(arm, "stops", struck_s)), deadline_s):
            return math.inf
        return 1e3 * float(self.cell.control(arm, "stops", struck_s)[0]["received_s"] - struck_s)

    def _look(self) -> tuple[int, int]:
        """Return how many readings are gone or have changed since the last look, and how many are there twice."""
        found = stored(self.run)
        lost = sum(found.get(key) != values for key, values in self.seen.items())
        self.seen = found
        return lost, len(found) - len({(name, values[-4:]) for (_, name), values in found.items()})


OPTIONS = {"repeats": 5, "only": ""}
"""``repeats``: of each attack; ``only``: attacks whose name contains this."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    names = [name for name in ATTACKS if asked.only in name]
    return {"attacks": {"names": names, "repeats": asked.repeats}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    return attacks(load_profile(ROOT / "profiles" / "twin-rtde.yaml"), case["names"], case["repeats"])


def attacks(profile: Profile, names: Sequence[str], repeats: int) -> dict[str, Any]:
    """Attack the collecting of one run ``repeats`` times with each; compare its readings with an undisturbed run's."""
    profile = wire_profile(profile, stops=12 + 2 * len(names) * repeats)
    for host, arm in zip(HOSTS, profile.arms, strict=True):
        profile = with_arm(profile, arm, driver={"host": host, "watchdog_hz": 5.0})
    profile = altered(profile, tracker={"driver": {"url": TRACKER}})
    with tempfile.TemporaryDirectory(prefix="cellapp-wire-") as folder, in_real_time():
        parent = Path(folder)
        parent.chmod(0o755)  # another account looks
        with new_planned_run(profile, parent / "run") as run:
            quiet = undisturbed(profile, read_planned_stops(run), parent / "undisturbed")
        new_planned_run(profile, parent / "night").close()
        with emulated_cell(profile, 1.0, watch_clearance=False) as cell:
            bench = Bench(cell, parent / "run", parent / "night", np.random.default_rng(1))
            struck = [bench.attack(name) for _ in range(repeats) for name in names]
            code = bench.complete()
        with RunFile.open(bench.run) as run, RunFile.open(quiet) as reference:
            found = [deviation(run, reference, name) for name in run.arms()]
            readings = sum(len(run.readings(name).configuration) for name in run.arms())
    false = sum(one.max_sigmas > _SIGMAS or one.joints_max_rad > SAME_RAD for one in found)
    return {"struck": [asdict(one) for one in struck], "readings": readings, "false": false, "complete": code}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = results[0]
    struck = [Struck(**one) for one in result["struck"]]
    rows, limits = [], []
    for name in dict.fromkeys(one.attack for one in struck):
        its = [one for one in struck if one.attack == name]
        worst = [max(one.stop_ms) for one in its if one.stop_ms]
        most = ATTACKS[name].most_ms
        codes = sorted({"never ended" if one.code is None else str(one.code) for one in its})
        rows.append(
            [
                name, str(len(its)), f"{np.median(worst):.0f}; {max(worst):.0f}" if worst else "",
                *(str(sum(getattr(one, what) for one in its)) for what in ("motions", "programs", "lost", "doubled")),
                ", ".join(codes), _cut(max((one.said for one in its), key=len)),
            ]
        )  # fmt: skip
        limits += [Limit(f"{name}: stop at both arms [ms]", max(worst), most)] if worst else []
    wrong = sum(one.lost + one.doubled for one in struck) + result["false"]
    limits += [
        Limit("motions after a stop", sum(one.motions for one in struck), 0),
        Limit("programs left", sum(one.programs for one in struck), 0),
        Limit("readings lost, doubled or false", wrong, 0),
        Limit("exit code of the run's completion", result["complete"], 0),
    ]
    columns = ["attack", "n", "stop at both arms [ms]: median; worst", "motions after", "programs left"]
    columns += ["readings lost", "doubled", "exit code", "what the screen said"]
    stops = [max(one.stop_ms) for one in struck if one.stop_ms]
    figures = {"attacks": str(len(struck)), "stop": f"{max(stops, default=0.0):.0f} ms", "wrong": str(wrong)}
    said = [f"{result['readings']} readings, compared with an undisturbed run's: false at {result['false']} arms."]
    return Evidence(figures, [Table("", columns, rows)], limits, said)


def _cut(said: str) -> str:
    """Return the first words of a message, for a cell of a table."""
    return f"{said[:_SHOWN]} ..." if len(said) > _SHOWN else said
