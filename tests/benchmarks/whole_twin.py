"""What the whole run of a simulated cell takes, command by command: time, processor, memory, modules; and ``--help``.

    python -m tests.benchmarks.whole_twin [PROFILE]

Every command runs in a process of its own, as a user starts it. Printed are seconds by the clock, seconds of processor
time of all threads and children, that time in *loops*, the reference of ``reference_time`` as it was before and after
the command, so that other computers can be compared, the largest memory of the process with its children, and which of
the modules that take long to load it has loaded. ``run`` does in one process what the commands below it do one after
the other. Needs Linux: memory is read from /proc every 20 ms.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.reference_time import loop_s, processor

PROFILE = Path(__file__).parents[2] / "profiles" / "twin.yaml"
SLOW_TO_LOAD = (
    *("torch", "matplotlib", "pandas", "dask", "distributed", "plotly", "playwright", "textual", "scipy.stats"),
    *("scipy.optimize", "scipy.spatial", "scipy.interpolate", "numpy", "pydantic", "jinja2", "rich"),
)
_HELP_ROUNDS = 5
"""Of which the fastest counts: the others waited for something else."""
_SAMPLE_S = 0.02
_PROGRAM = f"""
import atexit, sys
atexit.register(lambda: print(*({{*{SLOW_TO_LOAD!r}}} & sys.modules.keys()), file=open(sys.argv.pop(), "w")))
from cellapp.interfaces.cli import main
modules = sys.argv.pop()
atexit.register(lambda: sys.argv.append(modules))
main()
"""


@dataclass(frozen=True)
class Measured:
    """One command: times [s], memory [MB], the slow modules that it loaded."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    modules: tuple[str, ...]


def measured(arguments: Sequence[str]) -> Measured:
    """Run ``cellapp`` with some arguments. Raises ``CalledProcessError`` if it fails."""
    with tempfile.NamedTemporaryFile("r") as modules:
        command = [sys.executable, "-c", _PROGRAM, *arguments, modules.name]
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
        peak_mb = max(usage.ru_maxrss / 1024.0, sampler.peak_mb)
        return Measured(wall_s, usage.ru_utime + usage.ru_stime, peak_mb, tuple(modules.read().split()))


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
    }


def verbs() -> list[str]:
    """All commands of the program, as its help lists them; '' for the program itself."""
    import typer

    from cellapp.interfaces.cli.app import app

    group = typer.main.get_command(app)
    return ["", *group.commands] if isinstance(group, typer.core.TyperGroup) else [""]


def say(line: str) -> None:
    """Print a line of a table as soon as it is known."""
    print(line, flush=True)  # noqa: T201


def main() -> None:
    """Print the two tables."""
    profile = Path(sys.argv[1]) if len(sys.argv) > 1 else PROFILE
    say(f"{processor()}; a loop of a million rounds in Python took {1e3 * loop_s():.0f} ms")
    say(f"{'command':14} {'clock s':>8} {'cpu s':>7} {'loops':>6} {'MB':>6}  modules that are slow to load")
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(profile, Path(folder)).items():
            before_s = loop_s()
            found = measured(arguments)
            loops = 2.0 * found.cpu_s / (before_s + loop_s())
            loaded = " ".join(module for module in SLOW_TO_LOAD if module in found.modules)
            say(f"{name:14} {found.wall_s:8.2f} {found.cpu_s:7.2f} {loops:6.0f} {found.peak_mb:6.0f}  {loaded}")
    say(f"\n{'--help of':20} {'clock s':>8} {'MB':>6}  modules that are slow to load")
    for verb in verbs():
        rounds = [measured([*verb.split(), "--help"]) for _ in range(_HELP_ROUNDS)]
        best = min(rounds, key=lambda one: one.wall_s)
        say(f"{verb or 'cellapp':20} {best.wall_s:8.2f} {best.peak_mb:6.0f}  {' '.join(sorted(best.modules))}")


if __name__ == "__main__":
    main()
