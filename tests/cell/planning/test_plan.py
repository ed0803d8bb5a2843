"""Plans: every stop inside the limits, visible and safe; reproducible; one-sentence errors where none is possible."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import open_cell
from cellapp.cell.planning.plan import make_stops, plan_run, plan_stops
from cellapp.cell.planning.planned_stops import (
    PLANNED_STOPS_RESULT,
    STOP_CONDITIONS_RESULT,
    PlannedStops,
    read_planned_stops,
    straight_stops,
    write_planned_stops,
)
from cellapp.cell.planning.propose import append_proposed_stops
from cellapp.cell.planning.view import check_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import predicted_smr
from cellapp.commands.plan.run import freeze_stops, new_planned_run, replan
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, JobToken, Progress
from drivers.plant.clearance import segment_distances
from tests.approved import assert_refused
from tests.cell.planning.planned_cells import same_stops, some_stops
from tests.sure import sure
from tests.twin import altered, small_twin, with_arm, with_arms


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(small_twin())


def test_limits_and_ranges_of_the_cell_hold() -> None:
    limits = tuple((-2.5, -0.5) if joint == 1 else (-3.0, 3.0) for joint in range(6))
    ranges = tuple((-1.0, 4.0) if joint == 4 else (-6.0, 6.0) for joint in range(6))
    for q in plan_stops(with_arms(small_twin(8, plan={"ranges": ranges}), limits=limits)).values():
        assert np.all((q[:, 1] >= -2.5) & (q[:, 1] <= -0.5))
        assert np.all((q[:, 4] >= -1.0) & (q[:, 4] <= 3.0))


def test_no_arm_stands_in_the_beam_to_the_other() -> None:
    """Seen from the side, one arm stands before the other."""
    profile = small_twin(15)
    assert profile.tracker.pose is not None
    pose = profile.tracker.pose.model_copy(update={"position": (0.0, 4.5, 0.6), "rpy": (0.0, 0.0, -math.pi / 2.0)})
    profile = altered(profile, tracker={"pose": pose})
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


def arms_cannot_turn_round(profile: Profile) -> Profile:
    """The arms may move a little about a stop that looks at where the tracker was; it stands behind them now."""
    arms = {
        name: arm.model_copy(
            update={"limits": tuple((q - 0.2, q + 0.2) for q in plan_stops(profile)[name][0].tolist())}
        )
        for name, arm in profile.arms.items()
    }
    x, y, z = sure(profile.tracker.pose).position
    return altered(profile, tracker={"pose": {"position": (-x, -y, z), "rpy": (0.0, 0.0, 0.0)}}, arms=arms)


def looking_into_the_wrist(profile: Profile) -> Profile:
    return with_arms(profile, smr={"normal": (0.0, 0.0, -1.0), "acceptance": 0.05})


@pytest.mark.parametrize(
    ("spoilt", "cause"),
    [
        (
            lambda profile: altered(profile, tracker={"azimuth": (math.pi - 0.3, math.pi + 0.3)}),
            "tracker.azimuth \\(all of them\\)",
        ),
        (arms_cannot_turn_round, "viewing direction .* \\(all of them\\): the SMR looks away from the tracker"),
        (looking_into_the_wrist, "viewing direction .* \\(all of them\\)"),
        (
            lambda profile: altered(profile, plan={"floor": 0.5}),
            "the floor .* \\(all of them\\): the nearest misses by [0-9]+ mm",
        ),
    ],
)
def test_where_nothing_can_be_seen_planning_ends_in_words(
    spoilt: Any, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = spoilt(small_twin(3))
    monkeypatch.setattr("cellapp.cell.planning.candidates._MOST_SAMPLES", 20_000)
    with pytest.raises(InputError, match=f"arm left: none of 20000 random configurations .*{cause}"):
        plan_stops(profile)


def test_an_unsafe_home_and_arms_too_close_are_told() -> None:
    profile = small_twin(3)
    home = sure(profile.arms["right"].home)
    down = (*home[:1], math.radians(40.0), *home[2:])
    with pytest.raises(InputError, match=r"stop 1 of 3 not found .* arm right: .* the floor"):
        plan_stops(with_arm(profile, "right", home=down))
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
        plans = plan_run(run, JobToken(heard.append))
        for name, q in run.read_plan().items():
            np.testing.assert_array_equal(q, plans.q[name])
    assert [(event.done, event.total) for event in heard] == [(0, 12), (10, 12), (12, 12)]
    token = JobToken(lambda event: token.cancel())
    with pytest.raises(Cancelled):
        plan_stops(profile, token)


# -- Plans by the method of the profile: alone, around kept stops, for one arm, down to a single stop ------------------


def quick(stops: int, **plan: Any) -> Profile:
    """The twin with few candidates and one effect to design for."""
    return small_twin(stops, plan={"candidates": 120, "effects": ("backlash",), **plan})


def one_arm(profile: Profile) -> Profile:
    return altered(profile, arms={"left": profile.arms["left"]}, plant={"effects": {}})


def test_the_choice_of_stops_says_how_far_it_is_and_every_part_ends() -> None:
    events: list[Progress] = []
    make_stops(quick(30), JobToken(events.append))
    newest = {event.job: event for event in events}
    assert all(one.done == one.total for one in newest.values())
    assert len({event.done for event in events if event.job == "select"}) > 5


@pytest.mark.parametrize("method", ["random", "designed"])
def test_plans_are_safe_and_follow_what_is_kept(method: str) -> None:
    profile = quick(4, method=method, reserve=1)
    stops, design = make_stops(profile)
    assert (len(stops), design is None) == (5, method == "random")
    more, _ = make_stops(profile, kept=stops, add=1)
    same_stops(more.take(range(5)), stops)
    assert len(more) == 6
    assert more.block[5] > stops.block.max()
    assert not [one for one in check_stops(profile, more) if not one.is_avoided]
    with pytest.raises(InputError, match="nothing is left to design"):
        make_stops(profile, kept=stops)


@pytest.mark.parametrize("method", ["random", "designed"])
def test_one_arm_alone_and_a_single_stop_are_planned(method: str) -> None:
    for profile, arms in ((one_arm(quick(3, method=method)), 1), (quick(1, method=method), 2)):
        stops: PlannedStops = make_stops(profile)[0]
        assert (len(stops), len(stops.q)) == (profile.plan.stops, arms)
        assert not [one for one in check_stops(profile, stops) if not one.is_avoided]


# -- Frozen stops: which are listed, what a new design leaves, what is refused -----------------------------------------


def test_a_new_design_leaves_what_is_frozen(tmp_path: Path) -> None:
    with new_planned_run(small_twin(6, plan={"method": "random"}), tmp_path / "run") as run:
        before = read_planned_stops(run)
        assert freeze_stops(run, [1, 4]).notes == ("2 of 6 stops are frozen",)
        replan(run)
        after = read_planned_stops(run)
        assert np.array_equal(after.q["left"][after.frozen], before.q["left"][[1, 4]])
        with pytest.raises(InputError, match="there is no stop 7; there are 1 to 6"):
            freeze_stops(run, [6])
        freeze_stops(run, [])
        assert not read_planned_stops(run).frozen.any()


# -- A plan in the run file: all of it comes back, old runs read the same, damaged documents are named -----------------


def test_an_old_run_has_straight_ways_and_its_listed_stops_are_proposed(tmp_path: Path) -> None:
    q = some_stops(4).q
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        run.write_plan(q)
        same_stops(read_planned_stops(run), straight_stops(q))
        conditions = {"3": {"left": {"via": (q["left"][3] - 0.1).tolist(), "dwell_s": 2.0}}}
        run.write_document(STOP_CONDITIONS_RESULT, json.dumps(conditions))
        stops = read_planned_stops(run)
    assert stops.proposed.tolist() == [False, False, False, True]
    np.testing.assert_array_equal(stops.approach_starts(3)["left"], q["left"][3] - 0.1)
    assert set(stops.approach_starts(3)) == {"left"}
    assert stops.approach_starts(2) == {}
    assert stops.dwell_s["left"].tolist() == [0.0, 0.0, 0.0, 2.0]


def test_damaged_documents_are_named_as_approved(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_plan(some_stops(3).q)

        def refused(text: str) -> str:
            run.write_document(PLANNED_STOPS_RESULT, text)
            with pytest.raises(InputError) as caught:
                read_planned_stops(run)
            return re.sub(r": [A-Z].*?\)", ": ...)", str(caught.value))  # in words of the parser

        assert_refused(Path(__file__).parent / "approved" / "damaged-plans.txt", refused, tmp_path)


def test_a_plan_is_stored_with_all_documents_or_not_at_all(tmp_path: Path) -> None:
    stops = some_stops(4)
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        write_planned_stops(run, stops)
        run.write_plan(stops.q)
        before = run.read_document(PLANNED_STOPS_RESULT), run.read_document(STOP_CONDITIONS_RESULT)
        wrong = replace(stops, q={name: q[:2] for name, q in stops.q.items()} | {"left": stops.q["left"][:1]})
        with pytest.raises(ValueError, match="different numbers"):
            write_planned_stops(run, wrong)
        assert (run.read_document(PLANNED_STOPS_RESULT), run.read_document(STOP_CONDITIONS_RESULT)) == before


def test_proposed_stops_follow_designed_ones_and_replace_earlier_proposals(tmp_path: Path) -> None:
    designed, further = some_stops(4), some_stops(9)
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        write_planned_stops(run, designed)
        for count in (3, 2):
            proposed = straight_stops({name: q[4 : 4 + count] for name, q in further.q.items()})
            proposed.approach_from["left"][:] = proposed.q["left"] - 0.02
            proposed.proposed[:] = True
            assert append_proposed_stops(run, proposed) == 4
        stops = read_planned_stops(run)
    assert stops.proposed.tolist() == [False] * 4 + [True] * 2
    same_stops(stops.take(range(4)), designed)
    assert stops.block.tolist() == [0, 0, 1, 1, 2, 2]
    assert stops.legs[4:] == ((), ())
