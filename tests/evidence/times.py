"""What the commands of the simulated cell take, each in a process of its own: by the clock, of processor time, in
*loops* (a million rounds of a loop in Python, so that computers can be compared), and the largest memory. `run` does
all that those below it do. Use them as a range of a factor of three, and measure yours. Needs Linux."""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Table

TITLE = "Times"
ALONE = True
_ROUNDS, _LOOPS = 15, 1_000_000
_SAMPLE_S = 0.02


@dataclass(frozen=True)
class Measured:
    """One command: times [s], memory [MB]."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def measured(arguments: Sequence[str]) -> Measured:
    """Run ``cellapp`` with some arguments. Raises ``CalledProcessError`` if it fails."""
    command = [sys.executable, "-m", "cellapp", *arguments]
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    sampler = _MemorySampler(process.pid)
    sampler.start()
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - began
    sampler.end()
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):  # 1: a tolerance of the twin was not kept
        raise subprocess.CalledProcessError(process.returncode, ["cellapp", *arguments])
    return Measured(wall_s, usage.ru_utime + usage.ru_stime, max(usage.ru_maxrss / 1024.0, sampler.peak_mb))


class _MemorySampler(threading.Thread):
    """The largest sum of the resident memory of a process and its descendants."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self._pid, self._ended, self.peak_mb = pid, threading.Event(), 0.0

    def run(self) -> None:
        while not self._ended.wait(_SAMPLE_S):
            self.peak_mb = max(self.peak_mb, sum(map(_resident_mb, _with_descendants(self._pid))))

    def end(self) -> None:
        self._ended.set()
        self.join()


def _with_descendants(pid: int) -> list[int]:
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it ended meanwhile
        return []
    return [pid, *(one for child in children for one in _with_descendants(int(child)))]


def _resident_mb(pid: int) -> float:
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def commands(profile: Path, folder: Path) -> dict[str, list[str]]:
    """Name -> arguments of the whole run, and of its parts in their order."""
    run, targets = str(folder / "parts"), str(profile.parent / "targets" / "twin.yaml")
    return {
        "run": ["run", str(profile), "--run", str(folder / "whole")],
        "plan": ["plan", str(profile), "--run", run],
        "collect": ["collect", run],
        "calibrate": ["calibrate", run],
        "discover": ["discover", run],
        "compensate": ["compensate", run, targets],
        "push --verify": ["push", run, targets, "--verify"],
        "report": ["report", run],
        "show": ["show", run],
        "doctor": ["doctor", str(profile)],
        "--help": ["--help"],
    }


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"twin": {}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(TWIN, Path(folder)).items():
            before_s = loop_s()
            its = measured(arguments)
            found[name] = [its.wall_s, its.cpu_s, 2.0 * its.cpu_s / (before_s + loop_s()), its.peak_mb]
    return {"commands": found, "processor": processor(), "loop_s": loop_s()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    its = results[0]
    rows = [
        [f"`cellapp {name}`", f"{wall:.1f} s", f"{cpu:.1f} s", f"{loops:.0f}", f"{peak:.0f} MB"]
        for name, (wall, cpu, loops, peak) in its["commands"].items()
    ]
    said = f"{its['processor']}; a million rounds took {1e3 * its['loop_s']:.0f} ms."
    return Evidence(tables=[Table("", ["command", "clock", "processor", "loops", "memory"], rows)], said=[said])


def processor() -> str:
    """Name of the processor, as the system states it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def median_s(job: Callable[[], object]) -> float:
    """Median processor time of a job [s]: what others do on the computer counts little in it."""
    times = []
    for _ in range(_ROUNDS):
        began = time.process_time()
        job()
        times.append(time.process_time() - began)
    return statistics.median(times)


def loop_s() -> float:
    """The reference that ratios are of: processor time of a million rounds of a loop in Python [s]."""
    return median_s(_loop)


def _loop() -> int:
    total = 0
    for number in range(_LOOPS):
        total += number & 7
    return total
