"""Processor time and memory of commands over those of an earlier version: ratios, which other computers give as well.

    git worktree add --detach ../earlier COMMIT
    python -m tests.benchmarks.against [--turns N] ../earlier
    python -m tests.benchmarks.against [--turns N] ../earlier plan profiles/twin.yaml

The first prints the handbook's table of all jobs below, then identification over one ``numpy.linalg.lstsq`` of the
same size; ``--only WORD`` takes the rows whose name has it. The second compares one command of ``cellapp``. Both
versions run in turns, each in a process of its own, in its own source tree, with the profile there; ``--run DIR`` is
added to ``plan`` and ``run``. Other processes make processor time longer, too (caches, two threads of one core), hence
turns, the least of them, and ratios alone. Needs Unix.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellapp.estimation.calibration.identification import identify
from cellapp.robot.kinematics.chain import smr_positions
from tests.arms import OFF_AXIS, UR10, at_station, true_geometry
from tests.benchmarks.identification import NOISE_M, least_squares_of, problem
from tests.benchmarks.reference_time import processor
from tests.benchmarks.whole_twin import say

HERE = Path(__file__).parents[2]
_MAKES_A_RUN = ("plan", "run")
_STARTS = ("doctor", "plan", "calibrate", "report", "show", "check")
_READINGS = 12_000
_HELD_OUT = 200
_MANY = 400_000
_IDENTIFIES = f"""
from cellapp.estimation.calibration.identification import identify
from tests.benchmarks.identification import problem
identify(*problem({_MANY}))
"""
_ONCE = 1
"""Turns of a job of minutes."""


class Cost(NamedTuple):
    """Processor time [s] and largest memory [MB] of a process."""

    cpu_s: float
    peak_mb: float


@dataclass(frozen=True)
class Job:
    """A row of the table: what is run in a source tree, and the bars (empty: none)."""

    name: str
    arguments: Callable[[Path, Path], list[str]]
    """Of Python, from source tree and empty folder."""
    before: Callable[[Path, Path], list[str]] | None = None
    """Prepares the folder; not measured."""
    bar: str = ""
    turns: int | None = None
    alone: bool = False
    """Whether the earlier version has no such job."""
    judges: bool = False
    """Whether exit code 1 says that a tolerance was not kept; an unexpected error ends with it, too."""


def measured(source: Path, arguments: Sequence[str], *, judges: bool = False) -> Cost:
    """Cost of Python with some arguments in a source tree. Raises ``SystemExit`` if it fails."""
    environment = {**os.environ, "PYTHONPATH": str(source)}
    process = subprocess.Popen(
        [sys.executable, *arguments],
        cwd=source,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in ((0, 1) if judges else (0,)):
        raise SystemExit(f"{' '.join(arguments)} in {source} ended with {process.returncode}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def cost_of(source: Path, job: Job) -> Cost:
    """Cost of a job in a folder of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if job.before is not None:
            measured(source, job.before(source, folder))
        return measured(source, job.arguments(source, folder), judges=job.judges)


def command(*arguments: str) -> Callable[[Path, Path], list[str]]:
    """Arguments of ``cellapp``; it makes its run in the folder where it makes one."""

    def of(source: Path, folder: Path) -> list[str]:
        run = ["--run", str(folder / "run")] if arguments[0] in _MAKES_A_RUN else []
        return ["-m", "cellapp", *arguments, *run]

    return of


def code(text: str) -> Callable[[Path, Path], list[str]]:
    """Arguments that run a line of Python."""
    return lambda source, folder: ["-c", text]


def jobs() -> Iterator[Job]:
    """The rows against the earlier version."""
    twin = "profiles/twin.yaml"
    yield Job("plan, 400 stops of both arms, seed 1", command("plan", twin), bar="0.2")
    yield Job("the same, seed 2", _plan_of("seed: 1 ", "seed: 2 "), bar="0.2")
    yield Job("plan, 4000 stops", _plan_of("stops: 400 ", "stops: 4000 "), bar="0.25", turns=_ONCE)
    yield Job("run, the whole twin", command("run", twin), bar="0.33; 300 MB", turns=_ONCE, judges=True)
    yield Job("import cellapp", code("import cellapp"), bar="0.1 s")
    for verb in _STARTS:
        loaded = f"import cellapp.interfaces.cli.app, cellapp.commands.{verb}.run"
        yield Job(f"start of {verb}: its modules", code(loaded), bar="0.5 s", alone=True)
    yield Job("doctor of the twin", command("doctor", twin), bar="0.5 s")
    yield Job(
        f"calibrate, {_READINGS} readings, network",
        lambda source, folder: ["-m", "cellapp", "calibrate", str(folder / "run")],
        before=_imported_readings,
        bar="10 s",
        turns=_ONCE,
    )


