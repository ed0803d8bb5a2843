"""Safety gate: motions that it must refuse, and independent checks that the motions it admits are safe."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from cellapp.cell.planning.candidates import sample_pool
from cellapp.cell.planning.view import why_hidden as hidden_words
from cellapp.cell.safety.bodies import ArmBodies, TrackerField, place, segment_distance
from cellapp.cell.safety.cell_bodies import cell_bodies, cover, home_positions
from cellapp.cell.safety.gate import (
    CellBodies,
    FreeMotions,
    allowed_apart_m,
    apart_m,
    clear_stops,
    free_motions,
    gap_at_rest,
    on_rows,
    predicted_smr,
    refuse_motion,
    refuse_stop,
    visible,
    visible_stops,
)
from cellapp.cell.safety.shapes import Cylinder, ObstacleBody, RoundedBox, Shape
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.transforms import apply, rotation_from_vector, transform
from drivers.plant.clearance import segment_distances
from drivers.plant.config import TrackerConfig
from drivers.plant.optics import why_hidden
from tests.sure import sure
from tests.twin import small_twin, with_arm, with_obstacles

QUARTER = math.pi / 2.0


def turnstile(x: float, radius: float = 0.05) -> ArmBodies:
    """A bar of 1 m that turns about the vertical through (x, 0, 0), its SMR at the tip."""
    return ArmBodies(
        geometry=nominal_geometry(np.array([[0.0, 0.0, 1.0, 0.0]]), np.zeros(3), transform(np.eye(3), [x, 0.0, 0.0])),
        frames=np.array([1]),
        start=np.array([[-1.0, 0.0, 0.0]]),
        end=np.zeros((1, 3)),
        radius=np.array([radius]),
        limits=np.array([[-math.pi, math.pi]]),
        normal_F=np.array([1.0, 0.0, 0.0]),
        acceptance=1.0,
    )


@pytest.fixture
def turnstiles() -> CellBodies:
    """Two bars 1.5 m apart: they meet where both point at each other."""
    return CellBodies({"a": turnstile(0.0), "b": turnstile(1.5)}, None, 0.1, -1.0)


@pytest.fixture(scope="module")
def twin() -> CellBodies:
    return cell_bodies(small_twin())


HOME = home_positions(small_twin())


def at(**q: float) -> dict[str, np.ndarray]:
    return {name: np.array([value]) for name, value in q.items()}


def test_stops_at_which_bars_collide_are_refused(turnstiles: CellBodies) -> None:
    assert refuse_stop(turnstiles, at(a=0.0, b=math.pi)) == "arms a and b: collide with each other"
    assert refuse_stop(turnstiles, at(a=QUARTER, b=math.pi)) == ""


def test_a_motion_between_safe_stops_is_refused_if_it_collides(turnstiles: CellBodies) -> None:
    here, there = at(a=-QUARTER, b=math.pi), at(a=QUARTER, b=math.pi)
    assert refuse_stop(turnstiles, here) == refuse_stop(turnstiles, there) == ""
    assert "each other" in refuse_motion(turnstiles, here, there)
    # the other way round it is free
    assert refuse_motion(turnstiles, at(a=-QUARTER, b=0.0), at(a=QUARTER, b=0.0)) == ""


def test_a_motion_must_be_safe_at_any_relative_speed(turnstiles: CellBodies) -> None:
    here, there = at(a=-QUARTER, b=math.pi), at(a=QUARTER, b=QUARTER)
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    placed = {name: place(turnstiles.arms[name], here[name] + share * (there[name] - here[name])) for name in here}
    a, b = placed["a"], placed["b"]
    in_step = segment_distances(a.start[:, 0], a.end[:, 0], b.start[:, 0], b.end[:, 0]) - 0.1
    assert in_step.min() > turnstiles.clearance + 0.05, "at the same speed they keep well apart"
    assert "each other" in refuse_motion(turnstiles, here, there), "but b may start late"


def test_the_clearance_is_kept_between_samples_too() -> None:
    # b's tip lies just inside the clearance of the circle that a's tip runs on, wherever the samples happen to fall
    for clearance in (0.02, 0.05, 0.2):
        for start in np.linspace(-1.5, -1.4, 11):
            far = 2.0 + clearance + 0.1 - 0.001
            cell = CellBodies({"a": turnstile(0.0), "b": turnstile(far)}, None, clearance, -1.0)
            assert "of each other" in refuse_motion(cell, at(a=start, b=math.pi), at(a=1.5, b=math.pi))


@pytest.mark.parametrize("start", [-1.0, 0.3, 0.9])
def test_a_motion_is_checked_to_its_very_end(start: float) -> None:
    """A bar turns head on towards a post on the circle of its tip, up to a gap from it; 0.1 m is asked."""
    for gap, free in ((0.099, False), (0.16, True)):
        angle = 1.0 + 2.0 * math.asin((gap + 0.05 + 0.05) / 2.0)
        cell = turning(post(math.cos(angle), math.sin(angle)))
        said = refuse_motion(cell, at(a=start), at(a=1.0))
        assert (said == "") is free, said


def test_arms_at_once_may_be_apart_by_what_the_slower_one_runs_until_all_are_stopped(turnstiles: CellBodies) -> None:
    lever = float(turnstiles.arms["a"].levers[0])
    paths = {"a": np.array([[0.0], [0.01], [0.02]]), "b": np.array([[0.0], [0.01], [0.04]])}
    assert allowed_apart_m(turnstiles, paths, 0.1) == pytest.approx(0.05 + 0.5 * 0.01 * lever / 0.1)
    assert allowed_apart_m(turnstiles, {"a": paths["a"]}, 0.1) == 0.0
    assert apart_m(turnstiles, paths, at(a=0.01, b=0.01)) == 0.0
    assert apart_m(turnstiles, paths, at(a=0.02, b=0.0)) == pytest.approx(
        0.02 * lever
    )  # from the first row or the second


def test_the_gap_of_arms_at_rest_is_that_of_their_nearest_bodies(twin: CellBodies) -> None:
    rng, within = np.random.default_rng(4), 1.2
    a, b = (place(arm, rng.uniform(-2.5, 2.5, (400, 6))) for arm in twin.arms.values())
    expected = np.min(
        [
            segment_distances(a.start[:, i], a.end[:, i], b.start[:, k], b.end[:, k]) - a.radius[i] - b.radius[k]
            for i in range(len(a.radius))
            for k in range(len(b.radius))
        ],
        axis=0,
    )
    found, near = gap_at_rest(a, b, within), expected < within
    assert 20 < near.sum() < 380
    np.testing.assert_allclose(found[near], expected[near], atol=1e-9)
    assert (found[~near] >= within).all()


def test_nan_and_vectors_of_wrong_length_are_refused(twin: CellBodies) -> None:
    for bad in (np.nan, np.inf):
        q = HOME["left"].copy()
        q[3] = bad
        assert refuse_motion(twin, HOME, {**HOME, "left": q}) == "arm left: a joint position is not a finite number"
        assert refuse_motion(twin, {**HOME, "left": q}, HOME) == "arm left: a joint position is not a finite number"
    assert refuse_motion(twin, HOME, {**HOME, "left": np.zeros(5)}) == "arm left: 5 joint positions for 6 joints"
    assert refuse_motion(twin, {**HOME, "left": np.zeros(7)}, HOME) == "arm left: 7 joint positions for 6 joints"
    assert "for 6 joints" in refuse_motion(twin, HOME, {**HOME, "left": np.array(0.0)})
    assert "for 6 joints" in refuse_motion(twin, HOME, {**HOME, "left": HOME["left"][None]})


def test_unknown_arms_and_arms_without_bodies_are_refused(twin: CellBodies) -> None:
    assert "arm middle" in refuse_motion(twin, HOME, {**HOME, "middle": np.zeros(6)})
    assert "arm right: its position or target is not given" in refuse_motion(twin, {"left": HOME["left"]}, HOME)
    assert "arm right: its position or target is not given" in refuse_motion(twin, HOME, {"left": HOME["left"]})
    nothing = np.zeros((0, 3))
    bare = dataclasses.replace(
        twin.arms["left"], frames=np.zeros(0, dtype=np.int64), start=nothing, end=nothing, radius=np.zeros(0)
    )
    cell = dataclasses.replace(twin, arms={**twin.arms, "left": bare})
    assert "arm left: has no bodies" in refuse_stop(cell, HOME)


def test_home_is_safe_and_limits_hold(twin: CellBodies) -> None:
    assert refuse_stop(twin, HOME) == ""
    q = HOME["right"].copy()
    q[5] = 2.0 * math.pi + 1e-6
    assert "arm right: joint 6 at 360.0 deg is outside its limits -360.0 to 360.0 deg" in refuse_motion(
        twin, HOME, {**HOME, "right": q}
    )
    q[5] = 2.0 * math.pi
    assert refuse_motion(twin, HOME, {**HOME, "right": q}) == ""


def test_an_arm_outside_its_limits_may_come_back(twin: CellBodies) -> None:
    outside = HOME["left"].copy()
    outside[5] = 6.5
    assert refuse_motion(twin, {**HOME, "left": outside}, HOME) == ""


def test_the_floor(twin: CellBodies) -> None:
    down = HOME["left"].copy()
    down[1] = math.radians(30.0)
    assert "arm left: collides with the floor" in refuse_motion(twin, HOME, {**HOME, "left": down})
    # over the top from one side to the other is free, the short way underneath is not
    side = HOME["left"].copy()
    side[1] = math.radians(-178.0)
    other = side.copy()
    other[1] = math.radians(178.0)
    assert refuse_stop(twin, {**HOME, "left": side}) == refuse_stop(twin, {**HOME, "left": other}) == ""
    assert "floor" in refuse_motion(twin, {**HOME, "left": side}, {**HOME, "left": other})


def test_an_arm_that_folds_onto_itself(twin: CellBodies) -> None:
    folded = HOME["left"].copy()
    folded[2] = math.radians(178.0)
    folded[3] = 0.0
    assert refuse_motion(twin, HOME, {**HOME, "left": folded}) != ""
    assert "with itself" in refuse_stop(dataclasses.replace(twin, floor=-5.0), {**HOME, "left": folded})


def predicted_end(cell: CellBodies, name: str, q: np.ndarray) -> np.ndarray:
    """From an arm's base to its SMR, in the cell."""
    arm = cell.arms[name]
    return np.asarray(place(arm, q[None]).smr[0] - arm.geometry.T_M_B()[:3, 3])


