"""Why an SMR is not seen: a reason where, and only where, the gate finds it hidden, and the right one."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from cellapp.cell.planning.candidates import draw_pool
from cellapp.cell.planning.view import why_hidden
from cellapp.cell.safety.bodies import ArmBodies
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import CellBodies, visible_stops
from cellapp.cell.safety.shapes import Obstacle, RoundedBox
from cellapp.cell.safety.visibility import TrackerField
from cellapp.robot.kinematics.transforms import transform
from tests.cell.safety.test_gate import turnstile
from tests.twin import small_twin

FIELD = TrackerField(transform(np.eye(3), [-3.0, 0.0, 0.0]), (-1.0, 1.0), (-0.5, 0.5), (1.0, 10.0))
"""A tracker before two bars at its own height, looking along x."""
SEEN = {"a": np.array([math.pi]), "b": np.array([math.pi])}
"""Both bars point at the tracker; the second stands behind the first, to its side."""


def bars(**changes: Any) -> CellBodies:
    aside = turnstile(1.5).geometry.with_T_M_B(transform(np.eye(3), [1.5, 1.2, 0.0]))
    second = dataclasses.replace(turnstile(1.5), geometry=aside)
    cell = CellBodies({"a": turnstile(0.0), "b": second}, FIELD, 0.1, -1.0)
    return dataclasses.replace(cell, **changes)


def changed(arm: ArmBodies, **changes: Any) -> CellBodies:
    cell = bars()
    return dataclasses.replace(cell, arms={**cell.arms, "a": dataclasses.replace(arm, **changes)})


def box(position: list[float], size: float) -> Obstacle:
    return Obstacle("pillar", RoundedBox(np.full(3, 0.5 * size)), transform(np.eye(3), position))


def moved(**changes: Any) -> CellBodies:
    return bars(field=dataclasses.replace(FIELD, **changes))


def test_nothing_is_said_of_what_is_seen() -> None:
    assert visible_stops(bars(), {name: q[None] for name, q in SEEN.items()})[0]
    assert why_hidden(bars(), SEEN) == ""


A = turnstile(0.0)
CASES: dict[str, tuple[CellBodies, dict[str, np.ndarray], str]] = {
    "near": (moved(distance=(2.5, 9.0)), SEEN, "arm a: its SMR is 2.00 m from the tracker, allowed are 2.5 to 9 m"),
    "aside": (moved(azimuth=(0.1, 1.0)), SEEN, "arm a: its SMR is at azimuth 0.0 deg, allowed are 5.73 to 57.3 deg"),
    "low": (moved(elevation=(0.2, 0.5)), SEEN, "its SMR is at elevation 0.0 deg, allowed are 11.46 to 28.65 deg"),
    "away": (
        bars(),
        {**SEEN, "a": np.array([0.0])},
        "arm a: its SMR looks 180.0 deg past the tracker, allowed are 54.3 deg",
    ),
    "own body": (
        changed(A, frames=np.array([0, 1]), start=np.array([[-1.3, 0.0, 0.1], A.start[0]]),
                end=np.array([[-1.3, 0.0, 0.1], A.end[0]]), radius=np.array([0.09, 0.05])),
        SEEN,
        "arm a: its own body is 10 mm from the beam to its SMR, 20 mm are needed",
    ),
    "obstacle": (
        bars(obstacles=(box([-2.0, 0.0, 0.0], 0.1),)), SEEN, "arm a: obstacle 'pillar' is in the beam to its SMR"
    ),
    "both": (
        bars(obstacles=(box([-2.0, 0.0, 0.0], 1.0),)),
        SEEN,
        "arm a: obstacle 'pillar' is in the beam to its SMR; arm b: obstacle 'pillar' is in the beam to its SMR",
    ),
    "no tracker": (bars(field=None), SEEN, "arm a: the cell has no tracker; arm b: the cell has no tracker"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_condition_that_is_missed_is_named(case: str) -> None:
    cell, q, reason = CASES[case]
    assert reason in why_hidden(cell, q)


def test_the_other_arm_in_the_beam_is_named() -> None:
    cell = CellBodies({"a": turnstile(0.0), "b": turnstile(1.5)}, FIELD, 0.1, -1.0)
    assert why_hidden(cell, SEEN) == "arm b: arm a is in the beam to its SMR"


def test_a_mounted_obstacle_is_named() -> None:
    cap = Obstacle("cap", RoundedBox(np.full(3, 0.02)), transform(np.eye(3), [0.1, 0.0, 0.0]))
    assert "mounted beside the SMR" in why_hidden(changed(turnstile(0.0), mounted=(cap,)), SEEN)


def test_there_is_a_reason_exactly_where_the_gate_sees_nothing() -> None:
    profile = small_twin()
    cell, rng = cell_bodies(profile), np.random.default_rng(6)
    usable = {name: draw_pool(cell, profile, name, 60, rng).q for name in cell.arms}
    q = {name: np.concatenate([seen, rng.uniform(-2.0, 2.0, (60, 6))]) for name, seen in usable.items()}
    seen = visible_stops(cell, q)
    assert 20 < seen.sum() < 100
    for k in range(120):
        reason = why_hidden(cell, {name: value[k] for name, value in q.items()})
        assert (reason == "") == seen[k]
        assert "does not see its SMR" not in reason, "every reason has a name"
