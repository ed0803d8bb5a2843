"""cellapp and three public libraries on the same identification problems: time, error and failures.

    python -m tests.benchmarks.peers --venvs DIR [--configurations 100 400] [--seeds 5] [--markdown FILE]

The problems are those of ``cases``. Each peer is installed by pip into an environment of its own below DIR, and driven
by its own small script in a process of its own, on one thread. Its time is that of the solver alone, without start of
the process, imports and reading of files. The error is the distance from the true positions of 100 other
configurations. A peer that cannot be installed or gives no answer in time is a row that says why.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks.peers.cases import CASES, Case, make_case, write_case
from tests.benchmarks.peers.environments import Failed, python_of, run
from tests.benchmarks.peers.table import OURS, OURS_PLAIN, Fit, Row, case_text

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Solver:
    """A row of the table: what pip installs, and the command after the interpreter."""

    name: str
    requirement: str
    command: tuple[str, ...]


SOLVERS = (
    Solver("robotkinecal", "robotkinecal==0.1.0", (str(HERE / "drive_robotkinecal.py"),)),
    Solver("figaroh", "figaroh==1.0.2", (str(HERE / "drive_figaroh.py"),)),
    Solver("pybotics-xyz", "pybotics==3.1.2", (str(HERE / "drive_pybotics.py"), "xyz")),
    Solver("pybotics-norm", "pybotics==3.1.2", (str(HERE / "drive_pybotics.py"), "norm")),
)


def main(arguments: Sequence[str]) -> None:
    """Install, run every solver on every case, print a table for each."""
    options = _options(arguments)
    chosen = [solver for solver in SOLVERS if solver.name in options.only]
    drive_cellapp = [sys.executable, "-m", "tests.benchmarks.peers.drive_cellapp"]
    programs: dict[str, list[str] | Failed] = {OURS: [*drive_cellapp, "hayati"], OURS_PLAIN: [*drive_cellapp, "dh"]}
    for solver in chosen:
        _tell(f"environment of {solver.requirement}")
        programs[solver.name] = _program(solver, options.venvs)
    texts = []
    for configurations in options.configurations:
        for name in options.cases:
            rows = _rows(name, configurations, options.seeds, programs, options.timeout)
            texts.append(case_text(name, configurations, rows))
            print(texts[-1], flush=True)  # noqa: T201
    if options.markdown:
        options.markdown.write_text("\n".join(texts), encoding="utf-8")


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    names, about = [solver.name for solver in SOLVERS], (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.peers", description=about)
    parser.add_argument("--venvs", type=Path, required=True, help="folder for the environments of the peers")
    parser.add_argument("--configurations", type=int, nargs="+", default=[100, 400])
    parser.add_argument("--seeds", type=int, default=5, help="number of drawn arms for each case")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--only", nargs="*", choices=names, default=names, help="peers to run")
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds for one fit")
    parser.add_argument("--markdown", type=Path, help="file for the tables")
    return parser.parse_args(arguments)


def _program(solver: Solver, venvs: Path) -> list[str] | Failed:
    """The command of a solver, to which folder and answer are added; or why there is none."""
    try:
        return [str(python_of(solver.requirement, venvs)), *solver.command]
    except Failed as failure:
        return Failed(f"not installed: {failure}")


def _rows(
    name: str, configurations: int, seeds: int, programs: dict[str, list[str] | Failed], timeout_s: float
) -> list[Row]:
    """All solvers on all seeds; they take turns, so that a busy machine slows all alike."""
    fits: dict[str, list[Fit]] = {solver: [] for solver in programs}
    failed: dict[str, list[str]] = {solver: [] for solver in programs}
    for seed in range(seeds):
        case = make_case(name, configurations, seed)
        with tempfile.TemporaryDirectory() as folder:
            write_case(case, Path(folder))
            for solver, program in programs.items():
                _tell(f"{name}, {configurations} configurations, seed {seed}: {solver}")
                try:
                    fits[solver].append(_fit(case, seed, program, Path(folder), timeout_s))
                except Failed as failure:
                    failed[solver].append(str(failure))
    return [Row(solver, tuple(fits[solver]), tuple(failed[solver])) for solver in programs]


def _fit(case: Case, seed: int, program: list[str] | Failed, folder: Path, timeout_s: float) -> Fit:
    """Run a solver on a written case.

    Raises
    ------
    Failed
        If it is not installed, ends with an error or not in time.
    """
    if isinstance(program, Failed):
        raise program
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    run([*program, str(folder), str(answer)], timeout_s)
    told = json.loads(answer.read_text(encoding="utf-8"))
    errors_um = 1e6 * np.linalg.norm(np.array(told.pop("p_M")) - case.p_test_M, axis=1)
    return Fit(seed=seed, mean_um=float(errors_um.mean()), largest_um=float(errors_um.max()), **told)


def _tell(progress: str) -> None:
    print(progress, file=sys.stderr, flush=True)  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
