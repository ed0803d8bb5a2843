"""A simulated cell without hidden effects, and the stops at which its arms are measured with every seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.planning.plan import plan_stops
from cellapp.commands.trials.skeleton import Work
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record
from cellapp.ground.scale.task import Found, TaskKind
from cellapp.robot.kinematics.transforms import Array


class PlannedCell(Record):
    """What all seeds share; ``planned`` is arm -> joint positions (n, N) of its stops [rad]."""

    profile: Profile
    planned: Mapping[str, tuple[tuple[float, ...], ...]]

    def stops(self, arm: str) -> Array:
        """Return joint positions (n, N) of an arm [rad]."""
        return np.array(self.planned[arm])


class ArmSeed(Record):
    """One arm whose true geometry and noise are drawn by a seed."""

    arm: str
    seed: int


def of_all_arms(
    kind: TaskKind[PlannedCell, PlannedCell, ArmSeed, Found],
    job: str,
    cell: PlannedCell,
    seeds: Sequence[int],
    work: Work,
) -> tuple[dict[str, list[Found]], tuple[str, ...]]:
    """Compute every arm with every seed; return the results by arm, and the failures. Raises as ``Work.gather``."""
    drawn = [ArmSeed(arm=arm, seed=seed) for arm in cell.profile.arms for seed in seeds]
    gathered = work.gather(kind, job, cell, drawn, "arm {0.arm}, seed {0.seed}")
    by_arm: dict[str, list[Found]] = {arm: [] for arm in cell.profile.arms}
    for one, found in zip(drawn, gathered.results, strict=True):
        if found is not None:
            by_arm[one.arm].append(found)
    return by_arm, gathered.failed


def planned_cell(profile: Profile, stops: int) -> PlannedCell:
    """Plan ``stops`` stops. Raises ``InputError`` if the profile has no simulated cell or too few can be reached."""
    planned = plan_stops(bare_profile(profile, stops))
    return PlannedCell(
        profile=profile, planned={arm: tuple(tuple(row) for row in q.tolist()) for arm, q in planned.items()}
    )


def bare_profile(profile: Profile, stops: int, *, plant_seed: int | None = None) -> Profile:
    """Return the profile with ``stops`` stops and no hidden effects; ``plant_seed`` draws another true geometry."""
    if profile.plant is None:
        raise InputError(f"profile {profile.name}: these trials need a section 'plant' (a simulated cell)")
    plant = profile.plant.model_copy(
        update={"effects": {}, "seed": profile.plant.seed if plant_seed is None else plant_seed}
    )
    plan = profile.plan.model_copy(update={"stops": stops})
    return profile.model_copy(update={"plant": plant, "plan": plan})