def test_arms_that_reach_for_each_other(twin: CellBodies) -> None:
    cell = dataclasses.replace(twin, floor=-5.0)
    # both stretched out level, in all directions: they meet only where both point at the other's base
    stretched = {name: q.copy() for name, q in HOME.items()}
    way = cell.arms["right"].geometry.T_M_B()[:3, 3] - cell.arms["left"].geometry.T_M_B()[:3, 3]
    refused = []
    for turn in np.arange(-math.pi, math.pi, QUARTER):
        for other in np.arange(-math.pi, math.pi, QUARTER):
            for name, q1 in (("left", turn), ("right", other)):
                stretched[name][:2] = q1, 0.0
            reason = refuse_stop(cell, stretched)
            if reason:
                assert reason.startswith("arms left and right: ")
                ends = {name: predicted_end(cell, name, q) for name, q in stretched.items()}
                refused.append((bool(ends["left"] @ way > 0.5), bool(ends["right"] @ way < -0.5)))
    assert refused == [(True, True)]


def test_admitted_motions_keep_clear_by_the_distances_of_the_plant(twin: CellBodies) -> None:
    """Admitted motions are sampled densely at random relative speeds; the plant computes the distances."""
    rng = np.random.default_rng(3)
    passed = 0
    for _ in range(30):
        here, there = ({name: HOME[name] + rng.uniform(-1.2, 1.2, 6) for name in HOME} for _ in range(2))
        if refuse_motion(twin, here, there):
            continue
        passed += 1
        placed = {}
        for name, arm in twin.arms.items():
            placed[name] = place(arm, here[name] + np.linspace(0.0, 1.0, 500)[:, None] * (there[name] - here[name]))
            body = placed[name]
            moving = body.frames > 1
            lowest = np.minimum(body.start[:, moving, 2], body.end[:, moving, 2]) - body.radius[moving]
            assert lowest.min() - twin.floor >= twin.clearance
            i, k = np.triu_indices(len(body.radius), 1)
            far = np.abs(body.frames[i] - body.frames[k]) > 2
            i, k = i[far], k[far]
            gap = segment_distances(body.start[:, i], body.end[:, i], body.start[:, k], body.end[:, k])
            assert (gap - body.radius[i] - body.radius[k]).min() > 0.0
        first, second = placed["left"], placed["right"]
        rows = rng.integers(0, 500, (2, 1500))
        gap = segment_distances(
            first.start[rows[0]][:, :, None],
            first.end[rows[0]][:, :, None],
            second.start[rows[1]][:, None],
            second.end[rows[1]][:, None],
        )
        assert (gap - first.radius[:, None] - second.radius).min() >= twin.clearance
    assert passed >= 5


