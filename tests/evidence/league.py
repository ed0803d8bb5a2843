"""Real robots that others measured: series C and D, one UR10 four months apart (Landgraf et al., CASE 2021), and a UR5
(Jacobi 2025); sources and MIT licences are in `tests/fixtures`. Rows to learn from are drawn by seed, the others are
held out; base and tool are not given, approach and step follow from the order of the rows. Errors are means over the
draws. Published for the UR5: 0.155 mm at the 20 random poses, from all 1000 poses on the grid."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.least_squares import NORMAL_95
from cellapp.estimation.calibration.network_training import learn
from cellapp.estimation.calibration.quantities import ArmReadings, measured_quantities, measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.readings import Readings
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, ResidualNetwork
from tests.evidence.shared.series import load_entrant, sample_rows
from tests.evidence.skeleton import Evidence, Limit, Table

TITLE = "Real robots"
MOST_MM = {"C": 0.083, "D": 0.091, "UR5": 0.053, "D6": 0.100}
MOST_MRAD = 0.225
"""Limits of the mean held-out errors from 300 rows."""
MOST_ABOVE_MEAN, WITHIN_95 = 1.15, (0.93, 0.97)
"""Limits of the worst draw over the mean, and of the share of coordinates within the stated 95 % intervals."""
REFERENCE_MM = {"C": "0.092", "D": "0.102", "UR5": "0.053"}
"""A structured Gaussian process as a plain reference, 300 rows, mean of two draws."""
OPTIONS = {"series": "C,D,UR5", "rows": "300", "seeds": 8, "first": 0}
"""``rows``: numbers of rows to learn from, or all."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {
        f"{series}, {rows} rows, seed {seed}": {
            "series": series,
            "rows": rows if rows == "all" else int(rows),
            "seed": seed,
        }
        for series in asked.series.split(",")
        for rows in asked.rows.split(",")
        for seed in range(asked.first, asked.first + asked.seeds)
    }


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Learn from the drawn rows, and judge geometry and discovery by the held-out ones."""
    entrant = load_entrant(case["series"])
    drawn = sample_rows(entrant, case["rows"], case["seed"])
    profile = entrant.profile.model_copy(update={"seed": case["seed"]})
    readings = drawn.split(entrant.readings)
    conditions = measurement_conditions(readings)
    geometry = calibrate_arm(profile, entrant.arm, readings)[0].model
    began = time.process_time()
    found = discover_arm(ArmReadings(profile, entrant.arm, geometry, readings, conditions))
    seconds = time.process_time() - began
    models = (geometry, found.model, replace(geometry, network=_network(profile, geometry, readings, conditions)))
    left = [readings.p_M - model.predict(readings.q, conditions=conditions) for model in models]
    unnamed = found.result.unnamed
    sd = found.model.measured_uncertainty(readings.q, conditions)
    return {
        **{"series": case["series"], "rows": len(drawn.learned), "seconds": seconds},
        "names_alone_mm": None
        if unnamed is None or unnamed.heldout_position_mm is None
        else unnamed.heldout_position_mm.before.mean,
        "names": [effect.effect for effect in found.result.accepted],
        "groups": {
            group: {
                "held_out": len(some),
                "mm": [1e3 * float(np.linalg.norm(off[some], axis=1).mean()) for off in left],
                "within": float(np.mean(np.abs(left[1][some]) <= NORMAL_95 * sd[some, np.newaxis])),
                "turned": _rotated(readings.take(some), conditions.take(some), geometry, found.model),
            }
            for group, some in drawn.held_out.items()
        },
    }


def _network(
    profile: Profile, geometry: ArmModel, readings: Readings, conditions: MeasurementConditions
) -> ResidualNetwork | None:
    """The residual network of the geometry; None where it predicts left-out readings no better."""
    rows = readings.in_split("identify")
    residual_M = (readings.p_M - geometry.predict(readings.q, conditions=conditions))[rows]
    q, time_s = readings.q[rows], readings.time_s[rows]
    residual_B = residual_M @ geometry.geometry.T_M_B()[:3, :3]
    return learn(profile.network, q, residual_B, time_s, seed=profile.seed).network


def _rotated(
    readings: Readings, conditions: MeasurementConditions, geometry: ArmModel, discovery: ArmModel
) -> list[float] | None:
    """Mean errors of orientations [mrad] by geometry and discovery, and the share within the stated 95 %."""
    its = measured_quantities(readings, conditions)
    if its.angular is None:
        return None
    rows = np.flatnonzero(its.angular)
    q, then = its.readings.q[rows], its.conditions.take(rows)
    off: list[Array] = [model.predict(q, conditions=then) for model in (geometry, discovery)]
    within = float(np.mean(np.abs(off[1]) <= NORMAL_95 * discovery.measured_uncertainty(q, then)[:, np.newaxis]))
    return [*(1e3 * float(np.linalg.norm(one, axis=1).mean()) for one in off), within]


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    errors, names, limits = list[list[str]](), list[list[str]](), list[Limit]()
    figures = dict[str, str]()
    for (series, rows), draws in grouped(((its["series"], its["rows"]), its) for its in results).items():
        for group in draws[0]["groups"]:
            own = [its["groups"][group] for its in draws]
            geometry, discovery, network = np.mean([its["mm"] for its in own], axis=0)
            worst = max(its["mm"][1] for its in own) / discovery
            within = float(np.average([its["within"] for its in own], weights=[its["held_out"] for its in own]))
            alone = [its["names_alone_mm"] or its["groups"][group]["mm"][1] for its in draws]
            by_names = f"{np.mean(alone):.4f} mm" if group == "all" else ""
            errors.append(
                [
                    *(
                        series,
                        str(rows),
                        f"{own[0]['held_out']} {group}",
                        str(len(own)),
                        f"{geometry:.3f} mm",
                        f"{network:.3f} mm",
                        by_names,
                    ),
                    *(f"**{discovery:.4f} mm**", REFERENCE_MM.get(series, "") if group == "all" else ""),
                    *(f"{worst:.2f}", f"{100 * within:.1f} %", f"{np.median([its['seconds'] for its in draws]):.1f}"),
                ]
            )
            if rows == 300:
                figures |= {f"{series}_{group}_geometry": f"{geometry:.3f}", f"{series}_{group}": f"{discovery:.3f}"}
            if group == "all" and rows == 300:
                limits.append(Limit(f"{series}, held-out error [mm]", float(discovery), MOST_MM[series]))
                limits.append(Limit(f"{series}, within 95 %", within, WITHIN_95[1], WITHIN_95[0]))
                if len(own) > 1:
                    limits.append(Limit(f"{series}, worst draw over mean", float(worst), MOST_ABOVE_MEAN))
            if own[0]["turned"] is not None:
                rotated = np.mean([its["turned"] for its in own], axis=0)
                errors[-1][4] += f", {rotated[0]:.3f} mrad"
                errors[-1][7] += f", {rotated[1]:.3f} mrad"
                if rows == 300:
                    limits.append(Limit(f"{series}, orientation error [mrad]", float(rotated[1]), MOST_MRAD))
        counts = Counter(name for its in draws for name in dict.fromkeys(its["names"]))
        seconds = [its["seconds"] for its in draws]
        found_names = ", ".join(f"{name} {count}" for name, count in counts.most_common()) or "none"
        names.append([series, str(rows), f"{np.median(seconds):.1f} s, {max(seconds):.1f} s", found_names])
    columns = ["series", "rows", "held out", "draws", "identified geometry", "residual network", "names alone"]
    columns += ["names and unnamed", "reference", "worst draw over mean"]
    columns += ["within the stated 95 %", "seconds"]
    of_names = ["series", "rows", "processor time of discovery: median, longest", "names and in how many draws"]
    return Evidence(figures, [Table("", columns, errors), Table("", of_names, names)], limits)
