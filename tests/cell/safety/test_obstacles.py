"""Obstacles in the gate: distances against an independent library, invariants, what is refused and in which words."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cellapp.cell.safety.bodies import place, segment_distance
from cellapp.cell.safety.cell_bodies import cell_bodies, cover, home_positions
from cellapp.cell.safety.gate import CellBodies, clear_stops, refuse_motion, refuse_stop, visible, visible_stops
from cellapp.cell.safety.shapes import Cylinder, Obstacle, RoundedBox, Shape
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, CapsuleObstacle, CylinderObstacle, Placement, SphereObstacle
from cellapp.robot.kinematics.transforms import apply, rotation_from_vector, transform
from tests.cell.safety.test_gate import HOME, QUARTER, turnstile
from tests.twin import small_twin

SHAPES: dict[str, Shape] = {
    "box": RoundedBox(np.array([0.4, 0.25, 0.1])),
    "plate": RoundedBox(np.array([0.5, 0.5, 0.001])),
    "sphere": RoundedBox(np.zeros(3), 0.3),
    "capsule": RoundedBox(np.array([0.0, 0.0, 0.4]), 0.15),
    "cylinder": Cylinder(0.2, 0.45),
    "disc": Cylinder(0.4, 0.02),
}


def coal_shape(name: str) -> Any:
    """The same solid for the collision library."""
    coal = pytest.importorskip("coal")
    made = {
        "box": lambda: coal.Box(0.8, 0.5, 0.2),
        "plate": lambda: coal.Box(1.0, 1.0, 0.002),
        "sphere": lambda: coal.Sphere(0.3),
        "capsule": lambda: coal.Capsule(0.15, 0.8),
        "cylinder": lambda: coal.Cylinder(0.2, 0.9),
        "disc": lambda: coal.Cylinder(0.4, 0.04),
    }
    return made[name]()


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return transform(rotation_from_vector(rng.normal(size=3)), rng.uniform(-1.0, 1.0, 3))


def random_segments(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Segments about the origin, some of them points, some along an axis."""
    start = rng.uniform(-1.2, 1.2, (count, 3))
    end = start + rng.normal(size=(count, 3)) * rng.choice([0.0, 0.01, 0.5], (count, 1))
    end[: count // 4, 1:] = start[: count // 4, 1:]
    return start, end


@pytest.mark.parametrize("name", SHAPES)
def test_distances_are_those_of_the_library(name: str) -> None:
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(len(name))
    solid = coal_shape(name)
    obstacle = Obstacle(name, SHAPES[name], random_pose(rng))
    start, end = random_segments(rng, 400)
    start, end = apply(obstacle.pose, start), apply(obstacle.pose, end)
    radius = rng.uniform(0.01, 0.1, len(start))
    ours = obstacle.gaps(start, end, radius, np.inf)
    request = coal.DistanceRequest()
    at = coal.Transform3s(obstacle.pose[:3, :3], obstacle.pose[:3, 3])
    for a, b, r, gap in zip(start, end, radius, ours, strict=True):
        length = float(np.linalg.norm(b - a))
        z = (b - a) / length if length else np.array([0.0, 0.0, 1.0])
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        capsule = coal.Transform3s(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (a + b))
        theirs = coal.distance(solid, at, coal.Capsule(r, length), capsule, request, coal.DistanceResult())
        if theirs > 0.0:
            assert gap == pytest.approx(theirs, abs=2e-6)
        else:
            assert gap <= 1e-6


@pytest.mark.parametrize("name", SHAPES)
def test_no_point_of_a_segment_is_nearer_than_its_distance(name: str) -> None:
    """The distance of a point from each solid is written down once more, by its definition."""
    start, end = random_segments(np.random.default_rng(7), 300)
    share = np.linspace(0.0, 1.0, 401)[:, None, None]
    x, y, z = np.moveaxis(start + share * (end - start), 2, 0)
    shape = SHAPES[name]
    if isinstance(shape, Cylinder):
        radial = np.maximum(np.hypot(x, y) - shape.radius, 0.0)
        points = np.hypot(radial, np.maximum(np.abs(z) - shape.half_length, 0.0))
    else:
        assert isinstance(shape, RoundedBox)
        out = [np.maximum(np.abs(value) - half, 0.0) for value, half in zip((x, y, z), shape.core, strict=True)]
        points = np.sqrt(sum(value**2 for value in out)) - shape.radius
    found = shape.segment_distance(start, end)
    nearest = points.min(axis=0)
    assert np.all(found <= nearest + 1e-12)
    assert np.all(found >= nearest - np.linalg.norm(end - start, axis=1) / 800 - 1e-8)


def test_spheres_and_capsules_agree_with_distances_between_segments() -> None:
    start, end = random_segments(np.random.default_rng(2), 500)
    axis = np.array([0.0, 0.0, 0.4])
    assert SHAPES["capsule"].segment_distance(start, end) == pytest.approx(
        segment_distance(start, end, -axis, axis) - 0.15, abs=1e-9
    )
    assert SHAPES["sphere"].segment_distance(start, end) == pytest.approx(
        segment_distance(start, end, np.zeros(3), np.zeros(3)) - 0.3, abs=1e-9
    )


COORDINATES = st.floats(-2.0, 2.0, allow_nan=False, width=32)
VECTORS = hnp.arrays(np.float64, 3, elements=COORDINATES)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(SHAPES)), VECTORS, VECTORS, VECTORS, VECTORS, st.floats(0.0, 0.5), st.floats(0.0, 3.0))
def test_distances_do_not_depend_on_where_the_scene_stands(
    name: str, a: np.ndarray, b: np.ndarray, turn: np.ndarray, shift: np.ndarray, radius: float, within: float
) -> None:
    moved = transform(rotation_from_vector(turn), shift)
    obstacle = Obstacle(name, SHAPES[name], np.eye(4))
    ends = np.stack([a, b])
    gap = float(obstacle.gaps(a, b, radius, np.inf))
    a1, b1 = apply(moved, ends)
    assert float(obstacle.moved(moved).gaps(a1, b1, radius, np.inf)) == pytest.approx(gap, abs=1e-7)
    assert float(obstacle.gaps(b, a, radius, np.inf)) == pytest.approx(gap, abs=1e-7)
    # a bound in place of the distance is below the distance, and above the limit to which distances were asked for
    bound = float(obstacle.gaps(a, b, radius, within))
    assert bound <= gap + 1e-9
    assert bound > within or bound == pytest.approx(gap, abs=1e-9)
    low, high = np.minimum(a, b) - radius, np.maximum(a, b) + radius
    if obstacle.far(low, high, within):
        assert gap > within - 1e-9