@pytest.mark.parametrize("joint", range(6))
def test_no_body_point_moves_farther_than_its_lever_allows(twin: CellBodies, joint: int) -> None:
    rng = np.random.default_rng(joint)
    step = 1e-5
    for arm in twin.arms.values():
        q = rng.uniform(-math.pi, math.pi, (400, 6))
        turned = q.copy()
        turned[:, joint] += step
        before, after = place(arm, q), place(arm, turned)
        for one, other in ((before.start, after.start), (before.end, after.end)):
            moved = np.linalg.norm(other - one, axis=2) / step
            # a capsule's surface is its radius farther out
            carried = before.frames > joint
            assert np.all(moved[:, carried] + before.radius[carried] <= arm.levers[joint] + 1e-6)
            assert np.all(moved[:, ~carried] < 1e-6)


@pytest.mark.parametrize("azimuth", [(-2 * math.pi, 2 * math.pi), (-0.05, 0.4), (6.2, 6.6), (3.0, 6.5), (2.0, 4.0)])
def test_visible_smrs_are_visible_to_the_simulated_optics(twin: CellBodies, azimuth: tuple[float, float]) -> None:
    """By the plant's own rules; azimuth ranges may be written over the cut at half a turn."""
    field = dataclasses.replace(sure(twin.field), azimuth=azimuth, distance=(2.8, 4.4), elevation=(-0.1, 0.2))
    cell = dataclasses.replace(twin, field=field)
    optics = TrackerConfig(T_C_M=field.T_C_M, azimuth=azimuth, elevation=field.elevation, distance=field.distance)
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (20_000, 6))
    for name, arm in cell.arms.items():
        seen = visible(cell, name, q)
        normal_M = place(arm, q).normal @ field.T_C_M[:3, :3]
        p_M = predicted_smr(cell, name, q)
        hidden = [why_hidden(optics, p, n, arm.acceptance) for p, n in zip(p_M, normal_M)]
        assert not any(text for text, s in zip(hidden, seen) if s)
        reachable = sum(not text for text in hidden)
        assert (reachable > 50) == (azimuth != (2.0, 4.0)), "the arms stand before the tracker, not behind it"
        assert seen.sum() >= 0.4 * reachable, "what is not seen is near the acceptance's edge or behind a body"


