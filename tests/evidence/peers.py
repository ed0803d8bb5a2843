"""Three public Python libraries and cellapp solve the same problems, each in an environment of its own, on one thread:
a UR10 whose D-H values are off by 0.3 mm and 0.1 degrees, SMR and base unknown, points with 15 µm of noise a
coordinate. The error is that at 100 other configurations, the time that of the solver alone. Case *mdh*: the modified
D-H rows that pybotics has; *hayati*: besides, parallel axes are turned by 0.1 degrees against each other, as in every
real UR arm, which D-H rows (*cellapp-dh*, pybotics) cannot hold. pybotics is measured with its own residual, the
distance (*norm*), and with coordinates (*xyz*). Where the model is equal, accuracy is. What cellapp lacks: figaroh
takes cameras, any URDF and masses from motion; screw axes (robotkinecal) need no exception for parallel axes."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from cellapp.ground.grouping import grouped
from tests.evidence.peering.cases import CASES, Case, make_case, write_case
from tests.evidence.peering.environments import Failed, python_of, run
from tests.evidence.peering.table import COLUMNS, OURS, OURS_PLAIN, Fit, Row, lines_of
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table

TITLE = "Other libraries"
ALONE = True
HERE = Path(__file__).parent / "peering"
SOLVERS = {
    OURS: ("", "hayati"),
    OURS_PLAIN: ("", "dh"),
    "robotkinecal": ("robotkinecal==0.1.0", ""),
    "figaroh": ("figaroh==1.0.2", ""),
    "pybotics-xyz": ("pybotics==3.1.2", "xyz"),
    "pybotics-norm": ("pybotics==3.1.2", "norm"),
}
"""Solver -> what pip installs, and the argument of its driver."""
MOST_LSTSQ, LEAST_FASTER = 5.0, 400.0
"""Limits at 400 configurations: cellapp's time over one ``lstsq``; the fastest other library's over cellapp's."""
OPTIONS = {"venvs": str(ROOT / "logs" / "peers"), "configurations": "400", "seeds": 5, "only": ",".join(SOLVERS)}
"""``venvs``: folder for the environments, made by plain pip."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {
        f"{case}, {n} configurations, seed {seed}, {solver}": {
            "case": case, "n": n, "seed": seed, "solver": solver, "venvs": asked.venvs
        }
        for n in map(int, asked.configurations.split(","))
        for case in CASES
        for seed in range(asked.seeds)
        for solver in asked.only.split(",")
    }  # fmt: skip


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Let one solver solve one problem; a library that cannot is a line that says why."""
    problem, found = make_case(case["case"], case["n"], case["seed"]), dict(case)
    with tempfile.TemporaryDirectory() as folder:
        write_case(problem, Path(folder))
        try:
            return found | {"fit": _fit(problem, case, Path(folder))}
        except Failed as failure:
            return found | {"failed": str(failure)}


def _fit(problem: Case, case: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run a solver on a written case. Raises ``Failed`` if it is not installed, fails, or takes too long."""
    requirement, argument = SOLVERS[case["solver"]]
    if requirement:
        script = HERE / f"drive_{requirement.partition('=')[0]}.py"
        program = [str(python_of(requirement, Path(case["venvs"]))), str(script)]
    else:
        program = [sys.executable, "-m", "tests.evidence.peering.drive_cellapp"]
    answer = folder / "answer.json"
    run([*program, *([argument] if argument else []), str(folder), str(answer)], 600.0)
    told = json.loads(answer.read_text(encoding="utf-8"))
    errors_um = 1e6 * np.linalg.norm(np.array(told.pop("p_M")) - problem.p_test_M, axis=1)
    return {"seed": case["seed"], "mean_um": float(errors_um.mean()), "largest_um": float(errors_um.max()), **told}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    tables, limits = [], []
    for (name, n), some in grouped(((its["case"], its["n"]), its) for its in results).items():
        rows = [
            Row(
                solver,
                tuple(Fit(**its["fit"]) for its in own if "fit" in its),
                tuple(its["failed"] for its in own if "failed" in its),
            )
            for solver, own in grouped((its["solver"], its) for its in some).items()
        ]
        tables.append(Table(f"Case {name}, {n} configurations", COLUMNS, lines_of(rows, n)))
        by_name = {row.solver: row for row in rows if row.fits}
        others = [row for row in by_name.values() if row.solver not in (OURS, OURS_PLAIN)]
        if OURS in by_name and others and n == 400:
            ours = by_name[OURS]
            lstsq = float(np.median([fit.seconds / fit.floor_s for fit in ours.fits if fit.floor_s]))
            faster = min(row.seconds for row in others) / ours.seconds
            limits.append(Limit(f"{name}, over lstsq", lstsq, MOST_LSTSQ))
            limits.append(Limit(f"{name}, fastest other over cellapp", faster, least=LEAST_FASTER))
    return Evidence(tables=tables, limits=limits)
