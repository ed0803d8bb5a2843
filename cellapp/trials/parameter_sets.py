"""Redundant against reduced parameter sets, as in Bai et al., ROBOT 45(3), 2023: iterations, mean and maximum error.

Two solvers are compared. ``plain`` is the paper's: unscaled Gauss-Newton least squares without regularisation, stopped
at |dg| < 1e-5 or after 1000 iterations; on the redundant model its steps along unobservable directions do not end.
``cellapp`` is this program's, which takes the minimum-norm step where the normal matrix is singular.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellapp.calibration.evaluation import position_errors, summarise
from cellapp.calibration.identification import identify, start_from_nominal
from cellapp.calibration.parameters import ParameterSet, auto_set, full_set, paper_set
from cellapp.collection.cell import build_plant
from cellapp.kinematics.chain import Geometry, JointAngles, jacobian, smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model.nominal import nominal_arm
from cellapp.planning.plan import plan_stops
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Record, Result
from cellapp.trials.coverage import bare_profile

PAPER_TOLERANCE = 1e-5
PAPER_ITERATIONS = 1000
"""The paper's stopping rule."""


class ParameterSetTrial(Record):
    """One parameter set with one solver: medians over seeds, and how often it converged."""

    parameter_set: str
    solver: str
    parameters: int
    iterations: float
    converged: int
    seeds: int
    mean_mm: float
    max_mm: float


class ParameterSetsResult(Result):
    """``trials parameter-sets``: every arm with every parameter set and solver."""

    schema_: Literal["cellapp-trials-parameter-sets"] = "cellapp-trials-parameter-sets"
    version: Literal[1] = 1
    arms: Mapping[str, tuple[ParameterSetTrial, ...]]


def plain_gauss_newton(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> tuple[Geometry, int, bool]:
    """The paper's iteration, without regularisation of dependent columns, until |dg| < 1e-5.

    Returns the last finite geometry, the iterations and whether it converged.
    """
    geometry, turns, measured = start, JointAngles.of(q), p_M.T
    columns = list(chosen.columns)
    for iteration in range(1, PAPER_ITERATIONS + 1):
        P, J = jacobian(geometry, turns, chosen.columns)
        rows = J.transpose(0, 2, 1).reshape(-1, len(columns))
        step = np.linalg.lstsq(rows, (measured - P).ravel(), rcond=-1.0)[0]
        vector = geometry.vector()
        vector[columns] += step
        if not np.isfinite(vector).all():
            return geometry, iteration, False
        geometry = geometry.with_vector(vector)
        if np.linalg.norm(step) < PAPER_TOLERANCE:
            return geometry, iteration, True
    return geometry, PAPER_ITERATIONS, False


def parameter_set_trials(
    profile: Profile, seeds: Sequence[int], listener: Listener = ignore, cancel: CancelToken | None = None
) -> ParameterSetsResult:
    """Compare parameter sets for every arm of the profile."""
    return ParameterSetsResult(
        arms={
            arm: tuple(compare_parameter_sets(profile, arm, seeds, listener=listener, cancel=cancel))
            for arm in profile.arms
        }
    )


def compare_parameter_sets(
    profile: Profile,
    arm: str,
    seeds: Sequence[int],
    identify_stops: int = 100,
    validate_stops: int = 100,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> list[ParameterSetTrial]:
    """Both solvers on the full, the paper's and the automatic set, over simulated arms of several seeds."""
    cancel = cancel or CancelToken()
    nominal = nominal_arm(profile.arms[arm])
    stops = identify_stops + validate_stops
    q = plan_stops(bare_profile(profile, stops))[arm]
    learn, held_out = q[:identify_stops], q[identify_stops:]
    solutions: dict[tuple[str, str], list[_Solution]] = {}
    for done, seed in enumerate(seeds):
        cancel.check()
        listener(Progress("parameter sets", done, len(seeds), f"seed {seed}"))
        plant = build_plant(bare_profile(profile, stops, plant_seed=seed))
        noisy, _ = plant.measure_positions(plant.smr_positions(arm, q), np.random.default_rng([profile.seed, seed]))
        start = start_from_nominal(nominal, learn, noisy[:identify_stops], tool_unknown=False)
        sets = [full_set(start), auto_set(start, learn)]
        if nominal.joints == 6:
            sets.insert(1, paper_set(start))
        for chosen in sets:
            for found in _both_solvers(start, learn, noisy[:identify_stops], chosen):
                error = summarise(position_errors(noisy[identify_stops:], smr_positions(found.geometry, held_out)))
                found = replace(found, mean_mm=error.mean, max_mm=error.max)
                solutions.setdefault((chosen.name, found.solver), []).append(found)
    listener(Progress("parameter sets", len(seeds), len(seeds), "done"))
    return [_medians(name, solver, found) for (name, solver), found in solutions.items()]


@dataclass(frozen=True)
class _Solution:
    """One identification, and its held-out errors [mm]."""

    solver: str
    parameters: int
    geometry: Geometry
    iterations: int
    converged: bool
    mean_mm: float = math.nan
    max_mm: float = math.nan


def _both_solvers(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> tuple[_Solution, _Solution]:
    geometry, iterations, converged = plain_gauss_newton(start, q, p_M, chosen)
    ours = identify(start, q, p_M, parameter_set=chosen, tolerance=PAPER_TOLERANCE, max_iterations=PAPER_ITERATIONS)
    size = len(chosen.columns)
    return (
        _Solution("plain", size, geometry, iterations, converged),
        _Solution("cellapp", size, ours.geometry, ours.iterations, ours.converged),
    )


def _medians(name: str, solver: str, found: Sequence[_Solution]) -> ParameterSetTrial:
    return ParameterSetTrial(
        parameter_set=name,
        solver=solver,
        parameters=found[0].parameters,
        iterations=float(np.median([one.iterations for one in found])),
        converged=sum(one.converged for one in found),
        seeds=len(found),
        mean_mm=float(np.median([one.mean_mm for one in found])),
        max_mm=float(np.median([one.max_mm for one in found])),
    )