def test_a_body_in_the_beam_hides_the_smr() -> None:
    T_C_M = transform(np.eye(3), [4.0, 0.0, 0.0])
    field = TrackerField(T_C_M, (-2 * math.pi, 2 * math.pi), (-1.0, 1.0), (0.5, 10.0))
    cell = CellBodies({"a": turnstile(0.0), "b": turnstile(2.5)}, field, 0.1, -1.0)
    assert visible(cell, "a", np.zeros((1, 1))).tolist() == [True]
    assert visible(cell, "a", np.zeros((2, 1)), {"b": np.array([[0.0], [QUARTER]])}).tolist() == [False, False]
    assert visible(cell, "a", np.array([[0.3]]), {"b": np.array([[-QUARTER]])}).tolist() == [True]
    assert visible(cell, "a", np.array([[0.3]]), {"b": np.array([[QUARTER]])}).tolist() == [False]
    assert visible(cell, "a", np.full((1, 1), math.pi)).tolist() == [False], "it looks away"
    assert not visible(dataclasses.replace(cell, field=None), "a", np.zeros((1, 1))).any()


# -- Why an SMR is hidden, in words ------------------------------------------------------------------------------------


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


def box(position: list[float], size: float) -> ObstacleBody:
    return ObstacleBody("pillar", RoundedBox(np.full(3, 0.5 * size)), transform(np.eye(3), position))


def moved(**changes: Any) -> CellBodies:
    return bars(field=dataclasses.replace(FIELD, **changes))


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
    assert reason in hidden_words(cell, q)


