"""How well is the pose of one flange in the other's frame known, where both have a 6-D probe? Simulated cells:
120 stops are measured, effects are discovered, and the model is judged at 100 stops of another plan."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.prediction import Predicted, predicted_relative, predicted_rotations, predictions
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.estimation.calibration.calibrate import calibrate_readings
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.robot.kinematics.transforms import rotation_vectors, rotations_of
from tests.evidence.shared.cells import TWIN, measured_plan, sampled_cell
from tests.evidence.skeleton import Evidence, Limit, Share, Table
from tests.sure import sure
from tests.twin import altered

TITLE = "Two arms with probes"
MOST_TIMES, LEAST, MOST = 1.2, 0.93, 0.97
"""Limits: rms angle over what both probes alone would show, and share of the stated 95 % bounds that hold."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {f"seed {seed}": {"seed": seed} for seed in range(1, 11)}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Learn one cell; compare the computed with the measured pose of the right flange seen from the left one."""
    profile = sampled_cell(load_profile(TWIN.with_name("twin-6d.yaml")), seed := case["seed"])
    profile = altered(profile, network={"kind": "none"})
    readings = measured_plan(profile, plan_stops(profile), seed)
    models = discover_cell(profile, calibrate_readings(profile, readings).model, readings).model.arms
    another = {"seed": seed + 1000, "plan": profile.plan.model_copy(update={"stops": 100})}
    judged = measured_plan(profile, plan_stops(profile.model_copy(update=another)), seed + 1000)
    conditions, none = conditions_of_arms(models, judged), [None] * 100
    sides, poses, variances = [], [], []
    for name, home in home_positions(profile).items():
        arm, its, here = models[name], judged[name], conditions[name]
        variances.append(np.mean(sure(its.sigma_rad) ** 2))
        ranges = ConditionRanges.of(readings[name], arm)
        positions = predictions(arm, its.q, here, none, home, ranges)
        rotations = predicted_rotations(arm, its.q, its.q, here, np.full((100, 3, 3), np.nan), none, home, ranges)
        sides.append(Predicted(arm, its.q, here, home, positions, rotations))
        computed = arm.predict(its.q, conditions=here), arm.orientation(its.q, here)
        poses.append(((its.p_M, rotations_of(sure(its.quaternion_M))), computed))
    (seen, rotated), (wanted, computed) = (
        (np.einsum("nji,nj->ni", R_1, p_2 - p_1), R_1.swapaxes(1, 2) @ R_2)
        for (p_1, R_1), (p_2, R_2) in zip(*poses, strict=True)
    )
    bounds: Any = predicted_relative(sides[0], sides[1], none, none)
    mm = 1e3 * np.linalg.norm(seen - wanted, axis=1)
    mrad = 1e3 * np.linalg.norm(rotation_vectors(rotated @ computed.swapaxes(1, 2)), axis=1)
    return {
        "floor_mrad": 1e3 * float(np.sqrt(3.0 * sum(variances))),
        "rms_mrad": float(np.sqrt(np.mean(mrad**2))),
        "rms_mm": float(np.sqrt(np.mean(mm**2))),
        "held_mm": (mm <= [bound.within_mm for bound in bounds]).tolist(),
        "held_mrad": (mrad <= [bound.within_mrad for bound in bounds]).tolist(),
    }


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    floor = float(np.mean([one["floor_mrad"] for one in results]))
    times = [one["rms_mrad"] / one["floor_mrad"] for one in results]
    off = [one["rms_mm"] for one in results]
    own = f"rms angle, in multiples of the {floor:.4f} mrad that two probes show of themselves"
    rows = [[own, f"{np.median(times):.2f}", f"{max(times):.2f}"]]
    rows.append(["rms vector from one SMR to the other [mm]", f"{np.median(off):.4f}", f"{max(off):.4f}"])
    limits = [Limit("rms angle over the probes' own, worst", max(times), MOST_TIMES)]
    for key in ("mm", "mrad"):
        share = Share.of(held for one in results for held in one[f"held_{key}"])
        rows.append([f"within the stated 95 % bound in {key}", str(share), ""])
        limits.append(Limit(f"share within the bound in {key}", share.hits / share.n, MOST, LEAST))
    return Evidence({}, [Table("", ["at held-out stops", "median", "worst"], rows)], limits)
