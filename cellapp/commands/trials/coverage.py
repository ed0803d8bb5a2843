"""Coverage of the stated 95 % intervals over many simulated arms, each with its own true geometry and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtrit

from cellapp.cell.driving.cell import build_plant
from cellapp.commands.trials.planned_cell import ArmSeed, PlannedCell, bare_profile, of_all_arms, planned_cell
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.task import TaskKind, as_given
from cellapp.robot.model.nominal import nominal_arm


class ArmCoverage(Result, schema="cellapp-trials-coverage"):
    """How often the 95 % intervals of one arm contained the truth.

    Attributes
    ----------
    runs, intervals : int
        Simulated runs, and intervals in all.
    share : float
        Share of intervals that contained the truth.
    by_parameter : mapping
        Parameter -> share of the runs that identified it.
    scatter : float
        Mean of the root of chi-square per degree of freedom: 1 when the tracker's noise model is the true one.
    """

    runs: int
    intervals: int
    share: float
    by_parameter: Mapping[str, float]
    scatter: float


class CoverageResult(Result, schema="cellapp-trials-coverage"):
    """``trials coverage``: every arm."""

    arms: Mapping[str, ArmCoverage]
    failed: tuple[str, ...] = ()
    """Seeds that failed, and why."""


class Interval(Record):
    """One identification: parameter -> whether its 95 % interval holds the truth; root of chi-square per freedom."""

    held: Mapping[str, bool]
    scatter: float


def coverage_trials(
    profile: Profile,
    runs: int,
    stops: int = 100,
    work: Work = IN_PLACE,
) -> CoverageResult:
    """Estimate the coverage of every arm of the profile. Raises as ``gather`` does."""
    by_arm, failed = of_all_arms(INTERVALS, "coverage", planned_cell(profile, stops), range(runs), work)
    arms = {arm: _coverage(found) for arm, found in by_arm.items() if found}
    return CoverageResult(arms=arms, failed=failed)


def coverage_sentences(result: CoverageResult) -> list[str]:
    """State the coverage of every arm."""
    return [
        f"arm {name}: {100 * arm.share:.2f} % of {arm.intervals} stated 95 % intervals contain the truth"
        f" ({counted(arm.runs, 'run')}; by parameter {100 * min(arm.by_parameter.values()):.1f} to"
        f" {100 * max(arm.by_parameter.values()):.1f} %)"
        for name, arm in result.arms.items()
    ]


def coverage(profile: Profile, arm: str, runs: int, stops: int = 100) -> ArmCoverage:
    """Identify ``runs`` simulated arms from the same ``stops`` and count how often 95 % intervals contain the truth."""
    planned = planned_cell(profile, stops)
    return _coverage([interval(planned, ArmSeed(arm=arm, seed=seed)) for seed in range(runs)])


def interval(planned: PlannedCell, drawn: ArmSeed) -> Interval:
    """Identify one simulated arm.

    The truth of the identified parameters is their estimate from noise-free positions of the same plant with the same
    parameter set: parameters into which others are merged have no true value of their own.
    """
    profile, arm, q = planned.profile, drawn.arm, planned.stops(drawn.arm)
    nominal = nominal_arm(profile.arms[arm])
    plant = build_plant(bare_profile(profile, len(q), plant_seed=drawn.seed))
    exact = plant.smr_positions(arm, q)
    noisy, covariance = plant.measure_positions(exact, np.random.default_rng([profile.seed, 0xC0, drawn.seed]))
    start = start_from_nominal(nominal, q, noisy, tool_unknown=False)
    estimate = identify(start, q, noisy, sigma=covariance, tolerance=1e-10)
    exactly = identify(start, q, exact, parameter_set="full", tolerance=1e-12)
    if np.abs(exactly.residuals).max() > 1e-8:
        raise ValueError(f"the model does not fit noise-free positions: {exactly.message}")
    truth = estimate.parameter_set.merged_values(exactly.geometry, start)
    limit = stdtrit(estimate.degrees_of_freedom, 0.975)
    held = np.abs(estimate.values - truth) <= limit * estimate.standard_errors
    return Interval(held=dict(zip(estimate.names, held.tolist(), strict=True)), scatter=float(estimate.scale))


INTERVALS = TaskKind("cellapp.commands.trials.coverage:INTERVALS", PlannedCell, ArmSeed, Interval, as_given, interval)


def _coverage(found: Sequence[Interval]) -> ArmCoverage:
    inside = grouped(pair for one in found for pair in one.held.items())
    every = [held for some in inside.values() for held in some]
    return ArmCoverage(
        runs=len(found),
        intervals=len(every),
        share=float(np.mean(every)),
        by_parameter={name: float(np.mean(some)) for name, some in inside.items()},
        scatter=float(np.mean([one.scatter for one in found])),
    )