def _plan_of(text: str, changed: str) -> Callable[[Path, Path], list[str]]:
    """A plan of the twin with another line in its profile."""

    def of(source: Path, folder: Path) -> list[str]:
        profile = folder / "twin.yaml"
        of_tree = (source / "profiles" / "twin.yaml").read_text("utf-8").replace(text, changed)
        of_tree = of_tree.replace("type: arms/", f"type: {source}/profiles/arms/")
        profile.write_text(of_tree.replace("targets: targets/", f"targets: {source}/profiles/targets/"), "utf-8")
        return ["-m", "cellapp", "plan", str(profile), "--run", str(folder / "run")]

    return of


def _imported_readings(source: Path, folder: Path) -> list[str]:
    """Import readings of an elastic UR10, whose sag the network has to learn."""
    rng = np.random.default_rng(0)
    truth = true_geometry(at_station(UR10, OFF_AXIS), rng)
    q = rng.uniform(-2.5, 2.5, (_READINGS + _HELD_OUT, 6))
    sag = 5e-4 * np.cos(q[:, 1]) + 3e-4 * np.sin(q[:, 1] + q[:, 2]) * np.cos(q[:, 3])
    p_M = smr_positions(truth, q) + np.stack([0.3 * sag, 0.2 * sag, -sag], axis=1)
    p_M += rng.normal(0.0, NOISE_M, p_M.shape)
    lines = ["configuration,arm,q1,q2,q3,q4,q5,q6,x_m,y_m,z_m,sigma_m"]
    for number, row in enumerate(np.hstack([q, p_M]).tolist()):
        lines.append(f"{number},left,{','.join(f'{value:.9f}' for value in row)},{NOISE_M}")
    (folder / "readings.csv").write_text("\n".join(lines) + "\n", "utf-8")
    profile = (source / "profiles" / "ur10-real.yaml").read_text("utf-8")
    profile = profile.replace("type: arms/", f"type: {source}/profiles/arms/").replace("train: 0", "train: 11700")
    (folder / "profile.yaml").write_text(profile, "utf-8")
    made = [str(folder / name) for name in ("profile.yaml", "readings.csv")]
    return ["-m", "cellapp", "import", *made, "--run", str(folder / "run")]


def compare(job: Job, earlier: Path, turns: int) -> str:
    """A row of the table: times and memory there and here, least of the turns."""
    found: dict[Path, list[Cost]] = {HERE: []} if job.alone else {earlier: [], HERE: []}
    for _ in range(job.turns or turns):
        for source, costs in found.items():
            costs.append(cost_of(source, job))
    least = [Cost(*np.min(np.array(costs), axis=0).tolist()) for costs in found.values()]
    then, now = ("" if job.alone else f"{least[0].cpu_s:.2f} s, {least[0].peak_mb:.0f} MB"), least[-1]
    ratio = "" if job.alone else f"{now.cpu_s / least[0].cpu_s:.2f}"
    return f"| {job.name} | {then} | {now.cpu_s:.2f} s, {now.peak_mb:.0f} MB | {ratio} | {job.bar} |"


def identification(configurations: int, rounds: int) -> tuple[float, float, int]:
    """Least time of one identification of 27 parameters, and of one ``lstsq`` of its size [s]; iterations."""
    start, q, p_M = problem(configurations)
    iterations = identify(start, q, p_M).iterations
    A, b = least_squares_of(start, q, p_M)
    times = np.empty((rounds, 2))
    for row in times:
        for k, function in enumerate((lambda: identify(start, q, p_M), lambda: np.linalg.lstsq(A, b, rcond=None))):
            began_s = time.process_time()
            function()
            row[k] = time.process_time() - began_s
    return (*times.min(axis=0).tolist(), iterations)


def _identification_rows(only: str) -> Iterator[str]:
    for configurations, rounds, bar in ((400, 300, "2.5"), (100, 300, ""), (_MANY, 2, "1 s an iteration, 400 MB")):
        name = f"identification, {configurations} configurations"
        if only not in name:
            continue
        # before this process is large: a child begins with its size
        memory = f", {measured(HERE, ['-c', _IDENTIFIES]).peak_mb:.0f} MB" if configurations == _MANY else ""
        own_s, lstsq_s, iterations = identification(configurations, rounds)
        yield (
            f"| {name} | {1e3 * lstsq_s:.2f} ms (one lstsq) |"
            f" {1e3 * own_s:.2f} ms, {1e3 * own_s / iterations:.2f} an iteration{memory} |"
            f" {own_s / lstsq_s:.2f} | {bar} |"
        )


def main() -> None:
    """Print the table of all jobs, or a row of one command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("earlier", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--only", default="", help="rows whose name has this word")
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    asked = parser.parse_args()
    rows = [Job(" ".join(asked.arguments), command(*asked.arguments))] if asked.arguments else list(jobs())
    say(
        f"{processor()}, least of {asked.turns} turns\n\n"
        "| | then | now | ratio | bar |\n| --- | --- | --- | --- | --- |"
    )
    for job in rows:
        if asked.only in job.name:
            say(compare(job, asked.earlier.resolve(), asked.turns))
    if not asked.arguments:
        for row in _identification_rows(asked.only):
            say(row)


if __name__ == "__main__":
    main()
