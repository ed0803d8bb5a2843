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
from tests.evidence.wire.storm_cell import StormCell, cellapp_process, emulated_cell, wire_profile
from tests.evidence.wire.storm_faults import Scene, Strike, command, hang, kill_worker, signals
from tests.evidence.wire.storm_operator import Stored, lost_and_doubled, stored
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
_PATIENT_S, _ENDS_WITHIN_S, _RESTS_WITHIN_S, _WATCHED_S = 120.0, 40.0, 6.0, 0.5
_OTHER_RUN = "night"
"""Folder of a second run, beside that of the first."""
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


@dataclass(frozen=True)
class Attack:
    """What happens, and the longest time until both controllers have a stop [ms]; nan if none is to come.

    ``when``: while both arms move, while they are connected, or while they rest and are measured.
    """

    strike: Strike
    most_ms: float = math.nan
    when: Literal["moving", "connecting", "measuring"] = "moving"


def _asked(run: Path, verb: str, *words: str, **how: Any) -> subprocess.Popen[str]:
    """Start a command on a run that tells why it ends."""
    return cellapp_process(run.parent, verb, str(run), *words, stderr=subprocess.PIPE, text=True, **how)


def _last_line(program: subprocess.Popen[str]) -> str:
    lines = [line for line in program.communicate()[1].splitlines() if line.startswith("cellapp: ")]
    told = [line for line in lines if "to report this" not in line]
    return " ".join(_NOISE.sub(" ", told[-1] if told else "").split())


def _stop_run(scene: Scene) -> None:
    cellapp_process(scene.folder.parent, "stop", str(scene.folder))


def _stop_of_another(scene: Scene) -> None:
    """Another account asks the job to stop, which it cannot; then the person at the terminal does."""
    scene.words = _last_line(_asked(scene.folder, "stop", program=_AS_NOBODY))
    _still_moves(scene)


def _second_program(scene: Scene) -> None:
    """A second program wants the same arms for another run, and is refused; then the first one is stopped."""
    scene.words = _last_line(_asked(scene.folder.with_name(_OTHER_RUN), "collect"))
    _still_moves(scene)


def _still_moves(scene: Scene) -> None:
    if scene.program.poll() is not None:
        scene.words += " THE JOB ENDED"
    scene.program.send_signal(signal.SIGINT)


def _kill_all(scene: Scene) -> None:
    for pid in (*scene.children, scene.program.pid):
        os.kill(pid, signal.SIGKILL)


def _push_and_back(scene: Scene) -> None:
    command("push", 1e-2, 0.3)(scene)
    time.sleep(0.1)
    command("push", -1e-2, 0.3)(scene)


ATTACKS: dict[str, Attack] = {
    "Ctrl-C": Attack(signals(signal.SIGINT), KEY_MS),
    "SIGTERM": Attack(signals(signal.SIGTERM), KEY_MS),
    "cellapp stop": Attack(_stop_run, COMMAND_MS),
    "stop of another account, then Ctrl-C": Attack(_stop_of_another),
    "second cellapp, then Ctrl-C": Attack(_second_program),
    "Ctrl-C while connecting, program starts 0.6 s late": Attack(signals(signal.SIGINT), when="connecting"),
    "RTDE closed": Attack(command("drop", "rtde", "fin"), LOST_MS),
    "RTDE reset": Attack(command("drop", "rtde", "rst"), LOST_MS),
    "RTDE silent": Attack(command("fault", "rtde", "silent"), SILENT_MS),
    "cable of one arm cut": Attack(command("fault", "*", "silent"), SILENT_MS),
    "malformed packet, size 0": Attack(command("send", "rtde", "000055"), LOST_MS),
    "network 0.1 s late": Attack(command("network", 0.1)),
    "network loses 5 %": Attack(command("network", 0.005, 0.05)),
    "stopped on the pendant": Attack(lambda scene: stop_program(HOSTS[0], 1.0)),
    "protective stop": Attack(command("protective", "now"), LOST_MS),
    "driver process killed": Attack(kill_worker, _BY_WATCHDOG_MS),
    "program killed": Attack(signals(signal.SIGKILL), LOST_MS),
    "all processes killed": Attack(_kill_all, _BY_WATCHDOG_MS),
    "program suspended for 2 s": Attack(hang(2.0)),
    "program suspended for 5 s while measuring": Attack(hang(5.0), _SUSPENDED_MS, "measuring"),
    "arm pushed by 10 mrad while measured": Attack(command("push", 1e-2, 0.3), SILENT_MS, "measuring"),
    "arm pushed by 10 mrad and back while measured": Attack(_push_and_back, SILENT_MS, "measuring"),
    "arm moved by a step of 1 mrad while measured": Attack(command("push", 1e-3, 1e3), SILENT_MS, "measuring"),
    "arm creeps by 4 mrad/s while measured": Attack(command("push", 1e-2, 4e-3), SILENT_MS, "measuring"),
}


