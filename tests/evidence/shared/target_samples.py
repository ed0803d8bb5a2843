"""Draws of the trials of new targets: effects that a simulated cell hides, and targets that its arms can reach."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.candidates import random_configurations
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_stop, visible, visible_stops
from cellapp.cell.targets.targets import Partner, Target
from cellapp.commands.trials.sealed_setup import MIXTURE, OUT, cases
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry, flange_poses
from cellapp.robot.kinematics.transforms import Array, invert, rpy_of, transform, xyz_of
from cellapp.robot.model import CellModel
from drivers.plant import suggest, suggest_other_law
from tests.sure import sure

_HIDDEN_SEED, _TARGET_SEED = 0x71DE, 0x7A26
"""Mixed with the trial's seed."""
_OTHER_LAWS = 0.5
"""Share of the drawn effects with a law of another shape than the library's."""


def sample_hidden(profile: Profile, seed: int, duration_s: float) -> dict[str, dict[str, Any]]:
    """Draw the effects of every arm: the profile's own, and a case of the sealed trials' mixture.

    Onsets and time constants lie within the run's length ``duration_s`` [s].
    """
    configs = {config.name: config for config in build_plant(profile).config.arms}
    hidden: dict[str, dict[str, Any]] = {}
    for place, name in enumerate(profile.arms):
        rng = np.random.default_rng([seed, _HIDDEN_SEED, place])
        case = cases((name,), str(rng.choice(MIXTURE)), 1, int(rng.integers(2**31)))[0]
        other = bool(rng.random() < _OTHER_LAWS) and case.kind != OUT
        draw = suggest_other_law if other else suggest
        drawn = {slug: draw(slug, rng, configs[name], duration_s) for slug in case.slugs}
        hidden[name] = {**sure(profile.plant).effects.get(name, {}), **drawn}
    return hidden


def sample_targets(profile: Profile, model: CellModel, count: int, seed: int) -> list[Target]:
    """Draw ``count`` single targets of each arm in the tracker frame, reachable and visible to the tracker.

    Each is the SMR pose of the nominal arm at a random configuration; the other arms wait at home. The side from which
    each joint comes is stated and random, with a short last motion as in designed plans: after motions of radians the
    effects of the last motion would be larger than any in the run.
    """
    cell, homes = cell_bodies(profile, model), home_positions(profile)
    targets = []
    for place, name in enumerate(profile.arms):
        others = {other: home for other, home in homes.items() if other != name}
        drawn = _drawn(cell, profile, name, [seed, _TARGET_SEED, place])
        at_home = {other: home[None] for other, home in others.items()}
        allowed = (q for q in drawn if not refuse_stop(cell, {**others, name: q}))
        found = (q for q in allowed if visible(cell, name, q[None], at_home)[0])
        sides = np.random.default_rng([seed, _TARGET_SEED, place, 1])
        for number, q in zip(range(count), found, strict=False):
            approach = tuple(sides.choice([-1, 1], len(q)).tolist())
            there = _pose(model.arms[name].nominal, q)
            targets.append(_target(f"{name} {number + 1}", name, there, approach=approach))
    return targets


def sample_pairs(profile: Profile, model: CellModel, count: int, seed: int) -> list[Target]:
    """Draw ``count`` cooperative targets of the first two arms: random configurations, collision-free and visible."""
    cell = cell_bodies(profile, model)
    first, second = list(profile.arms)[:2]
    drawn = zip(
        _drawn(cell, profile, first, [seed, _TARGET_SEED, 2]),
        _drawn(cell, profile, second, [seed, _TARGET_SEED, 3]),
        strict=False,
    )
    allowed = (both for both in drawn if not refuse_stop(cell, dict(zip((first, second), both, strict=True))))
    found = (both for both in allowed if visible_stops(cell, {first: both[0][None], second: both[1][None]})[0])
    targets = []
    for number, both in zip(range(count), found, strict=False):
        T_M_S = [_pose(model.arms[name].nominal, q) for name, q in zip((first, second), both, strict=True)]
        between = np.asarray(invert(T_M_S[0]) @ T_M_S[1])
        partner = Partner(arm=second, position=xyz_of(between[:3, 3]), rpy=rpy_of(between[:3, :3]))
        targets.append(_target(f"pair {number + 1}", first, T_M_S[0], partner=partner))
    return targets


# -- inside -----------------------------------------------------------------------------------------------------------


def _drawn(cell: CellBodies, profile: Profile, name: str, seed: list[int]) -> Iterator[Array]:
    return random_configurations(cell, profile, name, np.random.default_rng(seed))


def _pose(nominal: Geometry, q: Array) -> Array:
    """Compute the SMR pose (4, 4) in the tracker frame, with the axes of the flange."""
    rotations, origins = flange_poses(nominal, q[None])
    return transform(rotations[0], origins[0] + rotations[0] @ nominal.tool)


def _target(name: str, arm: str, T_M_S: Array, **more: Any) -> Target:
    return Target(name=name, arm=arm, frame="tracker", position=xyz_of(T_M_S[:3, 3]), rpy=rpy_of(T_M_S[:3, :3]), **more)
