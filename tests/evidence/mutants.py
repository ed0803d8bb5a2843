"""Do the tests notice a wrong program? Mutants of what must not fail unnoticed, drawn by a seed: a comparison is
inverted, an operator of arithmetic or of logic exchanged, a constant changed (so a limit shifts), a returned value
dropped. Each stands in a copy of the tree and meets the tests of its group, which stop at the first failure; those left
when the time is up are for --resume. None exchanges < and <=: for measured values that is the same program."""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cellapp.ground.grouping import grouped
from tests.evidence.skeleton import ROOT, Evidence, Limit, Share, Table

TITLE = "Mutants"
_CALIBRATION, _DISCOVERY = "tests/estimation/calibration/test_", "tests/estimation/discovery/test_"
_RUN, _PRIOR, _DRIVING = "tests/cell/run/test_", "tests/estimation/prior/test_update.py", "tests/cell/driving/test_"
GROUPS: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {
    "gate": (
        ["cellapp/cell/safety/gate.py"],
        [
            *("tests/cell/safety", f"{_DRIVING}planned_ways.py", "tests/cell/planning/test_candidates.py"),
            *(f"{_DRIVING}driven_sweep.py", "tests/commands/test_iso9283_points.py"),
        ],
    ),
    "stop reaction": (
        ["cellapp/cell/driving/reaction.py"],
        [f"{_DRIVING}reaction.py", f"{_DRIVING}planned_ways.py", f"{_DRIVING}session.py"],
    ),
    "readers": (
        ["cellapp/cell/run/csv_import.py", "cellapp/cell/run/csv_text.py", "cellapp/estimation/readings/columns.py"],
        [
            *(f"{_RUN}csv.py", f"{_RUN}measured_again.py", f"{_RUN}recordings.py"),
            *("tests/interfaces/python", "tests/interfaces/cli/test_foreign_files.py"),
        ],
    ),
    "identification": (
        ["cellapp/estimation/calibration/identification.py", "cellapp/estimation/calibration/normal_equations.py"],
        [f"{_CALIBRATION}orientation.py", f"{_CALIBRATION}identification.py", _PRIOR, f"{_CALIBRATION}online.py"],
    ),
    "discovery's decision": (
        ["cellapp/estimation/discovery/verdict.py", "cellapp/estimation/discovery/posterior.py"],
        [
            *("tests/estimation/discovery/search", f"{_DISCOVERY}findings.py", f"{_DISCOVERY}structure.py"),
            *(f"{_DISCOVERY}propose.py", f"{_DISCOVERY}discover.py", _PRIOR),
        ],
    ),
    "decision rule": (
        ["cellapp/estimation/uncertainty/budget.py", "cellapp/commands/judgements.py"],
        [
            *("tests/estimation/uncertainty", "tests/commands/certificate", "tests/commands/test_iso9283.py"),
            *("tests/commands/test_iso9283_points.py", "tests/cell/targets/test_goals.py"),
        ],
    ),
    "exports": (
        ["cellapp/cell/exports/dh_tables.py", "cellapp/cell/exports/urdf.py"],
        [
            "tests/cell/exports/test_round_trips.py",
            "tests/commands/test_export.py",
            "tests/cell/exports/test_commands.py",
        ],
    ),
    "run file": (
        ["cellapp/cell/run/file.py", "cellapp/cell/run/sqlite_file.py"],
        [f"{_RUN}run_file.py", f"{_RUN}measured_again.py", f"{_RUN}recordings.py", "tests/commands/test_runs.py"],
    ),
}
"""Group -> modules that are changed, and the tests that run them, the quickest first: at most some 20 s a group."""
_BEGUN = time.monotonic()
_LEFT_OUT = (".git", "logs", ".mypy_cache", ".ruff_cache", ".pytest_cache")
_EXCHANGED: Mapping[type[ast.AST], type[ast.AST]] = {
    **{ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
}
OPTIONS = {"mutants": 120, "seed": 1, "seconds": 2400.0}
"""``seconds``: no mutant begins later."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """As many mutants of each group, drawn among all that its modules allow."""
    drawn = random.Random(asked.seed)
    found = dict[str, dict[str, Any]]()
    for number, (group, (modules, _)) in enumerate(GROUPS.items()):
        possible = [
            (module, place)
            for module in modules
            for place in range(len(changes(ast.parse((ROOT / module).read_text("utf-8")))))
        ]
        count = (asked.mutants + number) // len(GROUPS)
        for module, place in drawn.sample(possible, min(count, len(possible))):
            found[f"{module}, {place}"] = {"group": group, "module": module, "place": place, "seconds": asked.seconds}
    return found


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Whether the tests of the group notice a mutant."""
    if time.monotonic() - _BEGUN > case["seconds"]:
        raise TimeoutError("left out, as the time was up")
    tree = ast.parse((ROOT / case["module"]).read_text("utf-8"))
    words, node, field, value = changes(tree)[case["place"]]
    setattr(node, field, value)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(ROOT, Path(folder) / "tree", ignore=shutil.ignore_patterns(*_LEFT_OUT)))
        (copy / case["module"]).write_text(ast.unparse(tree), encoding="utf-8")
        how = ["-m", "pytest", "-x", "-q", "-n", "0", "-m", "not slow", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [sys.executable, *how, *GROUPS[case["group"]][1]],
            cwd=copy, env={**os.environ, "PYTHONPATH": str(copy)}, capture_output=True, text=True, check=False,
        )  # fmt: skip
    if done.returncode not in (0, 1, 2):  # 2: not even collected; 4: a file of tests is gone
        raise RuntimeError(done.stdout[-500:] + done.stderr[-500:])
    return {"group": case["group"], "what": f"{case['module']}:{words}", "noticed": done.returncode != 0}


