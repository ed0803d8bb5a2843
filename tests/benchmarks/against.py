"""Processor time and memory of a command over those of an earlier version: ratios, which other computers give as well.

    git worktree add --detach ../earlier COMMIT
    python -m tests.benchmarks.against [--turns N] ../earlier plan profiles/twin.yaml

Both versions run the command in turns, each in a process of its own, in its own source tree, with the profile there;
``--run DIR`` is added to ``plan`` and ``run``. Other processes make processor time longer, too (caches, two threads of
one core), hence turns, medians, and ratios alone. Needs Unix.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

HERE = Path(__file__).parents[2]
_MAKES_A_RUN = ("plan", "run")


def measured(source: Path, arguments: Sequence[str]) -> tuple[float, float]:
    """Processor time [s] and largest memory [MB] of ``cellapp`` of a source tree. Raises ``SystemExit`` if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        run = ["--run", f"{folder}/run"] if arguments[0] in _MAKES_A_RUN else []
        environment = {**os.environ, "PYTHONPATH": str(source)}
        command = [sys.executable, "-m", "cellapp", *arguments, *run]
        process = subprocess.Popen(command, cwd=source, env=environment, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} in {source} ended with {process.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    """Print a row of each turn, and the median ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("earlier", type=Path)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    asked = parser.parse_args()
    turns = []
    for _ in range(asked.turns):
        earlier, here = (measured(source.resolve(), asked.arguments) for source in (asked.earlier, HERE))
        turns.append((*here, *earlier))
        print("here {:.1f} s, {:.0f} MB; earlier {:.1f} s, {:.0f} MB".format(*turns[-1]), flush=True)  # noqa: T201
    of_turns = np.array(turns)
    ratios = np.median(of_turns[:, :2] / of_turns[:, 2:], axis=0)
    print(f"processor time {ratios[0]:.2f}, memory {ratios[1]:.2f} of the earlier version's (medians)")  # noqa: T201


if __name__ == "__main__":
    main()
