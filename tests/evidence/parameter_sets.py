"""Redundant against reduced parameter sets, as in Bai et al., ROBOT 45(3), 2023, from 100 stops of simulated arms.
*plain* is the paper's solver: unscaled Gauss-Newton least squares, at most 1000 iterations; its steps along
unobservable directions of the redundant model never end. *cellapp* takes the minimum-norm step there. Medians over the
seeds."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.estimation.calibration.parameters import ParameterSet, auto_set, full_set, paper_set
from cellapp.estimation.calibration.quantities import position_errors, summarise
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import nominal_arm
from tests.evidence.shared.cells import TWIN, bare, bare_stops
from tests.evidence.skeleton import Evidence, Table

TITLE = "Redundant and reduced model"
TOLERANCE, ITERATIONS = 1e-5, 1000
"""Of the paper's solver."""
STOPS = 100
"""Stops to identify from, and as many to validate."""
OPTIONS = {"seeds": 5}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    arms = load_profile(TWIN).arms
    return {f"{arm}, seed {seed}": {"arm": arm, "seed": seed} for arm in arms for seed in range(asked.seeds)}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Run both solvers on all parameter sets, for one arm and seed."""
    arm, seed, profile = case["arm"], case["seed"], load_profile(TWIN)
    nominal, q = nominal_arm(profile.arms[arm]), bare_stops(TWIN, 2 * STOPS)[arm]
    plant = build_plant(bare(profile, 2 * STOPS, seed))
    noisy, _ = plant.measure_positions(plant.smr_positions(arm, q), np.random.default_rng([profile.seed, seed]))
    start = start_from_nominal(nominal, q[:STOPS], noisy[:STOPS], tool_unknown=False)
    found = []
    for chosen in (full_set(start), paper_set(start), auto_set(start, q[:STOPS])):
        for solver, geometry, iterations, converged in _both_solvers(start, q[:STOPS], noisy[:STOPS], chosen):
            error = summarise(position_errors(noisy[STOPS:], smr_positions(geometry, q[STOPS:])))
            name = f"{chosen.name} ({len(chosen.columns)}), {solver}"
            found.append([name, iterations, converged, error.mean, error.max])
    return {"arm": arm, "solutions": found}


def _both_solvers(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> list[tuple[str, Geometry, int, bool]]:
    """Return for each solver its name, its geometry, the iterations, and whether it converged."""
    ours = identify(start, q, p_M, parameter_set=chosen, tolerance=TOLERANCE, max_iterations=ITERATIONS)
    return [
        ("plain", *plain_gauss_newton(start, q, p_M, chosen)),
        ("cellapp", ours.geometry, ours.iterations, ours.converged),
    ]


def plain_gauss_newton(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> tuple[Geometry, int, bool]:
    """Iterate as in the paper, without regularisation of dependent columns.

    Returns the last finite geometry, the iterations and whether it converged.
    """
    geometry, turns, measured = start, JointAngles.of(q), p_M.T
    columns = list(chosen.columns)
    for iteration in range(1, ITERATIONS + 1):
        P, J = jacobian(geometry, turns, chosen.columns)
        rows = J.transpose(0, 2, 1).reshape(-1, len(columns))
        step = np.linalg.lstsq(rows, (measured - P).ravel(), rcond=-1.0)[0]
        vector = geometry.vector()
        vector[columns] += step
        if not np.isfinite(vector).all():
            return geometry, iteration, False
        geometry = geometry.with_vector(vector)
        if np.linalg.norm(step) < TOLERANCE:
            return geometry, iteration, True
    return geometry, ITERATIONS, False


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    groups = grouped(((its["arm"], name), rest) for its in results for name, *rest in its["solutions"])
    rows = []
    for (arm, name), some in groups.items():
        iterations, converged, mean_mm, max_mm = zip(*some, strict=True)
        rows.append(
            [
                *(arm, name, f"{np.median(iterations):g}", f"{sum(converged)} of {len(some)}"),
                *(f"{np.median(mean_mm):.4g}", f"{np.median(max_mm):.4g}"),
            ]
        )
    columns = ["arm", "set (parameters), solver", "iterations", "converged", "mean error [mm]", "largest [mm]"]
    return Evidence(tables=[Table("", columns, rows)])
