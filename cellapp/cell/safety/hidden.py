"""Reasons why the tracker does not see an SMR, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from cellapp.cell.safety.bodies import Placed, beam_clearance, mounted_hides, place
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies, visible
from cellapp.cell.safety.obstacles import beam_gaps
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
from cellapp.robot.kinematics.transforms import Array


def why_hidden(cell: CellBodies, q: Mapping[str, Array]) -> str:
    """Return why the tracker does not see the SMRs of all arms at one stop, arm -> q (N,) [rad]; empty if it does.

    For each arm whose SMR is not seen: the first condition that fails, the actual value and the allowed one.
    """
    hidden = []
    for name in q:
        others = {other: value[np.newaxis] for other, value in q.items() if other != name}
        if not visible(cell, name, q[name][np.newaxis], others)[0]:
            hidden.append(f"arm {name}: {next(_reasons(cell, name, q), 'the tracker does not see its SMR')}")
    return "; ".join(hidden)


def _reasons(cell: CellBodies, name: str, q: Mapping[str, Array]) -> Iterator[str]:
    """Yield what hides the SMR of an arm, one reason after the other."""
    field = cell.field
    if field is None:
        yield "the cell has no tracker"
        return
    placed = {other: place(cell.arms[other], value[np.newaxis]) for other, value in q.items()}
    sight = sight_of(field.T_C_M, placed[name])
    for condition, holds in sight_conditions(field, cell.arms[name].acceptance, sight):
        if not holds[0]:
            yield _out_of_sight(condition, field, sight, cell.arms[name].acceptance)
    tracker, smr = field.T_C_M[:3, 3], placed[name].smr
    for what, gap in _beam_gaps(cell, name, placed, tracker):
        if not gap > BEAM_RADIUS:
            yield f"{what} is {_in_the_beam(gap)}"
    if mounted_hides(tracker, placed[name], BEAM_RADIUS)[0]:
        yield "what is mounted beside the SMR hides it from the tracker"
    for obstacle in cell.obstacles:
        gap = float(beam_gaps((obstacle,), tracker, smr, BEAM_RADIUS)[0])
        if not gap > BEAM_RADIUS:
            yield f"obstacle '{obstacle.name}' is {_in_the_beam(gap)}"


def _beam_gaps(
    cell: CellBodies, name: str, placed: Mapping[str, Placed], tracker: Array
) -> Iterator[tuple[str, float]]:
    """Yield the distance [m] of each arm's bodies from the beam to the SMR of arm ``name``."""
    for other, bodies in placed.items():
        what = "its own body" if other == name else f"arm {other}"
        yield what, float(beam_clearance(tracker, placed[name].smr, bodies, own=other == name)[0])


def _in_the_beam(gap: float) -> str:
    if gap <= 0.0:
        return "in the beam to its SMR"
    return f"{1e3 * gap:.0f} mm from the beam to its SMR, {1e3 * BEAM_RADIUS:.0f} mm are needed"


def _out_of_sight(condition: str, field: TrackerField, sight: Sight, acceptance: float) -> str:
    """Compare the actual value with the allowed one, for a condition that the only SMR of ``sight`` does not meet."""
    if condition == RANGE:
        low, high = field.distance
        return f"its SMR is {sight.distance[0]:.2f} m from the tracker, allowed are {low:.4g} to {high:.4g} m"
    if condition == FACING:
        turned, allowed = np.degrees([sight.incidence[0], usable_acceptance(acceptance)])
        return f"its SMR looks {turned:.1f} deg past the tracker, allowed are {allowed:.1f} deg"
    seen, limits = {
        AZIMUTH: (sight.azimuth[0], field.azimuth),
        ELEVATION: (math.asin(min(max(sight.sine_of_elevation[0], -1.0), 1.0)), field.elevation),
    }[condition]
    low, high = np.degrees(limits)
    return f"its SMR is at {condition} {math.degrees(seen):.1f} deg, allowed are {low:.4g} to {high:.4g} deg"
