"""Correlations of a plan's factors with posture, time, block and each other; its time against that of random orders."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellapp.cell.planning.balance import Columns, posture_functions, side_by_side, standardised, time_and_blocks
from cellapp.cell.planning.design_records import FactorCorrelation, TravelTime
from cellapp.cell.planning.duration import home_s, stop_times_of
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops
from cellapp.cell.planning.transit_paths import TransitPath, TransitPlanner
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_SAMPLED_WAYS = 80
"""Upper limit of the motions between random stops that are searched for detours: about ten of them need one."""
_SAMPLED_A_STOP = 2
"""Such motions for each stop: in a small plan they say as much as all of its motions."""
_RANDOM_ORDERS = 20
"""Number of random orders whose time is averaged: the standard deviation is then a few tenths of a percent."""


def correlations(
    profile: Profile, cell: CellBodies, stops: PlannedStops, start: Configuration | None = None
) -> tuple[FactorCorrelation, ...]:
    """Find the largest correlation of each factor that a plan chooses: of each arm, and of all (arm "all").

    ``start`` is where the arms are before the first stop; None: home. Factors that do not vary are left out.
    """
    time = stop_times_of(profile, stops, start).measured_s
    common = time_and_blocks(time, stops.block)
    postures = {name: posture_functions(profile, cell, name, q) for name, q in stops.q.items()}
    steps = {name: np.nan_to_num(q - stops.approach_from[name]) for name, q in stops.q.items()}
    sides = {name: _of_joints("approach side of joint {} of " + name, np.sign(step)) for name, step in steps.items()}
    sizes = {name: _of_joints("step size of joint {} of " + name, np.abs(step)) for name, step in steps.items()}
    signed = {name: _of_joints("step of joint {} of " + name, step) for name, step in steps.items()}
    dwell = standardised(("dwell",), next(iter(stops.dwell_s.values()))[:, None])
    every_posture = side_by_side(postures.values())
    chosen = common.with_(dwell, *sides.values(), *sizes.values())
    found = [
        *_largest("all", common.first(1), every_posture),
        *_largest("all", dwell, every_posture.with_(common, *sides.values())),
    ]
    for name in stops.q:
        others = [posture for other, posture in postures.items() if other != name]
        for own in (sides[name], sizes[name]):
            found += _largest(name, own, every_posture.with_(chosen))
        found += _largest(name, signed[name], every_posture.with_(common, dwell))
        if others:
            found += sorted(
                _largest(name, postures[name], side_by_side(others)), key=lambda one: -abs(one.correlation)
            )[:1]
    return tuple(found)


def travel_time(profile: Profile, stops: PlannedStops, finder: TransitPlanner, rng: np.random.Generator) -> TravelTime:
    """Compute the time in motion of a plan, and of the same pairs, approaches and dwells in random order.

    In random order, too, the gate refuses some straight motions; the time of their detours is estimated from a sample.
    """
    straight = replace(stops, legs=((),) * len(stops))
    random_s = []
    for _ in range(_RANDOM_ORDERS):
        order = straight.take(rng.permutation(len(stops)))
        random_s.append(float(stop_times_of(profile, order).moving_s.sum()) + home_s(profile, order))
    planned_s = float(stop_times_of(profile, stops).moving_s.sum()) + home_s(profile, stops)
    detours_s = len(stops) * _added_by_a_detour_s(stops, finder, rng)
    return TravelTime(planned_s=planned_s, random_order_s=float(np.mean(random_s)) + detours_s)


def _added_by_a_detour_s(stops: PlannedStops, finder: TransitPlanner, rng: np.random.Generator) -> float:
    """Estimate the mean time that detours add to motions between random stops [s], where one is found."""
    if len(stops) < 2:
        return 0.0
    number = min(_SAMPLED_WAYS, _SAMPLED_A_STOP * len(stops))
    pairs = [rng.choice(len(stops), 2, replace=False).tolist() for _ in range(number)]
    motions = [(stops.targets(here), stops.targets(there)) for here, there in pairs]
    finder.gate.ask(motions)
    added = []
    for here, there in motions:
        way = finder.find(here, there)
        if isinstance(way, TransitPath):
            added.append(way.seconds - finder.seconds(here, there))
    return float(np.mean(added)) if added else 0.0


def _of_joints(text: str, values: Array) -> Columns:
    return standardised(tuple(text.format(j + 1) for j in range(values.shape[1])), values)


def _largest(arm: str, factors: Columns, others: Columns) -> Iterator[FactorCorrelation]:
    """Yield the largest correlation of each factor with one of the others that is not itself."""
    if not others.names:
        return
    correlation = factors.values.T @ others.values / max(len(factors.values), 1)
    for name, row in zip(factors.names, correlation, strict=True):
        size = np.where(np.array([other == name for other in others.names]), -1.0, np.abs(row))
        k = int(np.argmax(size))
        if size[k] >= 0.0:
            yield FactorCorrelation(
                arm=arm, factor=name, other=others.names[k], correlation=float(row[k]), can_be_chosen=True
            )
