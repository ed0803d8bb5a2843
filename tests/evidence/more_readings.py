"""More readings never make it worse: mean held-out errors over the number of readings to learn from, of real robots
(all other rows are held out) and of simulated arms with hidden effects (500 configurations are held out). The search
takes 400 readings at most; its terms are then fitted to all. The standard error is that of the mean over the draws."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import ArmReadings, measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.readings import Readings
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from tests.evidence.shared.cells import TWIN, bare_stops, measured_by, sampled_cell
from tests.evidence.shared.series import load_entrant, sample_rows
from tests.evidence.skeleton import Evidence, Limit, Table

TITLE = "Error over the number of readings"
_LEAST_HELD_OUT, _HELD_OUT_OF_TWIN = 100, 500
_PLANNED = 60
"""Stops of the plan whose ranges of joints the simulated configurations have."""
_MOST_RISE = 3.0
"""Standard errors by which the mean error may be above that of fewer readings."""
OPTIONS = {
    "series": "C,D,UR5",
    "rows": "100,200,300,400,401,500,700,1000,1700",
    "stops": "100,400,401,1600,5000",
    "seeds": 3,
}
"""``stops``: of the simulated arms."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    found = dict[str, dict[str, Any]]()
    seeds = range(asked.seeds)
    for series in filter(None, asked.series.split(",")):
        most = len(load_entrant(series).pool) - _LEAST_HELD_OUT
        for n in (int(word) for word in asked.rows.split(",") if int(word) <= most):
            found |= {f"{series}, {n}, {seed}": {"series": series, "n": n, "seed": seed} for seed in seeds}
    for arm in load_profile(TWIN).arms:
        for n in (int(word) for word in asked.stops.split(",") if word):
            name = f"twin {arm}"
            found |= {f"{name}, {n}, {seed}": {"series": name, "arm": arm, "n": n, "seed": seed} for seed in seeds}
    return found


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Learn from the drawn readings; judge geometry and discovery by the held-out ones."""
    profile, name, readings = _simulated(case) if "arm" in case else _of_series(case)
    conditions = measurement_conditions(readings)
    began = time.process_time()
    geometry = calibrate_arm(profile, name, readings)[0].model
    found = discover_arm(ArmReadings(profile, name, geometry, readings, conditions))
    seconds = time.process_time() - began
    rows = readings.in_split("validate")
    p_M, q, then = readings.p_M[rows], readings.q[rows], conditions.take(rows)
    errors = [np.linalg.norm(p_M - model.predict(q, conditions=then), axis=1) for model in (geometry, found.model)]
    return {
        **{"series": case["series"], "n": case["n"], "seconds": seconds},
        "mm": [1e3 * float(error.mean()) for error in errors],
        "names": sorted({effect.effect for effect in found.result.accepted}),
    }


def _of_series(case: dict[str, Any]) -> tuple[Profile, str, Readings]:
    entrant = load_entrant(case["series"])
    profile = entrant.profile.model_copy(update={"seed": case["seed"]})
    return profile, entrant.arm, sample_rows(entrant, case["n"], case["seed"]).split(entrant.readings)


def _simulated(case: dict[str, Any]) -> tuple[Profile, str, Readings]:
    profile = sampled_cell(load_profile(TWIN), case["seed"])
    generator, count = np.random.default_rng([case["seed"], case["n"]]), case["n"] + _HELD_OUT_OF_TWIN
    plan = {
        arm: generator.uniform(q.min(axis=0), q.max(axis=0), (count, q.shape[1]))
        for arm, q in bare_stops(TWIN, _PLANNED).items()
    }
    readings = measured_by(build_plant(profile), home_positions(profile), plan, case["seed"])[case["arm"]]
    split = ("identify",) * case["n"] + ("validate",) * _HELD_OUT_OF_TWIN
    return profile, case["arm"], replace(readings, split=split)


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows, limits, lost = list[list[str]](), list[Limit](), 0
    for series, its in grouped((one["series"], one) for one in results).items():
        sizes = grouped((one["n"], one) for one in its)
        before = None
        for n, draws in sizes.items():
            (geometry, mean), error = _mean([one["mm"] for one in draws]), _standard_error(draws)
            common = set.intersection(*(set(one["names"]) for one in draws))
            seconds = f"{np.median([one['seconds'] for one in draws]):.1f} s"
            rows.append([series, str(n), str(len(draws)), f"{geometry:.4f}", f"**{mean:.4f}** ± {error:.4f}"])
            rows[-1] += [", ".join(sorted(common)) or "none", seconds]
            if before is not None:
                spread = math.hypot(error, before[1])
                limits.append(Limit(f"{series}, {n}: rise [standard errors]", (mean - before[0]) / spread, _MOST_RISE))
            before = (mean, error)
            for other in (size for size in sizes if size >= 4 * n):
                lost += len(common - {name for one in sizes[other] for name in one["names"]})
    limits.append(Limit("names found at n in every draw and at 4 n or more in none", lost, 0))
    columns = ["series", "n", "draws", "geometry [mm]", "discovered [mm]", "named in every draw", "processor time"]
    return Evidence(tables=[Table("", columns, rows)], limits=limits)


def _mean(errors: Sequence[Sequence[float]]) -> tuple[float, float]:
    geometry, discovered = np.mean(errors, axis=0)
    return float(geometry), float(discovered)


def _standard_error(draws: Sequence[dict[str, Any]]) -> float:
    """Return the standard error of the mean discovered error; at least a hundredth of it, as three draws may agree."""
    errors = np.array([one["mm"][1] for one in draws])
    own = float(errors.std(ddof=1)) / math.sqrt(len(errors)) if len(errors) > 1 else 0.0
    return max(own, 0.01 * float(errors.mean()))
