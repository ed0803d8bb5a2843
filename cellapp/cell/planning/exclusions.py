"""Constraints that exclude configurations of an arm from being measured: how many, by how much, and what helps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.design_records import ConstraintShare
from cellapp.cell.planning.joint_draws import joint_ranges
from cellapp.cell.planning.usable import CEILING, FLOOR, MOUNTED, OWN_BEAM, OWN_BODIES, body_margins
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies
from cellapp.cell.safety.visibility import (
    AZIMUTH,
    ELEVATION,
    FACING,
    RANGE,
    Sight,
    TrackerField,
    sight_conditions,
    sight_of,
    usable_acceptance,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_EXAMINED = 36_000
"""Number of configurations examined: shares to a tenth of a percent in a fifth of a second."""
_SEED = 0
"""Seed of these configurations: always the same, so that the shares of two cells can be compared."""
_TURN = 2.0 * math.pi
_SUBJECTS: Mapping[str, str] = {
    RANGE: "tracker.distance",
    AZIMUTH: "tracker.azimuth",
    ELEVATION: "tracker.elevation",
    FACING: "the SMR's viewing direction (smr.normal, smr.acceptance)",
    FLOOR: "the floor (plan.floor, plan.clearance)",
    CEILING: "the ceiling (plan.ceiling, plan.clearance)",
    OWN_BEAM: "the arm's own body in the beam",
    OWN_BODIES: "the arm's clearance from itself",
    MOUNTED: "what is mounted beside the SMR",
}
_ADVICE: Mapping[str, str] = {
    RANGE: "move the tracker (tracker.pose), or check tracker.distance",
    AZIMUTH: "turn the tracker about its vertical axis (tracker.pose), or check tracker.azimuth",
    ELEVATION: "raise or lower the tracker, or move it farther away (tracker.pose), or check tracker.elevation",
    FACING: "turn smr.normal or the base towards the tracker, widen arms.*.limits or plan.ranges, or use an SMR of"
    " wider acceptance",
    FLOOR: "check plan.floor and arms.*.base, or ask for a smaller plan.clearance",
    CEILING: "check plan.ceiling and arms.*.base, or ask for a smaller plan.clearance",
    OWN_BEAM: "move the tracker, or fix the SMR farther from the arm's axes (smr.offset)",
    OWN_BODIES: "check arms.*.limits, plan.ranges and the capsules of the arm's type",
    MOUNTED: "mount it behind the SMR, or turn smr.normal away from it",
}


def shortage(cell: CellBodies, profile: Profile, name: str, found: int, drawn: int) -> str:
    """Compose one message: how few configurations of an arm are usable, which constraint excludes most, what helps."""
    asked = f", {profile.plan.stops + profile.plan.reserve} are needed" if found else ""
    first, second = exclusions(cell, profile, name)[:2]
    subject, next_one = (_SUBJECTS.get(one.constraint, one.constraint) for one in (first, second))
    if first.without > 0.0:
        besides = f"Without it {_percent(first.without)} could be measured."
    else:
        besides = f"No other constraint decides alone; next, {next_one} excludes {_percent(second.alone)}."
    return (
        f"plan: arm {name}: {found or 'none'} of {drawn} random configurations can be measured{asked}. Most are"
        f" excluded by {subject} ({_percent(first.alone)}): {first.extent}. {besides} What helps: {first.advice}"
    )


def exclusions(cell: CellBodies, profile: Profile, name: str) -> tuple[ConstraintShare, ...]:
    """Compute what each constraint excludes; first the one without which most configurations could be measured.

    Raises
    ------
    InputError
        If the cell has no tracker.
    """
    if cell.field is None:
        raise InputError(f"plan: arm {name}: the cell has no tracker that could see its SMR; give tracker.pose")
    arm, (low, high) = cell.arms[name], joint_ranges(cell, profile, name).T
    placed = place(arm, np.random.default_rng(_SEED).uniform(low, high, size=(_EXAMINED, len(low))))
    sight = sight_of(cell.field.T_C_M, placed)
    examined = _sight_examined(cell.field, sight, arm.acceptance)
    for constraint, margin in body_margins(cell, cell.field, name).items():
        metres = margin(placed)
        examined.append(_Examined(constraint, metres > 0.0, -1e3 * metres, "mm"))
    failed = np.sum([~one.holds for one in examined], axis=0)
    found = []
    for one in examined:
        fails = ~one.holds
        decisive = fails & (failed == 1)
        extent = _extent(cell.field, one, sight, decisive if decisive.any() else fails)
        found.append(
            ConstraintShare(
                constraint=one.name,
                alone=float(fails.mean()),
                without=float((failed == fails).mean()),
                extent=extent,
                advice=_ADVICE.get(one.name, f"move the {one.name.removesuffix(' in the beam')} or the tracker"),
            )
        )
    return tuple(sorted(found, key=lambda one: (one.without, one.alone), reverse=True))


@dataclass(frozen=True, eq=False)
class _Examined:
    """One constraint at n configurations: where it holds (n,), and by how much it is missed (n,) in ``unit``."""

    name: str
    holds: NDArray[np.bool_]
    missed: Array
    unit: str


def _sight_examined(field: TrackerField, sight: Sight, acceptance: float) -> list[_Examined]:
    """Examine the conditions on the SMRs, and by how much they are missed in mm or deg."""
    low, high = field.distance
    lowest, highest = field.elevation
    past_left = np.mod(sight.azimuth - field.azimuth[0], _TURN)
    width = field.azimuth[1] - field.azimuth[0]
    elevation = np.arcsin(np.clip(sight.sine_of_elevation, -1.0, 1.0))
    missed = {
        RANGE: (1e3 * np.maximum(low - sight.distance, sight.distance - high), "mm"),
        AZIMUTH: (np.degrees(np.minimum(past_left - width, _TURN - past_left)), "deg"),
        ELEVATION: (np.degrees(np.maximum(lowest - elevation, elevation - highest)), "deg"),
        FACING: (np.degrees(sight.incidence - usable_acceptance(acceptance)), "deg"),
    }
    return [_Examined(name, holds, *missed[name]) for name, holds in sight_conditions(field, acceptance, sight)]


def _extent(field: TrackerField, one: _Examined, sight: Sight, rows: NDArray[np.bool_]) -> str:
    """Describe what is seen at ``rows`` against what is allowed, and by how much the nearest of them misses."""
    if not rows.any():
        return "it excludes none"
    by = _by_how_much(one, rows)
    if one.name == RANGE:
        seen, allowed = sight.distance[rows], np.array(field.distance)
        return f"the SMR is {_span(seen, '.2f')} m from the tracker, allowed are {_span(allowed, '.4g')} m; {by}"
    if one.name in (AZIMUTH, ELEVATION):
        seen = sight.azimuth[rows] if one.name == AZIMUTH else np.arcsin(sight.sine_of_elevation[rows])
        middle = np.angle(np.exp(1j * seen).mean())  # azimuths may cross the cut at half a turn
        seen = np.degrees(middle + np.angle(np.exp(1j * (seen - middle))))
        allowed = np.degrees(field.azimuth if one.name == AZIMUTH else field.elevation)
        return f"the SMR is seen at {_span(seen, '.0f')} deg, allowed are {_span(allowed, '.4g')} deg; {by}"
    if one.name == FACING:
        return f"the SMR looks away from the tracker; {by}"
    return by


def _by_how_much(one: _Examined, rows: NDArray[np.bool_]) -> str:
    """Say by how much the nearest of ``rows`` misses; if other rows hold, by how much half of them miss."""
    nearest, half = float(np.min(one.missed[rows])), float(np.median(one.missed[rows]))
    if not math.isfinite(nearest):
        return "it hides the SMR"
    return (
        f"half miss by {half:.0f} {one.unit} or more"
        if one.holds.any()
        else f"the nearest misses by {nearest:.0f} {one.unit}"
    )


def _span(values: Array, number_format: str) -> str:
    return f"{np.min(values):{number_format}} to {np.max(values):{number_format}}"


def _percent(share: float) -> str:
    """Format a share of the configurations in percent, never rounded to all or nothing."""
    if share in (0.0, 1.0):
        return "all of them" if share else "none"
    return f"{100.0 * share:.{1 if 0.01 < share < 0.99 else 2}f} % of them"
