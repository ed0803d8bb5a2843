"""A plan in the run file: all of it comes back, old runs read the same, damaged documents are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.planning.planned_stops import (
    PLANNED_STOPS_RESULT,
    STOP_CONDITIONS_RESULT,
    PlannedStops,
    StopConditions,
    joined,
    last_motions,
    proposed_stops,
    read_plan_design,
    read_planned_stops,
    read_stop_conditions,
    routes,
    stop_conditions_json,
    straight_stops,
    write_planned_stops,
)
from cellapp.cell.planning.proposal.propose import ProposedStop, append_proposed_stops
from cellapp.cell.run import Outcome, RunFile
from cellapp.ground.errors import InputError
from tests.cell.planning.hand_made import same_stops, some_stops
from tests.twin import small_twin


def test_a_plan_comes_back_bit_for_bit(tmp_path: Path) -> None:
    stops = some_stops(7)
    with RunFile.create(tmp_path / "run", small_twin(7)) as run:
        write_planned_stops(run, stops, proposed={5})
        back = read_planned_stops(run)
        assert proposed_stops(read_stop_conditions(run)) == {5}
        assert read_plan_design(run) is None
    same_stops(back, stops)


def test_an_old_run_has_straight_ways_and_its_listed_stops_are_proposed(tmp_path: Path) -> None:
    q = some_stops(4).q
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        run.write_plan(q)
        same_stops(read_planned_stops(run), straight_stops(q))
        conditions = {3: {"left": StopConditions(q["left"][3] - 0.1, 2.0)}}
        run.write_result(STOP_CONDITIONS_RESULT, stop_conditions_json(conditions))
        stops = read_planned_stops(run)
        assert proposed_stops(read_stop_conditions(run)) == {3}
    np.testing.assert_array_equal(stops.approach_starts(3)["left"], q["left"][3] - 0.1)
    assert set(stops.approach_starts(3)) == {"left"}
    assert stops.approach_starts(2) == {}
    assert stops.dwell_s["left"].tolist() == [0.0, 0.0, 0.0, 2.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[]", "damaged"),
        ("{", "damaged"),
        ('{"block": [0, 0, 0, 0]}', "more stops than the 3"),
        ('{"block": [0], "frozen": [3]}', "more stops than the 3"),
        ('{"block": [0], "repeat_of": {"1": -1}}', "more stops than the 3"),
        ('{"block": [0], "legs": {"1": [{"left": [0, 1]}]}}', "6 finite joint positions"),
        ('{"block": [0], "legs": {"1": [{"left": [0, 1, 2, 3, 4, NaN]}]}}', "damaged"),
        ('{"block": [0], "legs": {"1": [{"middle": [0, 1]}]}}', "'middle'"),
        ('{"block": [0], "colour": 1}', "colour"),
    ],
)
def test_a_damaged_document_is_named(tmp_path: Path, text: str, says: str) -> None:
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_plan(some_stops(3).q)
        run.write_result(PLANNED_STOPS_RESULT, text)
        with pytest.raises(InputError, match=f"'{PLANNED_STOPS_RESULT}'.*{says}|{says}"):
            read_planned_stops(run)


def test_a_plan_is_stored_with_all_documents_or_not_at_all(tmp_path: Path) -> None:
    stops = some_stops(4)
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        write_planned_stops(run, stops)
        run.write_plan(stops.q)
        before = run.read_result(PLANNED_STOPS_RESULT), run.read_result(STOP_CONDITIONS_RESULT)
        wrong = replace(stops, q={name: q[:2] for name, q in stops.q.items()} | {"left": stops.q["left"][:1]})
        with pytest.raises(ValueError, match="different numbers"):
            write_planned_stops(run, wrong)
        assert (run.read_result(PLANNED_STOPS_RESULT), run.read_result(STOP_CONDITIONS_RESULT)) == before


def test_outcomes_of_stops_that_are_replaced_are_forgotten(tmp_path: Path) -> None:
    stops = some_stops(4)
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        write_planned_stops(run, stops)
        for stop in (1, 2):
            run.add_stop(stop, {}, [Outcome(stop, "left", "left out", "a column")])
        stops.q["left"][2] += 0.01
        write_planned_stops(run, stops)
        assert [one.stop for one in run.outcomes()] == [1]


def test_proposed_stops_follow_designed_ones_and_replace_earlier_proposals(tmp_path: Path) -> None:
    designed, further = some_stops(4), some_stops(9)
    with RunFile.create(tmp_path / "run", small_twin(4)) as run:
        write_planned_stops(run, designed)
        for count in (3, 2):
            proposed = [
                ProposedStop(further.targets(k), {"left": StopConditions(further.q["left"][k] - 0.02, 1.0)})
                for k in range(4, 4 + count)
            ]
            assert append_proposed_stops(run, proposed) == 4
        stops = read_planned_stops(run)
        assert proposed_stops(read_stop_conditions(run)) == {4, 5}
    same_stops(stops.take(range(4)), designed)
    assert stops.block.tolist() == [0, 0, 1, 1, 2, 2]
    assert stops.legs[4:] == ((), ())


def test_taking_and_joining_keep_what_still_holds() -> None:
    stops = some_stops(6)
    same_stops(joined(stops.take(range(3)), stops.take(range(3, 6))).take(range(3)), stops.take(range(3)))
    same_stops(joined(stops.take([]), stops), stops)
    chosen = stops.take([0, 2, 3])
    assert chosen.legs == (stops.legs[0], (), stops.legs[3]), "legs that begin elsewhere are dropped"
    assert stops.repeat_of.tolist() == [-1, -1, -1, 0, -1, -1]
    assert chosen.repeat_of.tolist() == [-1, -1, 0]
    assert stops.take([3]).repeat_of.tolist() == [-1]


def test_every_route_ends_with_the_planned_last_motion() -> None:
    stops: PlannedStops = some_stops(6)
    for stop in range(6):
        for as_planned in (True, False):
            for route in routes(stops, stop, as_planned=as_planned):
                reached: dict[str, np.ndarray] = {}
                for motion in route:
                    before, reached = reached, {**reached, **motion}
                for name, q in stops.targets(stop).items():
                    np.testing.assert_array_equal(reached[name], q)
                    if name in stops.approach_starts(stop):
                        np.testing.assert_array_equal(before[name], stops.approach_starts(stop)[name])


def test_last_motions_are_planned_or_straight_from_the_stop_before() -> None:
    stops = some_stops(5)
    homes = {name: np.full(6, 0.5) for name in stops.q}
    motions = last_motions(stops, homes)
    np.testing.assert_array_equal(motions["right"], stops.q["right"] - stops.approach_from["right"])
    np.testing.assert_array_equal(motions["left"][0], stops.q["left"][0] - 0.5)
    np.testing.assert_array_equal(motions["left"][3], stops.q["left"][3] - stops.q["left"][2])