def test_the_other_arm_in_the_beam_is_named() -> None:
    cell = CellBodies({"a": turnstile(0.0), "b": turnstile(1.5)}, FIELD, 0.1, -1.0)
    assert hidden_words(cell, SEEN) == "arm b: arm a is in the beam to its SMR"


def test_a_mounted_obstacle_is_named() -> None:
    cap = ObstacleBody("cap", RoundedBox(np.full(3, 0.02)), transform(np.eye(3), [0.1, 0.0, 0.0]))
    assert "mounted beside the SMR" in hidden_words(changed(turnstile(0.0), mounted=(cap,)), SEEN)


def test_there_is_a_reason_exactly_where_the_gate_sees_nothing() -> None:
    profile = small_twin()
    cell, rng = cell_bodies(profile), np.random.default_rng(6)
    usable = {name: sample_pool(cell, profile, name, 60, rng).q for name in cell.arms}
    q = {name: np.concatenate([seen, rng.uniform(-2.0, 2.0, (60, 6))]) for name, seen in usable.items()}
    seen = visible_stops(cell, q)
    assert 20 < seen.sum() < 100
    for k in range(120):
        reason = hidden_words(cell, {name: value[k] for name, value in q.items()})
        assert (reason == "") == seen[k]
        assert "does not see its SMR" not in reason, "every reason has a name"


# -- Obstacles, and what a base or a flange carries --------------------------------------------------------------------


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
    obstacle = ObstacleBody(name, SHAPES[name], random_pose(rng))
    start, end = random_segments(rng, 400)
    start, end = apply(obstacle.pose, start), apply(obstacle.pose, end)
    radius = rng.uniform(0.01, 0.1, len(start))
    ours = obstacle.gaps(start, end, radius, np.inf)
    request = coal.DistanceRequest()
    placed = coal.Transform3s(obstacle.pose[:3, :3], obstacle.pose[:3, 3])
    for a, b, r, gap in zip(start, end, radius, ours, strict=True):
        length = float(np.linalg.norm(b - a))
        z = (b - a) / length if length else np.array([0.0, 0.0, 1.0])
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        capsule = coal.Transform3s(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (a + b))
        theirs = coal.distance(solid, placed, coal.Capsule(r, length), capsule, request, coal.DistanceResult())
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


# -- covers -----------------------------------------------------------------------------------------------------------


def surface(shape: Shape, rng: np.random.Generator) -> np.ndarray:
    """Points of a solid, those of its edges and corners among them."""
    points = rng.uniform(-1.0, 1.0, (4000, 3)) * shape.half
    points[:2000] = np.sign(points[:2000]) * shape.half * rng.choice([1.0, 0.999, 0.5], (2000, 3))
    return points[shape.segment_distance(points, points) <= 1e-9]


@pytest.mark.parametrize("name", SHAPES)
def test_covers_contain_the_solid_and_reach_out_no_farther_than_they_say(name: str) -> None:
    rng = np.random.default_rng(4)
    obstacle = ObstacleBody(name, SHAPES[name], random_pose(rng))
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


def post(x: float, y: float, radius: float = 0.05) -> ObstacleBody:
    """A post through the plane in which the bars turn."""
    return ObstacleBody("post", Cylinder(radius, 1.0), transform(np.eye(3), [x, y, 0.0]))


def turning(*obstacles: ObstacleBody, clearance: float = 0.1) -> CellBodies:
    """A bar of 1 m that turns about the origin among obstacles."""
    return CellBodies({"a": turnstile(0.0)}, None, clearance, -1.0, math.inf, obstacles)


def test_a_refusal_names_the_obstacle_and_says_by_how_much() -> None:
    cell = turning(post(1.1235, 0.0))
    assert refuse_stop(cell, at(a=0.0)) == "arm a: comes within 23 mm of obstacle 'post', 100 mm asked"
    assert refuse_stop(cell, at(a=QUARTER)) == ""
    assert refuse_motion(cell, at(a=-QUARTER), at(a=QUARTER)).startswith("arm a: comes within 2")
    assert refuse_stop(turning(post(0.9, 0.0)), at(a=0.0)) == "arm a: collides with obstacle 'post'"