def changes(tree: ast.Module) -> list[tuple[str, ast.AST, str, object]]:
    """All mutants: words, node, field and its new value. None in declarations, docstrings and messages."""
    return list(_changes(tree))


def _changes(tree: ast.Module) -> Iterator[tuple[str, ast.AST, str, object]]:
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    seen = set[int]()
    for node in (inner for function in functions for statement in function.body for inner in ast.walk(statement)):
        if id(node) in seen or isinstance(node, ast.Raise | ast.JoinedStr):
            seen |= {id(inner) for inner in ast.walk(node)}
            continue
        seen.add(id(node))
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.Compare) and type(node.ops[0]) in _EXCHANGED:
            new = _EXCHANGED[type(node.ops[0])]()
            yield f"{line}: {ast.unparse(node)} by {type(new).__name__}", node, "ops", [new, *node.ops[1:]]
        elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in _EXCHANGED and not _is_text(node):
            new = _EXCHANGED[type(node.op)]()
            yield f"{line}: {ast.unparse(node)} by {type(new).__name__}", node, "op", new
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            value = not node.value if isinstance(node.value, bool) else node.value + 1
            yield f"{line}: {node.value} becomes {value}", node, "value", value
        elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
            yield f"{line}: {ast.unparse(node)} becomes None", node, "value", ast.Constant(None)


def _is_text(node: ast.AST) -> bool:
    return any(isinstance(one, ast.JoinedStr) or isinstance(getattr(one, "value", 0), str) for one in ast.walk(node))


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    """Share noticed by group; what was not noticed, by its line."""
    shares = {name: Share.of(its) for name, its in grouped((one["group"], one["noticed"]) for one in results).items()}
    together = Share.of(one["noticed"] for one in results)
    missed = [one["what"] for one in results if not one["noticed"]]
    said = [f"Not noticed: {'; '.join(missed)}."] if missed else []
    rows = [[name, str(share)] for name, share in (*shares.items(), ("together", together))]
    limit = Limit("share noticed", together.hits / max(together.n, 1), least=0.85)
    return Evidence({"noticed": str(together)}, [Table("", ["group", "noticed"], rows)], [limit], said)
