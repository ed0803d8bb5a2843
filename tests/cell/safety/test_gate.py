"""Safety gate: motions that it must refuse, and independent checks that the motions it admits are safe."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from cellapp.cell.safety.bodies import ArmBodies, place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, predicted_smr, refuse_motion, refuse_stop, visible
from cellapp.cell.safety.visibility import TrackerField
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.transforms import transform
from drivers.plant.clearance import segment_distances
from drivers.plant.config import TrackerConfig
from drivers.plant.optics import why_hidden
from tests.twin import small_twin

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


@pytest.mark.parametrize("start", np.linspace(-1.5, -1.45, 9))
def test_thin_bars_do_not_slip_through_between_samples(start: float) -> None:
    cell = CellBodies({"a": turnstile(0.0, 0.001), "b": turnstile(2.0015, 0.001)}, None, 0.0, -1.0)
    assert "of each other" in refuse_motion(cell, at(a=start, b=math.pi), at(a=1.5, b=math.pi))
    assert refuse_motion(cell, at(a=start, b=1.0), at(a=1.5, b=1.0)) == ""


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


def test_the_ceiling(twin: CellBodies) -> None:
    low = dataclasses.replace(twin, ceiling=1.2)  # the upright UR10 is 1.43 m high
    assert "arm left: collides with the ceiling" in refuse_stop(low, HOME)
    assert refuse_stop(dataclasses.replace(twin, ceiling=1.6), HOME) == ""


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
    assert twin.field is not None
    field = dataclasses.replace(twin.field, azimuth=azimuth, distance=(2.8, 4.4), elevation=(-0.1, 0.2))
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
