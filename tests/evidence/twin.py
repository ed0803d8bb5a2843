"""The simulated cell of two arms, whose geometry deviates by 0.3 mm and 0.05 degrees (one standard deviation);
compliance and an eccentric encoder are hidden in the left arm (UR10), backlash in the right arm (UR5). One command
plans 400 stops, drives and measures them, calibrates, discovers, compensates new targets, drives to them and measures
how far they are missed."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cellapp.cell.run import RunFile
from cellapp.commands.stages import read_stages
from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Limit, Table

TITLE = "The simulated cell"
MOST_MM = 0.03
"""Limit of the mean error at compensated targets: the tracker's noise has 0.027 mm rms."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"twin": {}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Run the command, and read what its stages stored."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cellapp", "run", str(TWIN), "--run", f"{folder}/twin"]
        subprocess.run(command, check=False, capture_output=True)
        with RunFile.open(Path(folder) / "twin") as run:
            stored = {name: json.loads(stage.text) for name, stage in read_stages(run).current.items()}
    found = {}
    for name, arm in stored["calibrate"]["arms"].items():
        named, reached = stored["discover"]["arms"][name], stored["verify"]["arms"][name]
        errors = {stage: its["position_mm"]["mean"] for stage, its in arm["validate"].items()}
        found[name] = {
            "errors": errors | {"effects": named["heldout_position_mm"]["after"]["mean"]},
            "accepted": [effect["effect"] for effect in named["accepted"]],
            "targets": [reached[key]["mean"] for key in ("nominal_mm", "compensated_mm")],
        }
    return found


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    (arms,) = results
    stages = {"nominal": "published geometry", "geometry": "identified geometry"}
    stages |= {"network": "with the residual network", "effects": "with the effects that were found"}
    rows = [
        [title, *(f"{its['errors'][stage]:.3f} mm" if stage in its["errors"] else "" for its in arms.values())]
        for stage, title in stages.items()
    ]
    rows.append(["effects found", *(", ".join(its["accepted"]) for its in arms.values())])
    for place, title in enumerate(("new targets, uncompensated", "new targets, compensated")):
        rows.append([title, *(f"{its['targets'][place]:.3f} mm" for its in arms.values())])
    limits = [Limit(f"{name}, compensated [mm]", its["targets"][1], MOST_MM) for name, its in arms.items()]
    return Evidence(tables=[Table("", ["held-out mean position error", *arms], rows)], limits=limits)
