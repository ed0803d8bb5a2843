"""Plans are made from files, extended and planned again; what is measured never changes, nothing half is written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.requests import taking_requests
from cellapp.cell.planning.planned_stops import (
    PlannedStops,
    joined,
    read_planned_stops,
    straight_stops,
    write_planned_stops,
)
from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.measured_again import reference_drifts
from cellapp.commands.plan.run import (
    check_plan_file,
    export_plan,
    extend_plan,
    plan_around_file,
    plan_from_file,
    planned_stops,
    replan,
)
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.estimation.readings import Readings
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Collection, Reference
from cellapp.ground.progress import Cancelled
from drivers.arms.simulated import SimulatedArm
from tests.cell.planning.planned_cells import drivable_stops, same_stops, some_stops
from tests.twin import small_twin

STOPS = 6
INTO_THE_FLOOR = np.array([0.0, 0.6, 0.0, -1.5, 0.0, 0.0])


def quickly_planned(stops: int = 30, *, plan: dict[str, Any] | None = None) -> Profile:
    """The small twin with stops that are soon designed: for one effect only."""
    return small_twin(stops, plan={"effects": ("backlash",), **(plan or {})})


@pytest.fixture(scope="module")
def plan() -> PlannedStops:
    """Six stops that the gate and the tracker accept, each approached by a small step; the second one is frozen."""
    stops = drivable_stops(STOPS, np.full(6, 0.02))
    stops.frozen[1] = True
    return replace(stops, block=np.array([0, 0, 0, 1, 1, 1], dtype=np.intp))


@pytest.fixture
def run(plan: PlannedStops, tmp_path: Path) -> Iterator[RunFile]:
    with RunFile.create(tmp_path / "run", quickly_planned(STOPS), lambda run: write_planned_stops(run, plan)) as made:
        yield made


@pytest.fixture
def file(run: RunFile, tmp_path: Path) -> Path:
    """The plan of the run as a file."""
    export_plan(run, tmp_path / "plan.csv")
    return tmp_path / "plan.csv"


def bent(file: Path, plan: PlannedStops, stop: int = 3) -> Path:
    """The file with the left arm in the floor at a stop."""
    text = file.read_text("utf-8")
    q, floor = (",".join(map(repr, one.tolist())) for one in (plan.q["left"][stop], INTO_THE_FLOOR))
    assert f"left,stop,{q}" in text
    file.write_text(text.replace(f"left,stop,{q}", f"left,stop,{floor}"), "utf-8")
    return file


# -- files ------------------------------------------------------------------------------------------------------------


def test_a_run_from_a_file_has_the_plan_as_it_is_written(file: Path, plan: PlannedStops, tmp_path: Path) -> None:
    check = check_plan_file(quickly_planned(STOPS), file)
    assert (check.is_safe, check.stops, check.file) == (True, STOPS, str(file))
    result = plan_from_file(quickly_planned(STOPS), file, tmp_path / "other")
    assert (result.stops, result.notes) == ({"left": STOPS, "right": STOPS}, ())
    with RunFile.open(tmp_path / "other") as other:
        same_stops(read_planned_stops(other), plan)
        export_plan(other, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == file.read_bytes()


def test_offences_are_named_by_line_and_configuration_and_nothing_is_written(
    file: Path, plan: PlannedStops, tmp_path: Path
) -> None:
    bent(file, plan)
    check = check_plan_file(quickly_planned(STOPS), file)
    assert not check.is_safe
    assert {one.configuration for one in check.refused if not one.is_avoided} >= {3}
    line = next(number for number, text in enumerate(file.read_text().splitlines(), start=1) if text.startswith("3,"))
    assert {one.line for one in check.refused if one.configuration == 3} == {line}
    for make in (plan_from_file, plan_around_file):
        with pytest.raises(
            CheckFailed, match=f"nothing was written\n.*plan.csv:{line}: configuration 3: arm left: collides"
        ):
            make(quickly_planned(STOPS + 2), file, tmp_path / "other")
        assert not (tmp_path / "other").exists()


def test_a_file_without_a_stop_of_an_arm_makes_no_run(file: Path, tmp_path: Path) -> None:
    lines = file.read_text("utf-8").splitlines()
    file.write_text("\n".join(line for line in lines if not line.startswith("2,right,stop")), "utf-8")
    for make in (plan_from_file, plan_around_file):
        with pytest.raises(InputError, match="configuration 2 has no row 'stop' of arm right"):
            make(quickly_planned(STOPS), file, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_stops_of_a_file_are_frozen_and_the_rest_is_planned(file: Path, plan: PlannedStops, tmp_path: Path) -> None:
    result = plan_around_file(quickly_planned(STOPS + 3, plan={"reserve": 1}), file, tmp_path / "other")
    assert (result.stops["right"], result.reserves) == (STOPS + 3, 1)
    with RunFile.open(tmp_path / "other") as other:
        stops = read_planned_stops(other)
    assert stops.frozen.tolist() == [True] * STOPS + [False] * 4
    same_stops(stops.take(range(STOPS)), replace(plan, frozen=np.ones(STOPS, dtype=np.bool_)))
    with pytest.raises(InputError, match=r"6 stops are kept, and plan\.stops and plan\.reserve ask for 6"):
        plan_around_file(quickly_planned(STOPS), file, tmp_path / "full")


def test_a_run_without_a_plan_cannot_be_exported_extended_or_planned_again(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "imported", quickly_planned()) as run:
        for act in (lambda: export_plan(run, tmp_path / "plan.csv"), lambda: extend_plan(run, 3), lambda: replan(run)):
            with pytest.raises(InputError, match="the run has no plan"):
                act()
        assert planned_stops(run).stops == ()
    assert not (tmp_path / "plan.csv").exists()


# -- runs -------------------------------------------------------------------------------------------------------------


def test_a_run_is_extended_and_collected_on(run: RunFile, plan: PlannedStops) -> None:
    collect_run(run)
    assert run_overview(RunState(run)).next_verb == "calibrate"
    assert extend_plan(run, 3).stops == {"left": STOPS + 3, "right": STOPS + 3}
    extend_plan(run, 2)
    assert run_overview(RunState(run)).next_step.endswith("--resume")
    stops = read_planned_stops(run)
    same_stops(stops.take(range(STOPS)), plan)
    assert stops.block[STOPS:].tolist() == [2, 2, 2, 3, 3]
    assert len(np.unique(stops.q["left"], axis=0)) == STOPS + 5
    collect_run(run, resume=True)
    assert run.stops_done() == set(range(STOPS + 5))
    assert sum(event.text.startswith("plan changed:") for event in run.events()) == 2


def test_what_could_not_be_reached_is_replaced_and_what_is_measured_stays(run: RunFile, plan: PlannedStops) -> None:
    bad = plan.take(range(STOPS))
    bad.q["left"][2] = INTO_THE_FLOOR
    write_planned_stops(run, bad)
    assert collect_run(run).missing
    assert run.stops_done() == {0, 1, 3, 4, 5}
    result = replan(run)
    assert "replaced were stops that could not be reached or measured: 3" in result.notes[0]
    assert run.outcomes() == []
    stops = read_planned_stops(run)
    kept = [0, 1, 3, 4, 5]
    for name, q in stops.q.items():
        np.testing.assert_array_equal(q[kept], plan.q[name][kept])
        np.testing.assert_array_equal(stops.approach_from[name][kept], plan.approach_from[name][kept])
    assert stops.frozen.tolist() == plan.frozen.tolist()
    assert not collect_run(run, resume=True).missing
    assert run.stops_done() == set(range(STOPS))
    with pytest.raises(InputError, match="nothing is left to design"):
        replan(run)


def test_the_reference_stop_stays_where_it_is(
    run: RunFile, plan: PlannedStops, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(self: SimulatedArm, q: np.ndarray) -> np.ndarray:
        return np.array([any(np.allclose(row, plan.q["left"][stop]) for stop in (0, 3)) for row in q])

    monkeypatch.setattr(SimulatedArm, "refused_by_controller", refused)
    run.profile = run.profile.model_copy(update={"collection": Collection(reference=Reference(every=3))})
    collect_run(run)
    assert run.stops_done() == {1, 2, 4, 5}
    replan(run)
    stops = read_planned_stops(run)
    assert len(stops) == STOPS + 1, "the first one keeps its place and is replaced at the end"
    for name, q in stops.q.items():
        np.testing.assert_array_equal(q[[0, 1, 2, 4, 5]], plan.q[name][[0, 1, 2, 4, 5]])
        assert not np.array_equal(q[3], plan.q[name][3])
    collect_run(run, resume=True)
    assert run.stops_done() == {1, 2, 3, 4, 5, 6}
    assert max(one.drift_mm for one in reference_drifts(run)) < 0.1


def test_a_running_job_keeps_its_plan_and_a_cancelled_change_writes_nothing(run: RunFile, plan: PlannedStops) -> None:
    with taking_requests(run.folder, JobControl()):
        for change in (lambda: extend_plan(run, 2), lambda: replan(run)):
            with pytest.raises(InputError, match="another job runs here"):
                change()
    control = JobControl()
    control.cancel()
    with pytest.raises(Cancelled):
        extend_plan(run, 2, control=control)
    same_stops(read_planned_stops(run), plan)
    assert not any("plan changed" in event.text for event in run.events())


@pytest.mark.parametrize(("proposed", "says"), [(set(), ""), ({5}, "too few stops can be reached")])
def test_a_design_of_fewer_stops_than_asked_leaves_the_last_rows_out(
    run: RunFile, plan: PlannedStops, proposed: set[int], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fewer(profile: Profile, *more: object, kept: PlannedStops, add: int) -> tuple[PlannedStops, None]:
        return joined(kept, straight_stops({name: q[: add - 1] + 0.01 for name, q in plan.q.items()})), None

    monkeypatch.setattr("cellapp.commands.plan.run.make_stops", fewer)
    plan = replace(plan, proposed=np.isin(np.arange(len(plan)), list(proposed)))
    write_planned_stops(run, plan)
    if says:
        with pytest.raises(InputError, match=says):
            replan(run)
        same_stops(read_planned_stops(run), plan)
        return
    assert replan(run).stops["left"] == STOPS - 1
    assert "3 stops were added after stop 5" in extend_plan(run, 4).notes[0]


ROWS = st.sets(st.integers(0, 8), max_size=6)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(measured=ROWS, failed=ROWS, frozen=ROWS, proposed=st.integers(0, 3), reserve=st.integers(0, 2))
def test_a_new_design_changes_what_it_may_and_nothing_else(
    measured: set[int], failed: set[int], frozen: set[int], proposed: int, reserve: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nine stops, the last of them proposed; planning itself is replaced by numbers that tell where they come from."""

    def made(*more: object, kept: PlannedStops, add: int) -> tuple[PlannedStops, None]:
        further = np.full((add, 6), 0.5) + np.arange(add)[:, None] * 1e-3
        return joined(kept, straight_stops({"left": further, "right": -further})), None

    monkeypatch.setattr("cellapp.commands.plan.run.make_stops", made)
    failed -= measured
    asked = set(range(9 - proposed, 9))
    fixed, wanted = (np.isin(np.arange(9), list(its)) for its in (frozen, asked))
    stops = replace(some_stops(9), frozen=fixed, proposed=wanted)
    profile = quickly_planned(9 - proposed - reserve, plan={"reserve": reserve})
    with TemporaryDirectory() as folder, RunFile.create(Path(folder) / "run", profile) as run:
        write_planned_stops(run, stops)
        for stop in sorted(measured | failed):
            rows = {name: Readings.one(q=q[stop], p_M=np.zeros(3)) for name, q in stops.q.items()}
            outcomes = [Outcome(stop, name, "left out", "a column") for name in rows]
            run.add_stop(stop, rows if stop in measured else {}, [] if stop in measured else outcomes)
        stay = measured | (asked - failed)
        replaced = set(range(9)) - stay - (frozen - failed)
        if not replaced:
            with pytest.raises(InputError, match="nothing is left to design"):
                replan(run)
            return
        replan(run)
        after = read_planned_stops(run)
        assert (len(after), run.outcomes(), {*np.flatnonzero(after.proposed)}) == (9, [], asked & stay)
    for name, q in after.q.items():
        for stop in stay:
            np.testing.assert_array_equal(q[stop], stops.q[name][stop])
            np.testing.assert_array_equal(after.approach_from[name][stop], stops.approach_from[name][stop])
        left = {tuple(row) for row in q.tolist()}
        assert {tuple(stops.q[name][stop].tolist()) for stop in frozen - failed} <= left
        assert not {tuple(stops.q[name][stop].tolist()) for stop in replaced} & left
        assert len(left) == 9
