"""Coverage of the stated 95 % intervals over many simulated arms, each with its own true geometry and noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from scipy.stats import t as student

from cellapp.calibration.identification import identify, start_from_nominal
from cellapp.collection.cell import build_plant
from cellapp.errors import InputError
from cellapp.model.nominal import nominal_arm
from cellapp.planning.plan import plan_stops
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.results import Result


class ArmCoverage(Result):
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

    schema_: Literal["cellapp-trials-coverage"] = "cellapp-trials-coverage"
    version: Literal[1] = 1
    runs: int
    intervals: int
    share: float
    by_parameter: Mapping[str, float]
    scatter: float


class CoverageResult(Result):
    """``trials coverage``: every arm."""

    schema_: Literal["cellapp-trials-coverage"] = "cellapp-trials-coverage"
    version: Literal[1] = 1
    arms: Mapping[str, ArmCoverage]


def bare_profile(profile: Profile, stops: int, *, plant_seed: int | None = None) -> Profile:
    """The profile with ``stops`` stops and no hidden effects; ``plant_seed`` draws another true geometry."""
    if profile.plant is None:
        raise InputError(f"profile {profile.name}: these trials need a section 'plant' (a simulated cell)")
    plant = profile.plant.model_copy(
        update={"effects": {}, "seed": profile.plant.seed if plant_seed is None else plant_seed}
    )
    plan = profile.plan.model_copy(update={"stops": stops})
    return profile.model_copy(update={"plant": plant, "plan": plan})


def coverage_trials(
    profile: Profile, runs: int, stops: int = 100, listener: Listener = ignore, cancel: CancelToken | None = None
) -> CoverageResult:
    """Coverage of every arm of the profile."""
    return CoverageResult(arms={arm: coverage(profile, arm, runs, stops, listener, cancel) for arm in profile.arms})


def coverage(
    profile: Profile,
    arm: str,
    runs: int,
    stops: int = 100,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> ArmCoverage:
    """Identify ``runs`` simulated arms from the same ``stops`` and count how often 95 % intervals contain the truth.

    The truth of the identified parameters is their estimate from noise-free positions of the same plant, with the same
    parameters merged into them: these have no true value of their own.
    """
    cancel = cancel or CancelToken()
    nominal = nominal_arm(profile.arms[arm])
    q = plan_stops(bare_profile(profile, stops))[arm]
    inside: dict[str, list[bool]] = {}
    scatter = []
    for k in range(runs):
        cancel.check()
        if k % 10 == 0:
            listener(Progress("coverage", k, runs))
        plant = build_plant(bare_profile(profile, stops, plant_seed=k))
        exact = plant.smr_positions(arm, q)
        noisy, covariance = plant.measure_positions(exact, np.random.default_rng([profile.seed, 0xC0, k]))
        start = start_from_nominal(nominal, q, noisy, tool_unknown=False)
        estimate = identify(start, q, noisy, sigma=covariance, tolerance=1e-10)
        exactly = identify(start, q, exact, parameter_set="full", tolerance=1e-12)
        if np.abs(exactly.residuals).max() > 1e-8:
            raise ValueError(f"the model does not fit noise-free positions: {exactly.message}")
        truth = estimate.parameter_set.merged_values(exactly.geometry, start)
        limit = student.ppf(0.975, estimate.degrees_of_freedom)
        held = np.abs(estimate.values - truth) <= limit * estimate.standard_errors
        for name, one in zip(estimate.names, held.tolist(), strict=True):
            inside.setdefault(name, []).append(one)
        scatter.append(estimate.scale)
    every = [one for held_by_name in inside.values() for one in held_by_name]
    listener(Progress("coverage", runs, runs, "done"))
    return ArmCoverage(
        runs=runs,
        intervals=len(every),
        share=float(np.mean(every)),
        by_parameter={name: float(np.mean(held_by_name)) for name, held_by_name in inside.items()},
        scatter=float(np.mean(scatter)),
    )
