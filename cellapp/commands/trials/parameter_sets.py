"""Redundant against reduced parameter sets, as in Bai et al., ROBOT 45(3), 2023: iterations, mean and maximum error.

Two solvers are compared. ``plain`` is the paper's: unscaled Gauss-Newton least squares without regularisation, stopped
at |dg| < 1e-5 or after 1000 iterations; on the redundant model its steps along unobservable directions never end.
``cellapp`` is this program's, which takes the minimum-norm step if the normal matrix is singular.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.commands.trials.planned_cell import ArmSeed, PlannedCell, bare_profile, of_all_arms, planned_cell
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.view.table import Table, table_of
from cellapp.estimation.calibration.evaluation import position_errors, summarise
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.estimation.calibration.parameters import ParameterSet, auto_set, full_set, paper_set
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.task import TaskKind, as_given
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import nominal_arm

PAPER_TOLERANCE = 1e-5
PAPER_ITERATIONS = 1000
"""Most iterations, as in the paper."""
IDENTIFY_STOPS, VALIDATE_STOPS = 100, 100
"""Stops of each arm for identification and for validation."""


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


class ParameterSetsResult(Result, schema="cellapp-trials-parameter-sets"):
    """``trials parameter-sets``: every arm with every parameter set and solver."""

    arms: Mapping[str, tuple[ParameterSetTrial, ...]]
    failed: tuple[str, ...] = ()
    """Seeds that failed, and why."""


def plain_gauss_newton(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> tuple[Geometry, int, bool]:
    """Iterate as in the paper, without regularisation of dependent columns, until |dg| < 1e-5.

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


class Solution(Record):
    """One identification, and its held-out errors [mm]."""

    parameter_set: str
    solver: str
    parameters: int
    iterations: int
    converged: bool
    mean_mm: float
    max_mm: float


class Solutions(Record):
    """Both solvers on all parameter sets, for one seed."""

    solutions: tuple[Solution, ...]


def parameter_set_trials(
    profile: Profile,
    seeds: Sequence[int],
    work: Work = IN_PLACE,
) -> ParameterSetsResult:
    """Compare parameter sets for every arm of the profile. Raises as ``gather`` does."""
    planned = planned_cell(profile, IDENTIFY_STOPS + VALIDATE_STOPS)
    by_arm, failed = of_all_arms(SETS, "parameter sets", planned, seeds, work)
    solutions = {arm: [one for its in found for one in its.solutions] for arm, found in by_arm.items()}
    return ParameterSetsResult(arms={arm: tuple(_summaries(found)) for arm, found in solutions.items()}, failed=failed)


def parameter_set_tables(result: ParameterSetsResult) -> list[Table]:
    """Show redundant and reduced models, one table for each arm."""
    return [
        table_of(
            f"Arm {arm}: redundant and reduced models, medians over seeds",
            trials,
            ("set (parameters), solver", lambda one: f"{one.parameter_set} ({one.parameters}), {one.solver}"),
            ("iterations", "iterations", "g"),
            ("converged", lambda one: f"{one.converged} of {one.seeds}"),
            ("mean", "mean_mm", ".4g", "mm"),
            ("max", "max_mm", ".4g", "mm"),
        )
        for arm, trials in result.arms.items()
    ]


def compared_sets(planned: PlannedCell, drawn: ArmSeed) -> Solutions:
    """Run both solvers on all parameter sets, for one arm and seed."""
    arm, profile, stops = drawn.arm, planned.profile, IDENTIFY_STOPS + VALIDATE_STOPS
    nominal, q = nominal_arm(profile.arms[arm]), planned.stops(arm)
    plant = build_plant(bare_profile(profile, stops, plant_seed=drawn.seed))
    noisy, _ = plant.measure_positions(plant.smr_positions(arm, q), np.random.default_rng([profile.seed, drawn.seed]))
    learn, held_out = q[:IDENTIFY_STOPS], q[IDENTIFY_STOPS:]
    start = start_from_nominal(nominal, learn, noisy[:IDENTIFY_STOPS], tool_unknown=False)
    sets = [full_set(start), auto_set(start, learn)]
    if nominal.joints == 6:
        sets.insert(1, paper_set(start))
    found = []
    for chosen in sets:
        for solver, geometry, iterations, converged in _both_solvers(start, learn, noisy[:IDENTIFY_STOPS], chosen):
            error = summarise(position_errors(noisy[IDENTIFY_STOPS:], smr_positions(geometry, held_out)))
            found.append(
                Solution(
                    parameter_set=chosen.name,
                    solver=solver,
                    parameters=len(chosen.columns),
                    iterations=iterations,
                    converged=converged,
                    mean_mm=error.mean,
                    max_mm=error.max,
                )
            )
    return Solutions(solutions=tuple(found))


SETS = TaskKind("cellapp.commands.trials.parameter_sets:SETS", PlannedCell, ArmSeed, Solutions, as_given, compared_sets)


def _both_solvers(start: Geometry, q: Array, p_M: Array, chosen: ParameterSet) -> list[tuple[str, Geometry, int, bool]]:
    """Return for each solver its name, its geometry, the iterations, and whether it converged."""
    ours = identify(start, q, p_M, parameter_set=chosen, tolerance=PAPER_TOLERANCE, max_iterations=PAPER_ITERATIONS)
    return [
        ("plain", *plain_gauss_newton(start, q, p_M, chosen)),
        ("cellapp", ours.geometry, ours.iterations, ours.converged),
    ]


def _summaries(found: Sequence[Solution]) -> list[ParameterSetTrial]:
    groups = grouped(((one.parameter_set, one.solver), one) for one in found)
    return [_medians(name, solver, some) for (name, solver), some in groups.items()]


def _medians(name: str, solver: str, found: Sequence[Solution]) -> ParameterSetTrial:
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
