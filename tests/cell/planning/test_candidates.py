"""The pool of candidates: usable, spread like plain rejection, by seed; an impossible cell names its constraint."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.planning.candidates import CandidatePool, sample_pool
from cellapp.cell.planning.transit_paths import ArmRoadmap
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.bodies import ArmBodies, TrackerField, place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, clear_alone, refuse_motion, visible
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, Placement
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.transforms import transform
from tests.twin import PROFILES, altered, small_twin, with_arms

COUNT = 400
TRACKER = TrackerField(
    transform(np.diag([-1.0, -1.0, 1.0]), np.array([3.5, 0.3, 0.5])), (-7.0, 7.0), (-0.9, 0.9), (1.0, 40.0)
)
HALF_TURN = 0.5 * math.pi


def chain_cell(rows: list[list[float]], normal: tuple[float, float, float]) -> CellBodies:
    """A cell of one arm 'only' with a capsule along every link, at the origin before the tracker."""
    table = np.array(rows)
    links = np.arange(1, len(table) + 1)
    back = np.array([[-a, -d * math.sin(alpha), -d * math.cos(alpha)] for _, d, a, alpha in rows])
    arm = ArmBodies(
        geometry=nominal_geometry(table, np.array([0.02, 0.01, 0.05]), np.eye(4)),
        frames=links,
        start=np.zeros((len(table), 3)),
        end=back,
        radius=np.full(len(table), 0.04),
        limits=np.tile([-2.9, 2.9], (len(table), 1)),
        normal_F=np.array(normal),
        acceptance=0.5,
    )
    return CellBodies({"only": arm}, TRACKER, 0.05, -1.0)


def turned_smr(normal: tuple[float, float, float]) -> CellBodies:
    cell = cell_bodies(small_twin())
    arms = {name: dataclasses.replace(arm, normal_F=np.array(normal)) for name, arm in cell.arms.items()}
    return dataclasses.replace(cell, arms=arms)


FOUR = [[0.0, 0.4, 0.0, HALF_TURN], [0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.4, HALF_TURN], [0.0, 0.1, 0.0, 0.0]]
CELLS: dict[str, tuple[CellBodies, str]] = {
    "UR10": (cell_bodies(small_twin()), "left"),
    "UR5": (cell_bodies(small_twin()), "right"),
    "SMR across the flange axis": (turned_smr((1.0, 0.0, 0.0)), "left"),
    "oblique SMR": (turned_smr((0.6, 0.0, 0.8)), "right"),
    "seven joints": (cell_bodies(load_profile(PROFILES / "twin-foreign.yaml")), "seven"),
    "four joints": (chain_cell(FOUR, (0.0, 0.0, 1.0)), "only"),
    "two joints": (chain_cell(FOUR[1:3], (1.0, 0.0, 0.0)), "only"),
    "one joint": (chain_cell(FOUR[:1], (1.0, 0.0, 0.0)), "only"),
}


def pool_of(cell: CellBodies, name: str, seed: int = 3, count: int = COUNT, **plan: Any) -> CandidatePool:
    return sample_pool(cell, small_twin(COUNT, plan=plan), name, count, np.random.default_rng(seed))


@pytest.mark.parametrize("which", CELLS)
def test_every_candidate_can_be_measured(which: str) -> None:
    cell, name = CELLS[which]
    arm, pool = cell.arms[name], pool_of(cell, name)
    assert pool.q.shape == (COUNT, arm.geometry.joints)
    assert np.all((pool.q >= arm.limits[:, 0]) & (pool.q <= arm.limits[:, 1]))
    placed = place(arm, pool.q)
    assert visible(cell, name, pool.q).all()
    assert clear_alone(cell, placed).all()
    assert len(np.unique(pool.q, axis=0)) == COUNT
    assert pool.sampled - sum(pool.rejected.values()) >= COUNT


def test_a_pool_may_be_smaller_than_asked_for_but_not_than_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_SAMPLES", 60_000)
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_SAMPLES_PER_CANDIDATE", 1)
    cell, name = CELLS["UR10"]
    assert COUNT <= len(pool_of(cell, name, count=5000).q) < 5000
    with pytest.raises(InputError, match=rf"[0-9]+ of [0-9]+ random .* can be measured, {COUNT * 10} are needed"):
        sample_pool(cell, small_twin(COUNT * 10), name, 5000, np.random.default_rng(0))


# -- cells in which nothing can be measured ---------------------------------------------------------------------------


def with_box(profile: Profile, position: tuple[float, float, float], size: tuple[float, float, float]) -> Profile:
    box = BoxObstacle(shape="box", size=size, pose=Placement(position=position))
    return profile.model_copy(update={"obstacles": {"table": box}})


def folded(profile: Profile) -> Profile:
    """The forearm may only lie on the upper arm."""
    limits = tuple((2.9, 3.1) if joint == 2 else (-3.0, 3.0) for joint in range(6))
    return with_arms(altered(profile, plan={"floor": -3.0}), limits=limits)


def impossible(twin: Profile) -> dict[str, tuple[Profile, str, str]]:
    """Cause -> profile, what excludes most, and by how much."""
    no_home = with_arms(twin, home=None)
    return {
        "too far": (
            altered(twin, tracker={"distance": (6.0, 40.0)}),
            "tracker.distance",
            r"allowed are 6 to 40 m; .* by \d+ mm",
        ),
        "behind its back": (
            altered(twin, tracker={"azimuth": (2.8, 3.4)}),
            "tracker.azimuth",
            r"allowed are 160\.4 to 194\.8 deg",
        ),
        "too high": (
            altered(twin, tracker={"elevation": (1.0, 1.5)}),
            "tracker.elevation",
            r"seen at -1\d to 1\d deg, .* deg",
        ),
        "looking back": (
            with_arms(twin, smr={"normal": (0.0, 0.0, -1.0), "acceptance": 0.05}),
            "the SMR's viewing direction",
            r"looks away from the tracker; the nearest misses by \d+ deg",
        ),
        "floor": (altered(twin, plan={"floor": 0.5}), "the floor", r"nearest misses by \d+ mm"),
        "ceiling": (altered(twin, plan={"ceiling": -0.1, "floor": -3.0}), "the ceiling", r"nearest misses by \d+ mm"),
        "wall": (with_box(twin, (2.0, 0.0, 0.5), (0.1, 9.0, 9.0)), "obstacle 'table' in the beam", "nearest misses by"),
        "in a box": (with_box(no_home, (0.0, 0.85, 0.3), (0.3, 0.3, 0.3)), "obstacle 'table'", "nearest misses by"),
        "folded": (folded(twin), "the arm's clearance from itself", r"nearest misses by \d+ mm"),
    }


CAUSES = impossible(small_twin(3))


@pytest.mark.parametrize("cause", CAUSES)
def test_what_cannot_be_measured_names_its_constraint(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_SAMPLES", 20_000)
    profile, constraint, extent = CAUSES[cause]
    most = rf"excluded by {constraint}.* \((all|99\.[0-9]+ %) of them\): .*{extent}.* What helps: [a-z]"
    with pytest.raises(InputError, match=f"arm left: none of [0-9]+ random .* {most}"):
        sample_pool(cell_bodies(profile), profile, "left", 10, np.random.default_rng(0))


# -- Candidates within reach: what lies behind a wall that no way passes is none ---------------------------------------


def test_poses_beyond_a_locked_range_are_out_of_reach() -> None:
    """The real cell's joint limits leave pockets: those within reach have straight ways that the gate accepts."""
    profile = load_profile(PROFILES / "ur10-ur5.yaml")
    cell, homes = cell_bodies(profile), home_positions(profile)
    q = sample_pool(cell, profile, "right", 300, np.random.default_rng(2)).q
    reached = ArmRoadmap(profile, cell, "right", np.random.default_rng(2)).reaches(q)
    assert 0.5 < reached.mean() < 0.98
    alone = replace(cell, arms={"right": cell.arms["right"]})

    def ways(rows: np.ndarray) -> float:
        hubs = np.vstack([homes["right"][None], q[reached][:8]])
        free = [[not refuse_motion(alone, {"right": hub}, {"right": row}) for hub in hubs] for row in rows]
        return float(np.mean(free))

    assert ways(q[reached][8:28]) > 2.0 * ways(q[~reached][:20])