@dataclass
class Struck:
    """What one attack led to; ``stop_ms``: nan where no stop was to come; ``programs``: controllers with one at
    the end."""

    attack: str
    stop_ms: float
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
    random: np.random.Generator
    sessions: int = 0
    seen: Stored = field(default_factory=dict)

    def attack(self, name: str) -> Struck:
        """Collect, attack, let the program end, and repair the cell."""
        attack, cell = ATTACKS[name], self.cell
        for arm in cell.arms if attack.when == "connecting" else ():
            cell.control(arm, "start-delay", 0.6)
        scene = Scene(cell, cell.arms[0], self._collect(), self.run)
        before = sum(one["moves"] for one in cell.status().values())
        moves = partial(self._moves, before + int(self.random.integers(4, 14)))  # so that there are readings to lose
        ready: Mapping[str, Callable[[], bool]]
        ready = {"connecting": self._connects, "moving": moves, "measuring": partial(self._measures, before)}
        comes_about(lambda: ready[attack.when]() or scene.program.poll() is not None, time.monotonic() + _PATIENT_S)
        time.sleep(self.random.uniform(0.0, 1.0 if attack.when == "measuring" else 0.2))
        struck_s = time.monotonic()
        attack.strike(scene)
        stop_ms = math.nan if math.isnan(attack.most_ms) else cell.stop_ms(struck_s)
        for _ in range(2):  # a program that goes on beside the attack is ended by a person
            with suppress(subprocess.TimeoutExpired):
                scene.program.wait(_ENDS_WITHIN_S)
                break
            scene.program.send_signal(signal.SIGINT)
        code = scene.program.poll()
        scene.program.kill()
        said = "; ".join(filter(None, (scene.words, _last_line(scene.program)))).replace(f"{self.run.parent}/", "")
        cell.wait_at_rest(_RESTS_WITHIN_S)
        rested_s = time.monotonic()
        time.sleep(_WATCHED_S if attack.when != "connecting" else 1.0)
        since_s = rested_s if math.isnan(stop_ms) else struck_s + stop_ms / 1e3 + _UNDER_WAY_S
        motions = 0 if math.isinf(since_s) else cell.began(since_s)
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
        return _asked(self.run, "collect", *(["--resume"] if self.sessions > 1 else []))

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

    def _look(self) -> tuple[int, int]:
        """Return how many readings are gone or have changed since the last look, and how many are there twice."""
        seen, self.seen = self.seen, stored(self.run)
        return lost_and_doubled(seen, self.seen)


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
        new_planned_run(profile, parent / _OTHER_RUN).close()
        with emulated_cell(profile, 1.0, watch_clearance=False) as cell:
            bench = Bench(cell, parent / "run", np.random.default_rng(1))
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
        worst = [one.stop_ms for one in its if not math.isnan(one.stop_ms)]
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
    stops = [one.stop_ms for one in struck if not math.isnan(one.stop_ms)]
    figures = {"attacks": str(len(struck)), "stop": f"{max(stops, default=0.0):.0f} ms", "wrong": str(wrong)}
    said = [f"{result['readings']} readings, compared with an undisturbed run's: false at {result['false']} arms."]
    return Evidence(figures, [Table("", columns, rows)], limits, said)


def _cut(said: str) -> str:
    """Return the first words of a message, for a cell of a table."""
    return f"{said[:_SHOWN]} ..." if len(said) > _SHOWN else said
