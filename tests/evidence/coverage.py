"""How often the stated 95 % intervals of the parameters hold the truth, of simulated arms with geometry and noise of
their own, from the same 100 stops."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from scipy.special import stdtrit

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.robot.model.nominal import nominal_arm
from tests.evidence.shared.cells import TWIN, bare, bare_stops
from tests.evidence.shared.estimates import merged_values
from tests.evidence.skeleton import Evidence, Limit, Share, Table

TITLE = "Confidence intervals"
LEAST, MOST = 0.93, 0.97
"""Limits of the share of 95 % intervals that hold the truth."""
OPTIONS = {"n": 200, "stops": 100}
"""``n``: simulated arms of each kind."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    arms = load_profile(TWIN).arms
    return {
        f"arm {arm}, seed {seed}": {"arm": arm, "seed": seed, "stops": asked.stops}
        for arm in arms
        for seed in range(asked.n)
    }


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Identify one simulated arm.

    The truth of the identified parameters is their estimate from noise-free positions of the same plant with the same
    parameter set: parameters into which others are merged have no true value of their own.
    """
    profile, arm, seed = load_profile(TWIN), case["arm"], case["seed"]
    q = bare_stops(TWIN, case["stops"])[arm]
    plant = build_plant(bare(profile, len(q), seed))
    exact = plant.smr_positions(arm, q)
    noisy, covariance = plant.measure_positions(exact, np.random.default_rng([profile.seed, 0xC0, seed]))
    start = start_from_nominal(nominal_arm(profile.arms[arm]), q, noisy, tool_unknown=False)
    estimate = identify(start, q, noisy, sigma=covariance, tolerance=1e-10)
    exactly = identify(start, q, exact, parameter_set="full", tolerance=1e-12)
    if np.abs(exactly.residuals).max() > 1e-8:
        raise ValueError(f"the model does not fit noise-free positions: {exactly.message}")
    truth = merged_values(estimate.parameter_set, exactly.geometry, start)
    limit = stdtrit(estimate.degrees_of_freedom, 0.975)
    held = np.abs(estimate.values - truth) <= limit * estimate.standard_errors
    return {"arm": arm, "held": held.tolist(), "scatter": float(estimate.scale)}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows, limits = [], []
    for arm in dict.fromkeys(found["arm"] for found in results):
        own = [found for found in results if found["arm"] == arm]
        every = [held for found in own for held in found["held"]]
        share = Share(sum(every), len(every))
        scatter = float(np.mean([found["scatter"] for found in own]))
        rows.append([arm, str(len(own)), str(share), f"{100 * share.hits / share.n:.1f} %", f"{scatter:.3f}"])
        limits.append(Limit(f"{arm}, share", share.hits / share.n, MOST, LEAST))
    columns = ["arm", "runs", "intervals that hold the truth", "share", "root of chi-square per degree of freedom"]
    return Evidence(tables=[Table("", columns, rows)], limits=limits)
