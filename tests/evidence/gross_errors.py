"""What wrong readings cost: 1, 3 or 5 % are moved by one length in random directions, or exchanged between stops. The
table has the mean held-out error of the good readings over that from clean readings, the largest of the three shares;
400 readings of each real series, 300 of each simulated arm, a quarter held out."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import position_errors
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.model import ArmModel
from tests.evidence.shared.cells import TWIN, measured_plan, sampled_cell
from tests.evidence.shared.series import load_entrant
from tests.evidence.skeleton import Evidence, Limit, Table
from tests.twin import altered

TITLE = "Gross errors"
MOST = 1.03
"""Limit of the error over that from clean readings."""
SHARES = (0.01, 0.03, 0.05)
KINDS: tuple[float | str, ...] = (3e-4, 1e-3, 1e-2, 1e-1, 1.0, "swapped")
"""Lengths of gross errors [m], and exchanged stops."""
_ROWS = 400
"""Readings drawn of a measured series."""
_STOPS = 300
"""Stops of a simulated cell."""


@dataclass(frozen=True)
class Arm:
    """Clean readings of one arm: a fourth held out."""

    name: str
    profile: Profile
    arm: str
    readings: Readings


def disturbed(
    readings: Readings, share: float, kind: float | str, rng: np.random.Generator
) -> tuple[Readings, NDArray[np.intp]]:
    """The readings with gross errors in a share of their rows, and these rows."""
    rows = rng.permutation(len(readings))[: max(2, round(share * len(readings)))]
    p_M = readings.p_M.copy()
    if isinstance(kind, str):
        rows = rows[: len(rows) // 2 * 2]
        p_M[rows] = p_M[rows.reshape(-1, 2)[:, ::-1].ravel()]
    else:
        direction = rng.standard_normal((len(rows), 3))
        p_M[rows] += kind * direction / np.linalg.norm(direction, axis=1)[:, np.newaxis]
    return replace(readings, p_M=p_M), rows


def with_splits(readings: Readings) -> Readings:
    """A fourth held out, the others to identify."""
    words = ("identify" if row % 4 else "validate" for row in range(len(readings)))
    return replace(readings, split=tuple(words))


def arms(seed: int) -> Iterator[Arm]:
    """Every series and every arm of a simulated cell, drawn by ``seed``."""
    for name in ("C", "D", "UR5"):
        entrant = load_entrant(name)
        order = np.random.default_rng([seed, 0x6055]).permutation(len(entrant.readings))[:_ROWS]
        yield Arm(name, entrant.profile, entrant.arm, with_splits(entrant.readings.take(order)))
    profile = sampled_cell(load_profile(TWIN), seed)
    planned = altered(profile, plan={"stops": _STOPS})
    for name, readings in measured_plan(planned, plan_stops(planned), seed).items():
        yield Arm(f"twin {name}", profile, name, with_splits(readings))


def calibrated(arm: Arm, readings: Readings) -> tuple[ArmModel, tuple[int, ...]]:
    """The calibrated arm, and the configurations that were left out."""
    found, _ = calibrate_arm(arm.profile, arm.arm, readings)
    return found.model, found.left_out


OPTIONS = {"seeds": 1}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {f"seed {seed}": {"seed": seed} for seed in range(asked.seeds)}


def one(case: dict[str, Any]) -> dict[str, Any]:
    ratios: dict[str, dict[str, list[float]]] = {}
    left_out = readings = 0
    for arm in arms(case["seed"]):
        plain, without = calibrated(arm, arm.readings)
        readings, left_out = readings + len(arm.readings), left_out + len(without)
        for number, kind in enumerate(KINDS):
            for share in SHARES:
                rng = np.random.default_rng([case["seed"], number, round(1e3 * share)])
                spoilt, rows = disturbed(arm.readings, share, kind, rng)
                good = np.setdiff1d(arm.readings.in_split("validate"), rows)
                q, p_M = arm.readings.q[good], arm.readings.p_M[good]
                models = calibrated(arm, spoilt)[0], plain
                errors = [float(position_errors(p_M, model.predict(q)).mean()) for model in models]
                ratios.setdefault(arm.name, {}).setdefault(str(kind), []).append(errors[0] / errors[1])
    return {"ratios": ratios, "readings": readings, "left_out": left_out}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows, worst = [], 0.0
    for name in results[0]["ratios"]:
        largest = [max(max(its["ratios"][name][str(kind)]) for its in results) for kind in KINDS]
        rows.append([name, *(f"{value:.3f}" for value in largest)])
        worst = max(worst, *largest)
    left_out, readings = (sum(its[key] for its in results) for key in ("left_out", "readings"))
    said = f"{left_out} of {readings} clean readings left out."
    columns = ["readings", *(kind if isinstance(kind, str) else f"{1e3 * kind:g} mm" for kind in KINDS)]
    return Evidence({}, [Table("", columns, rows)], [Limit("largest ratio", worst, MOST)], [said])