def test_a_larger_clearance_never_admits_more() -> None:
    rng = np.random.default_rng(5)
    obstacles = [ObstacleBody(name, shape, random_pose(rng)) for name, shape in SHAPES.items()]
    ways = rng.uniform(-math.pi, math.pi, (40, 2))
    admitted = [
        [not refuse_motion(turning(*obstacles, clearance=clearance), at(a=a), at(a=b)) for a, b in ways]
        for clearance in (0.0, 0.02, 0.05, 0.15, 0.4)
    ]
    assert 3 < sum(admitted[0]) < 40
    assert all(not more or less for pair in pairwise(admitted) for less, more in zip(*pair))


CROWD = """
pillar: {shape: cylinder, radius: 0.1, length: 2.0, pose: {position: [0.7, 0.2, 0.6], rpy: [0.2, 0.0, 0.0]}}
table: {shape: box, size: [3.0, 3.0, 0.1], pose: {position: [0.0, 0.0, -0.25]}}
left_pedestal: {shape: cylinder, fixed_to: base, arm: left, radius: 0.09, length: 0.2, pose: {position: [0, 0, -0.1]}}
lamp: {shape: sphere, radius: 0.15, pose: {position: [0.4, -0.6, 0.8]}}
gripper: {shape: box, fixed_to: flange, arm: left, size: [0.2, 0.06, 0.05], pose: {position: [0.1, 0.0, 0.03]}}
hose: {shape: capsule, fixed_to: flange, arm: right, radius: 0.02, length: 0.15, pose: {position: [0.0, -0.08, 0.0]}}
"""


def crowded(more: str = "") -> Profile:
    """The twin cell with a pillar, a table with pedestals, and a gripper on the left arm."""
    return with_obstacles(CROWD + more, small_twin(plan={"floor": -2.0, "clearance": 0.03}))


def random_stops(cell: CellBodies, count: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: HOME[name] + rng.uniform(-1.5, 1.5, (count, 6)) for name in cell.arms}


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
    base = sure(profile.arms["left"].base)
    x, y, z = base.position
    there = cell_bodies(with_arm(profile, "left", base={"position": (x - 0.1, y, z)}))
    moved = {
        one.name: (other.pose[:3, 3] - one.pose[:3, 3]).tolist()
        for one, other in zip(here.obstacles, there.obstacles, strict=True)
    }
    assert moved.pop("left_pedestal") == pytest.approx([-0.1, 0.0, 0.0])
    assert not np.any(list(moved.values()))


def test_what_a_flange_carries_is_checked_against_everything() -> None:
    bare = cell_bodies(small_twin(plan={"floor": -2.0}))
    long = "lance: {shape: box, fixed_to: flange, arm: left, size: [0.05, 0.05, 1.2], pose: {position: [0, 0, 0.65]}}"
    armed = cell_bodies(with_obstacles(long, small_twin(plan={"floor": -2.0})))
    q = random_stops(armed, 600, 8)
    clear, clear_bare = clear_stops(armed, q), clear_stops(bare, q)
    assert not np.any(clear & ~clear_bare)
    assert clear.sum() < clear_bare.sum()
    reasons = [refuse_stop(armed, {name: value[k] for name, value in q.items()}) for k in np.flatnonzero(clear_bare)]
    assert any("each other" in reason for reason in reasons)
    low = dataclasses.replace(armed, floor=0.0)
    assert sum("floor" in refuse_stop(low, {name: value[k] for name, value in q.items()}) for k in range(100)) > 3


# -- the tracker's beam -----------------------------------------------------------------------------------------------


def test_an_obstacle_in_the_beam_hides_the_smr() -> None:
    bare = cell_bodies(small_twin())
    rng = np.random.default_rng(2)
    q = rng.uniform(-math.pi, math.pi, (20_000, 6))
    q = q[visible(bare, "left", q)]
    head = sure(bare.field).T_C_M[:3, 3]
    smr = place(bare.arms["left"], q).smr
    wall = RoundedBox(np.array([0.01, 0.4, 0.4]))
    middle = 0.5 * (head + smr.mean(axis=0))
    cell = dataclasses.replace(bare, obstacles=(ObstacleBody("screen", wall, transform(np.eye(3), middle)),))
    seen = visible(cell, "left", q)
    share = (middle[0] - head[0]) / (smr[:, 0] - head[0])
    crossing = head + share[:, None] * (smr - head)
    inside = np.all(np.abs(crossing - middle)[:, 1:] < 0.4, axis=1)
    outside = np.any(np.abs(crossing - middle)[:, 1:] > 0.45, axis=1)
    assert inside.sum() > 20
    assert outside.sum() > 20
    assert not seen[inside].any()
    assert seen[outside].all()


