"""Plans: every stop inside the limits, visible and safe; reproducible; one-sentence errors where none is possible."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import open_cell
from cellapp.cell.planning.plan import plan_run, plan_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, predicted_smr, refuse_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, CancelToken, Progress
from drivers.plant.clearance import segment_distances
from tests.twin import small_twin, with_arms

pytestmark = pytest.mark.fast


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(small_twin())


def test_the_shape_and_the_limits(plan: dict[str, np.ndarray]) -> None:
    twin = cell_bodies(small_twin())
    assert list(plan) == ["left", "right"]
    for name, q in plan.items():
        assert q.shape == (30, 6)
        assert np.all((q >= twin.arms[name].limits[:, 0]) & (q <= twin.arms[name].limits[:, 1]))
        assert np.ptp(q, axis=0).min() > math.radians(60.0), "every joint is moved a good way"


def test_limits_and_ranges_of_the_cell_hold() -> None:
    limits = tuple((-2.5, -0.5) if joint == 1 else (-3.0, 3.0) for joint in range(6))
    ranges = tuple((-1.0, 4.0) if joint == 4 else (-6.0, 6.0) for joint in range(6))
    for q in plan_stops(with_arms(small_twin(8, plan={"ranges": ranges}), limits=limits)).values():
        assert np.all((q[:, 1] >= -2.5) & (q[:, 1] <= -0.5))
        assert np.all((q[:, 4] >= -1.0) & (q[:, 4] <= 3.0))


def test_the_gate_admits_every_motion_from_home_and_back(plan: dict[str, np.ndarray]) -> None:
    profile = small_twin()
    cell, home = cell_bodies(profile), home_positions(profile)
    stops = [home, *({name: q[k] for name, q in plan.items()} for k in range(30)), home]
    assert [refuse_motion(cell, here, there) for here, there in pairwise(stops)] == [""] * 31


@pytest.mark.parametrize("seed", range(6))
def test_home_can_be_reached_from_the_last_stop(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a cell where home can only be entered with the last joint turned to one side."""
    profile = small_twin(2).model_copy(update={"seed": seed})
    homes = home_positions(profile)

    def refuse(cell: CellBodies, here: dict[str, np.ndarray], there: dict[str, np.ndarray]) -> str:
        entered = np.array_equal(there["left"], homes["left"]) and here["left"][5] < 0.0
        return "home is entered from the wrong side" if entered else refuse_motion(cell, here, there)

    monkeypatch.setattr("cellapp.cell.planning.plan.refuse_motion", refuse)
    assert plan_stops(profile)["left"][-1, 5] > 0.0


def test_no_arm_stands_in_the_beam_to_the_other() -> None:
    """Seen from the side, one arm stands before the other."""
    profile = small_twin(15)
    assert profile.tracker.pose is not None
    pose = profile.tracker.pose.model_copy(update={"position": (0.0, 4.5, 0.6), "rpy": (0.0, 0.0, -math.pi / 2.0)})
    profile = profile.model_copy(update={"tracker": profile.tracker.model_copy(update={"pose": pose})})
    cell = cell_bodies(profile)
    at = {name: place(cell.arms[name], q) for name, q in plan_stops(profile).items()}
    for name, other in (("left", "right"), ("right", "left")):
        smr, bodies = at[name].smr[:, None], at[other]
        head = np.broadcast_to(np.array(pose.position), smr.shape)
        assert (segment_distances(head, smr, bodies.start, bodies.end) - bodies.radius).min() > 0.0


@pytest.mark.parametrize("seed", [7, 8])
def test_the_simulated_tracker_finds_every_smr_of_the_true_cell(plan: dict[str, np.ndarray], seed: int) -> None:
    profile = small_twin(plant={"seed": seed})
    bodies = cell_bodies(profile)
    fast = np.full(6, 2.0)
    with open_cell(profile) as cell:
        for k in range(30):
            for name, q in plan.items():
                cell.arms[name].start_move(q[k], fast, fast)
                cell.arms[name].wait_settled(60.0)
            for name, q in plan.items():
                expected = predicted_smr(bodies, name, q[k][None])[0]
                point = cell.tracker.measure(expected, 1.0)
                assert np.linalg.norm(point.p_M - expected) < 0.03, "and it is this arm's"