@pytest.mark.parametrize("name", SHAPES)
def test_not_a_number_never_looks_far(name: str) -> None:
    obstacle = Obstacle(name, SHAPES[name], np.eye(4))
    for spoilt in ([np.nan, 5.0, 5.0], [5.0, 5.0, np.nan]):
        a, b = np.array(spoilt), np.full(3, 6.0)
        assert math.isnan(float(obstacle.gaps(a, b, 0.1, 0.05)))
        assert math.isnan(float(obstacle.gaps(b, a, 0.1, 0.05)))
        assert not obstacle.far(np.minimum(a, b), np.maximum(a, b), 0.1)


# -- covers -----------------------------------------------------------------------------------------------------------


def surface(shape: Shape, rng: np.random.Generator) -> np.ndarray:
    """Points of a solid, those of its edges and corners among them."""
    points = rng.uniform(-1.0, 1.0, (4000, 3)) * shape.half
    points[:2000] = np.sign(points[:2000]) * shape.half * rng.choice([1.0, 0.999, 0.5], (2000, 3))
    return points[shape.segment_distance(points, points) <= 1e-9]


@pytest.mark.parametrize("name", SHAPES)
def test_covers_contain_the_solid_and_reach_out_no_farther_than_they_say(name: str) -> None:
    rng = np.random.default_rng(4)
    obstacle = Obstacle(name, SHAPES[name], random_pose(rng))
    found = cover(obstacle)
    points = apply(obstacle.pose, surface(SHAPES[name], rng))[:, None]
    assert len(points) > 500
    gaps = segment_distance(points, points, found.start, found.end) - found.radius
    assert gaps.min(axis=1).max() <= 1e-9
    # points of the capsules' surfaces
    direction = rng.normal(size=(3000, 1, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    along = rng.choice([0.0, 0.3, 1.0], (3000, 1, 1))
    out = found.start + along * (found.end - found.start) + direction * found.radius[:, None]
    excess = obstacle.gaps(out.reshape(-1, 3), out.reshape(-1, 3), 0.0, np.inf)
    assert excess.max() <= found.excess + 1e-9
    if name in ("sphere", "capsule"):
        assert (len(found.radius), found.excess) == (1, 0.0)


# -- the gate ---------------------------------------------------------------------------------------------------------


def post(x: float, y: float, radius: float = 0.05) -> Obstacle:
    """A post through the plane in which the bars turn."""
    return Obstacle("post", Cylinder(radius, 1.0), transform(np.eye(3), [x, y, 0.0]))


def turning(*obstacles: Obstacle, clearance: float = 0.1) -> CellBodies:
    """A bar of 1 m that turns about the origin among obstacles."""
    return CellBodies({"a": turnstile(0.0)}, None, clearance, -1.0, math.inf, obstacles)


def at(angle: float) -> dict[str, np.ndarray]:
    return {"a": np.array([angle])}


def test_a_refusal_names_the_obstacle_and_says_by_how_much() -> None:
    cell = turning(post(1.1235, 0.0))
    assert refuse_stop(cell, at(0.0)) == "arm a: comes within 23 mm of obstacle 'post', 100 mm asked"
    assert refuse_stop(cell, at(QUARTER)) == ""
    assert refuse_motion(cell, at(-QUARTER), at(QUARTER)).startswith("arm a: comes within 2")
    assert refuse_stop(turning(post(0.9, 0.0)), at(0.0)) == "arm a: collides with obstacle 'post'"


@pytest.mark.parametrize("start", np.linspace(-1.5, -1.4, 7))
@pytest.mark.parametrize("clearance", [0.0, 0.02, 0.2])
def test_thin_obstacles_are_found_between_samples(start: float, clearance: float) -> None:
    near = turning(post(1.0 + 0.05 + clearance, 0.0, 0.001), clearance=clearance)
    assert "obstacle 'post'" in refuse_motion(near, at(start), at(1.5))
    far = turning(post(1.0 + 0.05 + clearance + 0.08, 0.0, 0.001), clearance=clearance)
    assert refuse_motion(far, at(start), at(1.5)) == ""


def test_a_larger_clearance_never_admits_more() -> None:
    rng = np.random.default_rng(5)
    obstacles = [Obstacle(name, shape, random_pose(rng)) for name, shape in SHAPES.items()]
    ways = rng.uniform(-math.pi, math.pi, (40, 2))
    admitted = [
        [not refuse_motion(turning(*obstacles, clearance=clearance), at(a), at(b)) for a, b in ways]
        for clearance in (0.0, 0.02, 0.05, 0.15, 0.4)
    ]
    assert 3 < sum(admitted[0]) < 40
    assert all(not more or less for pair in pairwise(admitted) for less, more in zip(*pair))


def with_obstacles(profile: Profile | None = None, **obstacles: Any) -> Profile:
    return (profile or small_twin()).model_copy(update={"obstacles": obstacles})


def crowded() -> Profile:
    """The twin cell with a pillar, a table with pedestals, and a gripper on the left arm."""
    return with_obstacles(
        small_twin(plan={"floor": -2.0, "clearance": 0.03}),
        pillar=CylinderObstacle(
            shape="cylinder", radius=0.1, length=2.0, pose=Placement(position=(0.7, 0.2, 0.6), rpy=(0.2, 0.0, 0.0))
        ),
        table=BoxObstacle(shape="box", size=(3.0, 3.0, 0.1), pose=Placement(position=(0.0, 0.0, -0.25))),
        left_pedestal=CylinderObstacle(
            shape="cylinder",
            fixed_to="base",
            arm="left",
            radius=0.09,
            length=0.2,
            pose=Placement(position=(0.0, 0.0, -0.1)),
        ),
        lamp=SphereObstacle(shape="sphere", radius=0.15, pose=Placement(position=(0.4, -0.6, 0.8))),
        gripper=BoxObstacle(
            shape="box",
            fixed_to="flange",
            arm="left",
            size=(0.2, 0.06, 0.05),
            pose=Placement(position=(0.1, 0.0, 0.03)),
        ),
        hose=CapsuleObstacle(
            shape="capsule",
            fixed_to="flange",
            arm="right",
            radius=0.02,
            length=0.15,
            pose=Placement(position=(0.0, -0.08, 0.0)),
        ),
    )


def random_stops(cell: CellBodies, count: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: HOME[name] + rng.uniform(-1.5, 1.5, (count, 6)) for name in cell.arms}


def test_many_stops_at_once_are_judged_as_one_by_one() -> None:
    cell = cell_bodies(crowded())
    q = random_stops(cell, 400, 1)
    q["left"][0, 2] = np.nan
    q["right"][1, 0] = 7.0
    reasons = [refuse_stop(cell, {name: value[k] for name, value in q.items()}) for k in range(400)]
    assert clear_stops(cell, q).tolist() == [not reason for reason in reasons]
    for word in ("pillar", "table", "lamp", "gripper", "each other", "itself"):
        assert any(word in reason for reason in reasons), word
    assert sum(not reason for reason in reasons) > 20
    with pytest.raises(ValueError, match="positions of left for the arms left, right"):
        clear_stops(cell, {"left": q["left"]})


def test_stops_are_seen_if_every_smr_is_seen() -> None:
    cell = cell_bodies(crowded())
    q = random_stops(cell, 4000, 3)
    one_by_one = [
        visible(cell, name, q[name], {other: q[other]}) for name, other in (("left", "right"), ("right", "left"))
    ]
    assert one_by_one[0].sum() > 10
    assert visible_stops(cell, q).tolist() == (one_by_one[0] & one_by_one[1]).tolist()


def test_bases_may_stand_on_what_links_may_not_touch() -> None:
    cell = cell_bodies(crowded())
    table, pedestal = (
        next(k for k, one in enumerate(cell.obstacles) if one.name == name) for name in ("table", "left_pedestal")
    )
    left, right = (cell.obstacle_clearances[cell.arms[name]] for name in ("left", "right"))
    assert left[pedestal].tolist() == [-np.inf, -np.inf, *[0.02] * (len(left[0]) - 2)]
    assert right[pedestal].tolist() == [-np.inf, *[0.03] * 8], "another arm's pedestal is like a pillar"
    assert left[table, :3].tolist() == [-np.inf, 0.03, 0.03], "the table is a pedestal's height below"
    assert refuse_stop(cell, HOME) == ""


def test_obstacles_of_a_base_move_with_it() -> None:
    profile = crowded()
    here = cell_bodies(profile)
    base = profile.arms["left"].base
    assert base is not None
    x, y, z = base.position
    shifted = base.model_copy(update={"position": (x - 0.1, y, z)})
    arms = {**profile.arms, "left": profile.arms["left"].model_copy(update={"base": shifted})}
    there = cell_bodies(profile.model_copy(update={"arms": arms}))
    moved = {
        one.name: (other.pose[:3, 3] - one.pose[:3, 3]).tolist()
        for one, other in zip(here.obstacles, there.obstacles, strict=True)
    }
    assert moved.pop("left_pedestal") == pytest.approx([-0.1, 0.0, 0.0])
    assert not np.any(list(moved.values()))


def test_what_a_flange_carries_is_checked_against_everything() -> None:
    bare = cell_bodies(small_twin(plan={"floor": -2.0}))
    long = BoxObstacle(
        shape="box", fixed_to="flange", arm="left", size=(0.05, 0.05, 1.2), pose=Placement(position=(0.0, 0.0, 0.65))
    )
    armed = cell_bodies(with_obstacles(small_twin(plan={"floor": -2.0}), lance=long))
    q = random_stops(armed, 600, 8)
    clear, clear_bare = clear_stops(armed, q), clear_stops(bare, q)
    assert not np.any(clear & ~clear_bare)
    assert clear.sum() < clear_bare.sum()
    reasons = [refuse_stop(armed, {name: value[k] for name, value in q.items()}) for k in np.flatnonzero(clear_bare)]
    assert any("each other" in reason for reason in reasons)
    low = dataclasses.replace(armed, floor=0.0)
    assert sum("floor" in refuse_stop(low, {name: value[k] for name, value in q.items()}) for k in range(100)) > 3


def test_levers_hold_for_what_a_flange_carries() -> None:
    arm = cell_bodies(crowded()).arms["left"]
    rng, step = np.random.default_rng(0), 1e-6
    for joint in range(6):
        q = rng.uniform(-math.pi, math.pi, (200, 6))
        turned = q.copy()
        turned[:, joint] += step
        before, after = place(arm, q), place(arm, turned)
        moved = np.linalg.norm(after.end - before.end, axis=2).max(axis=0) / step
        assert np.all(moved <= arm.body_levers[:, joint] + 1e-6)


# -- the tracker's beam -----------------------------------------------------------------------------------------------


def test_an_obstacle_in_the_beam_hides_the_smr() -> None:
    bare = cell_bodies(small_twin())
    rng = np.random.default_rng(2)
    q = rng.uniform(-math.pi, math.pi, (20_000, 6))
    q = q[visible(bare, "left", q)]
    assert bare.field is not None
    head = bare.field.T_C_M[:3, 3]
    smr = place(bare.arms["left"], q).smr
    wall = RoundedBox(np.array([0.01, 0.4, 0.4]))
    middle = 0.5 * (head + smr.mean(axis=0))
    cell = dataclasses.replace(bare, obstacles=(Obstacle("screen", wall, transform(np.eye(3), middle)),))
    seen = visible(cell, "left", q)
    share = (middle[0] - head[0]) / (smr[:, 0] - head[0])
    crossing = head + share[:, None] * (smr - head)
    inside = np.all(np.abs(crossing - middle)[:, 1:] < 0.4, axis=1)
    outside = np.any(np.abs(crossing - middle)[:, 1:] > 0.45, axis=1)
    assert inside.sum() > 20
    assert outside.sum() > 20
    assert not seen[inside].any()
    assert seen[outside].all()


def test_what_an_arm_carries_hides_its_own_smr_only_from_behind() -> None:
    """A plate beside the SMR, nearer to it than the beam's radius, hides it where the beam crosses the plate."""
    profile = small_twin()
    offset = profile.arms["left"].smr.offset
    assert not isinstance(offset, str)
    x, y, z = offset
    beside = BoxObstacle(
        shape="box",
        fixed_to="flange",
        arm="left",
        size=(0.01, 0.2, 0.2),
        pose=Placement(position=(x + 0.02, y, z + 0.05)),
    )
    holder = SphereObstacle(shape="sphere", fixed_to="flange", arm="left", radius=0.03, pose=Placement(position=offset))
    bare, plate, ball = (
        cell_bodies(one) for one in (profile, with_obstacles(plate=beside), with_obstacles(ball=holder))
    )
    q = np.random.default_rng(6).uniform(-math.pi, math.pi, (30_000, 6))
    q = q[visible(bare, "left", q)]
    assert len(q) > 100
    assert visible(ball, "left", q).all(), "what encloses the SMR is its holder"
    seen = visible(plate, "left", q)
    assert bare.field is not None
    bodies = place(bare.arms["left"], q)
    beam_F = np.einsum("nba,nb->na", bodies.flange, bare.field.T_C_M[:3, 3] - bodies.smr)
    assert not seen[beam_F[:, 0] > 0.05].any()
    assert seen[beam_F[:, 0] < 0.0].all()
    assert 0.2 < seen.mean() < 0.8


# -- bad input --------------------------------------------------------------------------------------------------------


def test_obstacles_that_hold_an_arm_or_the_tracker_are_named() -> None:
    profile = small_twin()
    assert profile.tracker.pose is not None
    inside = SphereObstacle(shape="sphere", radius=0.2, pose=Placement(position=profile.tracker.pose.position))
    with pytest.raises(InputError, match=r"profile .*: obstacles\.cupboard\.pose: the tracker's head, tracker\.pose"):
        cell_bodies(with_obstacles(cupboard=inside))
    base = profile.arms["right"].base
    assert base is not None
    x, y, z = base.position
    above = SphereObstacle(shape="sphere", radius=0.2, pose=Placement(position=(x, y, z + 0.7)))
    with pytest.raises(InputError, match=r"obstacles\.balloon\.pose: arm right at home reaches \d+ mm into it"):
        cell_bodies(with_obstacles(balloon=above))
    assert home_positions(profile).keys() == {"left", "right"}
