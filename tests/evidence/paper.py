"""The comparison of Bai et al., ROBOT 45(3), 2023. Every seed is another simulated cell, with joint compliance so large
that geometry alone ends near the paper's 0.23 mm between the arms."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.calibrate import calibrate_readings
from tests.evidence.shared.cells import measured_plan, sampled_cell
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table

TITLE = "The paper's comparison"
PROFILE = ROOT / "profiles" / "twin-paper.yaml"
METHODS = {
    "nominal": ("published geometry", ""),
    "method_1": ("method 1, geometry", "0.232 mm"),
    "method_2": ("method 2, network in the tracker frame", "0.467 mm"),
    "proposed": ("proposed, network in the base frame", "0.168 mm"),
}
"""Method -> its name, and its mean cooperative error in the paper."""
PAPER_GAIN = 0.277
"""Share of method 1's error that the paper's proposed method removes."""
OPTIONS = {"seeds": 10}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {f"seed {seed}": {"seed": seed} for seed in range(asked.seeds)}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Run the comparison for one seed."""
    seed = case["seed"]
    profile = sampled_cell(load_profile(PROFILE), seed)
    plan = plan_stops(profile)
    calibration = calibrate_readings(profile, measured_plan(profile, plan, seed))
    assert calibration.pair is not None, calibration.notes
    methods = calibration.pair.methods
    cooperative = {
        name: methods[name if name in methods else "method_1"].by_transform_mm["distances"].mean  # type: ignore[index]
        for name in METHODS
    }
    return {"cooperative_mm": cooperative}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows = []
    for method, (name, paper) in METHODS.items():
        values = [its["cooperative_mm"][method] for its in results]
        rows.append([name, f"{np.median(values):.3f} mm", f"{max(values):.3f} mm", paper])
    gains = [1.0 - its["cooperative_mm"]["proposed"] / its["cooperative_mm"]["method_1"] for its in results]
    rows.append(
        ["proposed below method 1", *(f"{100 * share:.0f} %" for share in (np.median(gains), min(gains), PAPER_GAIN))]
    )
    columns = [f"mean cooperative error of {len(results)} cells", "median", "worst", "paper"]
    proposed = float(np.median([its["cooperative_mm"]["proposed"] for its in results]))
    limits = [Limit("proposed method [mm]", proposed, 0.168), Limit("gain, worst cell", min(gains), least=PAPER_GAIN)]
    return Evidence(tables=[Table("", columns, rows)], limits=limits)