def test_the_seed_makes_the_plan(plan: dict[str, np.ndarray]) -> None:
    again = plan_stops(small_twin())
    other = plan_stops(small_twin().model_copy(update={"seed": 2}))
    for name, q in plan.items():
        np.testing.assert_array_equal(again[name], q)
        assert not np.any(np.all(other[name] == q, axis=1))


def behind_its_back(profile: Profile) -> Profile:
    tracker = profile.tracker.model_copy(update={"azimuth": (math.pi - 0.3, math.pi + 0.3)})
    return profile.model_copy(update={"tracker": tracker})


def arms_cannot_turn_round(profile: Profile) -> Profile:
    """The arms may move a little about a stop that looks at where the tracker was; it stands behind them now."""
    assert profile.tracker.pose is not None
    arms = {
        name: arm.model_copy(
            update={"limits": tuple((q - 0.2, q + 0.2) for q in plan_stops(profile)[name][0].tolist())}
        )
        for name, arm in profile.arms.items()
    }
    x, y, z = profile.tracker.pose.position
    pose = profile.tracker.pose.model_copy(update={"position": (-x, -y, z), "rpy": (0.0, 0.0, 0.0)})
    tracker = profile.tracker.model_copy(update={"pose": pose})
    return profile.model_copy(update={"tracker": tracker, "arms": arms})


def looking_into_the_wrist(profile: Profile) -> Profile:
    smr = profile.arms["left"].smr.model_copy(update={"normal": (0.0, 0.0, -1.0), "acceptance": 0.05})
    return with_arms(profile, smr=smr)


def floor_too_high(profile: Profile) -> Profile:
    return profile.model_copy(update={"plan": profile.plan.model_copy(update={"floor": 0.5})})


@pytest.mark.parametrize(
    ("spoilt", "cause"),
    [
        (behind_its_back, "tracker.azimuth \\(all of them\\)"),
        (arms_cannot_turn_round, "viewing direction .* \\(all of them\\): the SMR looks away from the tracker"),
        (looking_into_the_wrist, "viewing direction .* \\(all of them\\)"),
        (floor_too_high, "the floor .* \\(all of them\\): the nearest misses by [0-9]+ mm"),
    ],
)
def test_where_nothing_can_be_seen_planning_ends_in_words(
    spoilt: Any, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = spoilt(small_twin(3))
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_DRAWS", 20_000)
    with pytest.raises(InputError, match=f"arm left: none of 20000 random configurations .*{cause}"):
        plan_stops(profile)


@pytest.mark.slow
def test_an_unsafe_home_and_arms_too_close_are_told() -> None:
    profile = small_twin(3)
    home = profile.arms["right"].home
    assert home is not None
    down = (*home[:1], math.radians(40.0), *home[2:])
    arms = {**profile.arms, "right": profile.arms["right"].model_copy(update={"home": down})}
    with pytest.raises(InputError, match=r"stop 1 of 3 not found .* arm right: .* the floor"):
        plan_stops(profile.model_copy(update={"arms": arms}))
    with pytest.raises(InputError, match=r"stop 1 of 3 not found .* arms left and right: come within .* 1500 mm asked"):
        plan_stops(small_twin(3, plan={"clearance": 1.5, "floor": -3.0}))


def test_ranges_outside_the_limits_are_named() -> None:
    ranges = ((-1.0, 1.0), *[(-7.5, -7.0)] * 5)
    with pytest.raises(InputError, match=r"plan\.ranges: joint 2: no part of \[-7\.5, -7\] rad .* arm left"):
        plan_stops(small_twin(3, plan={"ranges": ranges}))


def test_a_plan_is_stored_reported_and_cancelled(tmp_path: Any) -> None:
    profile = small_twin(12, plan={"method": "random"})
    heard: list[Progress] = []
    with RunFile.create(tmp_path / "run", profile) as run:
        plans = plan_run(run, heard.append)
        for name, q in run.read_plan().items():
            np.testing.assert_array_equal(q, plans.q[name])
    assert [(event.done, event.total) for event in heard] == [(0, 12), (10, 12), (12, 12)]
    token = CancelToken()
    with pytest.raises(Cancelled):
        plan_stops(profile, lambda event: token.cancel(), token)