# -- bad input --------------------------------------------------------------------------------------------------------


def test_obstacles_that_hold_an_arm_or_the_tracker_are_named() -> None:
    profile = small_twin()
    x, y, z = sure(profile.tracker.pose).position
    with pytest.raises(InputError, match=r"profile .*: obstacles\.cupboard\.pose: the tracker's head, tracker\.pose"):
        cell_bodies(with_obstacles(f"cupboard: {{shape: sphere, radius: 0.2, pose: {{position: [{x}, {y}, {z}]}}}}"))
    base = sure(profile.arms["right"].base)
    x, y, z = base.position
    with pytest.raises(InputError, match=r"obstacles\.balloon\.pose: arm right at home reaches \d+ mm into it"):
        cell_bodies(
            with_obstacles(f"balloon: {{shape: sphere, radius: 0.2, pose: {{position: [{x}, {y}, {z + 0.7}]}}}}")
        )
    assert home_positions(profile).keys() == {"left", "right"}


# -- Many motions at once ----------------------------------------------------------------------------------------------


def motions(cell: CellBodies, count: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Short and long motions; with a position that is no number, and a target outside the limits."""
    start, end = random_stops(cell, count, 1), random_stops(cell, count, 2)
    rng = np.random.default_rng(3)
    for name, q in end.items():
        q[::2] = start[name][::2] + rng.normal(0.0, 0.05, q[::2].shape)
        end[name] = np.clip(q, *cell.arms[name].limits.T)
    first, last = next(iter(start)), next(reversed(end))
    start[first][5, 2] = end[last][6, 0] = np.nan
    end[last][7, 1] = cell.arms[last].limits[1, 1] + 0.1
    return start, end


@pytest.mark.parametrize(
    ("profile", "apart"), [(small_twin(), 0.0), (small_twin(), 0.3), (crowded(), 0.0)], ids=["twin", "apart", "crowded"]
)
def test_many_motions_are_judged_as_one_by_one(profile, apart, monkeypatch) -> None:
    cell = replace(cell_bodies(profile), apart=apart)
    start, end = motions(cell, 160)
    of = [({name: q[k] for name, q in start.items()}, {name: q[k] for name, q in end.items()}) for k in range(160)]
    expected = np.array([not refuse_motion(cell, *motion) for motion in of])
    assert 5 < expected.sum() < 155
    np.testing.assert_array_equal(free_motions(cell, start, end), expected)
    known = FreeMotions(cell)
    known.ask(of[:100])
    monkeypatch.setattr("cellapp.cell.safety.gate.free_motions", None)  # what was asked is not asked again
    known.ask(of[:100])
    assert [known.free(*motion) for motion in of] == expected.tolist()


def test_a_path_that_only_comes_near_between_its_ends_is_refused() -> None:
    cell = cell_bodies(small_twin())
    start, end = motions(cell, 400)
    ends_free = free_motions(cell, start, start) & free_motions(cell, end, end)
    refused = np.flatnonzero(ends_free & ~free_motions(cell, start, end))
    assert len(refused) > 5
    for k in refused[:5].tolist():
        assert refuse_motion(cell, {n: q[k] for n, q in start.items()}, {n: q[k] for n, q in end.items()})


def test_other_arms_than_those_of_the_cell_are_no_motion() -> None:
    cell = cell_bodies(small_twin())
    with pytest.raises(ValueError, match="for the arms left, right"):
        free_motions(cell, {"left": np.zeros((1, 6))}, {"left": np.zeros((1, 6))})


def test_a_path_is_read_at_another_rate_without_leaving_it() -> None:
    path = np.linspace([0.0, 1.0], [0.8, -1.0], 101)
    for wanted_s in (0.008, 0.002, 0.01):
        rows = on_rows(path, 0.008, wanted_s)
        assert len(rows) == pytest.approx(0.8 / wanted_s, abs=1.5)
        assert rows[[0, -1]] == pytest.approx(path[[0, -1]])
        assert rows[:-1, 0] == pytest.approx(wanted_s * np.arange(len(rows) - 1))  # joint 1 turns by 1 rad/s
        assert rows[:, 1] == pytest.approx(1.0 - 2.5 * rows[:, 0])
