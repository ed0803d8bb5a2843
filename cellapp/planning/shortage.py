"""Why an arm has no, or too few, configurations that the tracker sees: which constraint excludes them, by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.planning.joint_draws import draw_joints, joint_ranges
from cellapp.planning.usable import body_margins
from cellapp.profile import Profile
from cellapp.safety.bodies import place
from cellapp.safety.gate import CellBodies, TrackerField
from cellapp.safety.visibility import (
    AZIMUTH,
    ELEVATION,
    FACING,
    RANGE,
    Sight,
    sight_conditions,
    sight_of,
    usable_acceptance,
)

_DRAWS = 3
"""Draws of some 12 000 configurations that are examined: shares to a tenth of a percent in a fifth of a second."""
_TURN = 2.0 * math.pi
_ADVICE: Mapping[str, str] = {
    RANGE: "move the tracker, or check tracker.distance",
    AZIMUTH: "turn the tracker about its vertical axis (tracker.pose), or check tracker.azimuth",
    ELEVATION: "raise or lower the tracker, or move it farther away (tracker.pose), or check tracker.elevation",
    FACING: "turn smr.normal or the base towards the tracker, widen arms.*.limits or plan.ranges, or use an SMR of"
    " wider acceptance",
    "floor": "check plan.floor and arms.*.base, or ask for a smaller plan.clearance",
    "ceiling": "check plan.ceiling and arms.*.base, or ask for a smaller plan.clearance",
    "own arm in the beam": "move the tracker, or fix the SMR farther from the arm's axes (smr.offset)",
    "own bodies": "widen arms.*.limits or plan.ranges, or check the capsules of the arm's type",
}


@dataclass(frozen=True, eq=False)
class _Examined:
    """One constraint at n configurations: where it holds (n,), by how much it is missed (n,) in ``unit``."""

    name: str
    holds: NDArray[np.bool_]
    missed: Array
    unit: str


def shortage(cell: CellBodies, profile: Profile, name: str, found: int, drawn: int) -> str:
    """One message: how few configurations of an arm are usable, which constraint excludes most, what to do."""
    asked = profile.plan.stops + profile.plan.reserve
    begin = f"plan: arm {name}: {found or 'none'} of {drawn} random configurations can be measured"
    begin += f", {asked} are needed" if found else ""
    return f"{begin}. {worst_constraint(cell, profile, name)}"


def worst_constraint(cell: CellBodies, profile: Profile, name: str) -> str:
    """Sentences on the constraint without which most configurations of an arm could be measured."""
    assert cell.field is not None  # without a tracker nothing is drawn
    arm, ranges, rng = cell.arms[name], joint_ranges(cell, profile, name), np.random.default_rng(0)
    draws = [draw_joints(arm, cell.field.T_C_M, ranges, rng, group=1) for _ in range(_DRAWS)]
    q = np.concatenate([one.q(np.ones(one.sight.distance.shape, dtype=bool)) for one in draws])
    placed = place(arm, q)
    sight = sight_of(cell.field.T_C_M, placed)
    examined = _sight_examined(cell.field, arm.acceptance, sight)
    for constraint, margin in body_margins(cell, cell.field, name).items():
        metres = margin(placed)
        examined.append(_Examined(constraint, metres > 0.0, -1e3 * metres, "mm"))
    held = np.stack([one.holds for one in examined])
    without = np.array([np.delete(held, k, axis=0).all(axis=0).mean() for k in range(len(examined))])
    alone = 1.0 - held.mean(axis=1)
    usable = held.all(axis=0).mean()
    killer = int(np.argmax(without if without.max() > usable else alone))
    others = np.asarray(np.delete(held, killer, axis=0).all(axis=0))
    worst = examined[killer]
    sentence = (
        f"{_subject(worst.name)} excludes {_percent(alone[killer])}: {_extent(cell.field, worst, sight, others)}."
    )
    if without[killer] > usable:
        sentence += f" Without it {_percent(without[killer])} could be measured."
    else:
        second = int(np.argmax(np.where(np.arange(len(alone)) == killer, -1.0, alone)))
        sentence += f" {_subject(examined[second].name)} alone excludes {_percent(alone[second])}."
    return f"{sentence} What helps: {_ADVICE.get(worst.name, f'move or remove {worst.name}')}"


def _sight_examined(field: TrackerField, acceptance: float, sight: Sight) -> list[_Examined]:
    """The conditions on the SMRs, by how much they are missed in mm or deg; infinite where that has no meaning."""
    low, high = field.distance
    lowest, highest = field.elevation
    elevation = np.arcsin(np.clip(sight.sine_of_elevation, -1.0, 1.0))
    past_left = np.mod(sight.azimuth - field.azimuth[0], _TURN)
    width = field.azimuth[1] - field.azimuth[0]
    missed = {
        RANGE: (1e3 * np.maximum(low - sight.distance, sight.distance - high), "mm"),
        AZIMUTH: (np.degrees(np.minimum(past_left - width, _TURN - past_left)), "deg"),
        ELEVATION: (np.degrees(np.maximum(lowest - elevation, elevation - highest)), "deg"),
        FACING: (np.degrees(sight.incidence - usable_acceptance(acceptance)), "deg"),
    }
    return [_Examined(name, holds, *missed[name]) for name, holds in sight_conditions(field, acceptance, sight)]


def _subject(constraint: str) -> str:
    settings = {RANGE: "tracker.distance", AZIMUTH: "tracker.azimuth", ELEVATION: "tracker.elevation"}
    if constraint == FACING:
        return "The SMR's viewing direction (smr.normal, smr.acceptance)"
    return settings.get(constraint, f"The constraint '{constraint}'")


def _extent(field: TrackerField, one: _Examined, sight: Sight, rows: NDArray[np.bool_]) -> str:
    """What is seen against what is allowed, and the nearest miss among ``rows`` where all other constraints hold."""
    missing = ~one.holds & rows if np.any(~one.holds & rows) else ~one.holds
    nearest = float(np.min(one.missed[missing], initial=np.inf))
    by = f"the nearest misses it by {nearest:.0f} {one.unit}"
    if one.name == RANGE:
        low, high = np.quantile(sight.distance[missing], (0.0, 1.0))
        return f"the SMR is {low:.2f} to {high:.2f} m from the tracker, allowed are {_span(field.distance)} m; {by}"
    if one.name == ELEVATION:
        low, high = np.degrees(np.arcsin(np.quantile(sight.sine_of_elevation[missing], (0.0, 1.0))))
        allowed = _span(np.degrees(field.elevation))
        return f"the SMR is seen at {low:.0f} to {high:.0f} deg, allowed are {allowed} deg; {by}"
    if one.name == AZIMUTH:
        centre = np.angle(np.exp(1j * sight.azimuth[missing]).mean())
        off = np.angle(np.exp(1j * (sight.azimuth[missing] - centre)))
        low, high = np.degrees(centre + np.quantile(off, (0.0, 1.0)))
        allowed = _span(np.degrees(field.azimuth))
        return f"the SMR is seen at {low:.0f} to {high:.0f} deg, allowed are {allowed} deg; {by}"
    if one.name == FACING:
        return f"it looks away from the tracker; the nearest misses its acceptance by {nearest:.0f} deg"
    return by


def _span(limits: tuple[float, float] | Array) -> str:
    return f"{limits[0]:.4g} to {limits[1]:.4g}"


def _percent(share: float) -> str:
    """A share in percent that is not rounded to all or nothing."""
    if share in (0.0, 1.0):
        return "all draws" if share else "no draws"
    return f"{100.0 * share:.{1 if 0.01 < share < 0.99 else 2}f} % of draws"
