"""Driving a check: which stops may be measured, how arms go there, when it ends, what is given up."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.check import DrivenCheck, check_candidates, drive_check
from cellapp.cell.driving.locate import LocatingStops
from cellapp.cell.driving.supervision import moving_cell
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import refuse_motion
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.check.locate import typed_pose
from cellapp.commands.check.view import location_sentences, location_tables
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.stages import CALIBRATION_FILE, read_stages
from cellapp.commands.station import excess_of_readings
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.monitoring.belief import SequentialState
from cellapp.estimation.monitoring.records import LocateResult
from cellapp.estimation.readings import Readings
from cellapp.ground.control import JobControl, Stopped
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.progress import Progress
from cellapp.ground.results import DISCOVER, LOCATE, VERIFY
from cellapp.interfaces.page.page import write_page
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel
from drivers.trackers.simulated import SimulatedTracker
from tests.sure import sure
from tests.twin import PROFILES, opening, plant_of, small_twin, with_arm
from tests.verbs import Opened, collect_stops, locate_run, opened_by, push_run, report_run


@dataclass
class Fed:
    """A test that remembers what it is fed, and is sure after so many stops."""

    sure_after: int = 100
    stops: list[Mapping[str, Readings]] = field(default_factory=list)

    def add(self, readings: Mapping[str, Readings]) -> SequentialState:
        self.stops.append(readings)
        count = len(self.stops)
        sure = count >= self.sure_after
        return SequentialState(
            stops=count, sure=sure, changed=False, valid=sure, log_evidence=0.0, log_valid=0.0, p_value=1.0
        )


class Task(NamedTuple):
    """What is checked: profile, model, stops, and what the readings scatter by beside the tracker."""

    profile: Profile
    model: CellModel
    stops: list[dict[str, Readings]]
    excess_m: Mapping[str, float]


@pytest.fixture(scope="module")
def task(finished_run: Path) -> Task:
    """Six stops of the finished run, 20 deg apart at least."""
    with RunFile.open(finished_run) as run:
        model = model_of(run, stage_in_force(run, read_stages(run)))
        candidates = check_candidates(run.profile, model, {name: run.readings(name) for name in run.profile.arms})
        stops = [{name: its.take([row]) for name, its in candidates.items()} for row in range(0, 60, 10)]
        return Task(run.profile, model, stops, excess_of_readings(RunState(run), model))


def driven(
    task: Task, test: Fed, open_with: Opened = open_cell, control: JobControl | None = None, **options: Any
) -> DrivenCheck:
    with opened_by(open_with), moving_cell(*task[:2], control or JobControl(), **options) as mover:
        return drive_check(mover, *task[1:3], test.add, task.excess_m)


@contextmanager
def refusing(profile: Profile, *, together: bool, alone: Sequence[str] = (), **_: Any) -> Iterator[Cell]:
    """A cell whose gate refuses that both arms leave home together, and some arms to leave it at all."""
    homes = home_positions(profile)

    def away(q: Mapping[str, Array]) -> set[str]:
        return {name for name in q if np.abs(q[name] - homes[name]).max() > 1e-3}

    with open_cell(profile) as cell:

        def gate(bodies: Any, start: Mapping[str, Array], end: Mapping[str, Array]) -> str:
            if (together and len(away(end)) > 1) or away(end) & set(alone):
                return "too near"
            return refuse_motion(bodies, start, end)

        yield replace(cell, gate=gate)


def test_it_ends_when_the_test_is_sure(task: Task) -> None:
    events: list[Progress] = []
    test = Fed(sure_after=3)
    found = driven(task, test, control=JobControl(events.append))
    assert (len(found.stops), len(test.stops), found.lost, found.notes) == (3, 3, [], [])
    assert [event.done for event in events if event.job == "check"] == [0, 0, 1, 2]
    assert repr(events[0].detail).startswith("Notice(text='takes at most about ")
    times = [stop.time_s for stop in found.stops]
    assert times == sorted(times)
    assert times[-1] < found.seconds


def test_where_the_gate_refuses_both_each_arm_goes_alone(task: Task) -> None:
    test = Fed(sure_after=4)
    found = driven(task, test, open_with=partial(refusing, together=True))
    assert [list(stop) for stop in test.stops] == [["left"], ["right"]] * 2
    assert [stop.number for stop in found.stops] == [0, 0, 1, 1]
    numbers = [next(iter(stop.values())).configuration[0] for stop in test.stops]
    assert numbers == [0, 1, 2, 3], "they did not stand there together"
    homes = home_positions(task.profile)
    np.testing.assert_allclose(np.array(found.stops[0].found["left"].other_q), [homes["right"]], atol=1e-6)


def test_an_arm_that_cannot_go_anywhere_is_noted(task: Task) -> None:
    test = Fed()
    found = driven(task, test, open_with=partial(refusing, together=True, alone=["left"]))
    assert [list(stop) for stop in test.stops] == [["right"]] * len(task.stops)
    assert found.notes[0].startswith("stop 1, arm left: refused to move: too near")
    with pytest.raises(HardwareError, match="no SMR could be measured at any stop"):
        driven(task, Fed(), open_with=partial(refusing, together=True, alone=["left", "right"]))


def test_a_lost_smr_is_given_up_after_some_stops_and_the_other_arm_goes_on(task: Task) -> None:
    opened: list[Cell] = []

    def cover(event: Progress) -> None:
        tracker = opened[0].tracker
        assert isinstance(tracker, SimulatedTracker)
        if event.done == 2:
            tracker.covered |= {"right"}

    test = Fed()
    found = driven(task, test, control=JobControl(cover), opened=opened.append)
    assert found.lost == ["right"]
    assert [list(stop) for stop in test.stops] == [["left", "right"]] * 2 + [["left"]] * 4
    assert sum("no SMR within" in note for note in found.notes) == 3
    # arms at home from then on
    assert found.stops[-1].found["left"].other_q == pytest.approx(home_positions(task.profile)["right"][None])


def test_readings_without_common_stops_are_paired(task: Task, finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        readings = {name: run.readings(name) for name in run.profile.arms}
    apart = {**readings, "right": replace(readings["right"], configuration=readings["right"].configuration + 1000)}
    found = check_candidates(task.profile, task.model, apart)
    assert 0 < len(found["left"]) == len(found["right"])
    again = check_candidates(task.profile, task.model, apart)
    np.testing.assert_array_equal(found["left"].q, again["left"].q)


def test_a_cell_without_a_free_stop_is_refused(task: Task, finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        readings = {name: run.readings(name) for name in run.profile.arms}
    lying = {name: replace(arm, q=np.zeros_like(arm.q)) for name, arm in readings.items()}
    with pytest.raises(InputError, match="nothing was moved"):
        check_candidates(task.profile, task.model, lying)


# -- Locating a tracker that was moved in the simulated cell: the calibration holds again, faults change nothing -------

TARGETS = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())
SOME = (*TARGETS[:6], *TARGETS[20:26])


def away(pose: Pose | None, by: tuple[float, float, float], rotation: tuple[float, float, float]) -> Pose:
    """A pose moved by ``by`` [m], and turned by ``rotation`` [rad] of roll, pitch and yaw."""
    x, y, z = (a + b for a, b in zip(sure(pose).position, by, strict=True))
    roll, pitch, yaw = (a + b for a, b in zip(sure(pose).rpy, rotation, strict=True))
    return Pose(position=(x, y, z), rpy=(roll, pitch, yaw))


@pytest.fixture
def run(finished_copy: Path) -> Iterator[RunFile]:
    with RunFile.open(finished_copy, write=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def moved_run(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RunFile, LocateResult]]:
    """A run whose tracker was moved by half a metre and ten degrees, and located with four points."""
    folder = tmp_path_factory.mktemp("moved") / "run"
    shutil.copytree(finished_run, folder)
    with RunFile.open(folder, write=True) as opened:
        truth = away(opened.profile.tracker.pose, (0.4, 0.3, 0.02), (0.01, -0.01, np.radians(10.0)))
        rough = away(truth, (0.03, -0.02, 0.02), (-0.01, 0.01, 0.012))
        yield opened, locate_run(opened, tracker_pose=rough, simulated_pose=truth)


def changed_plant(monkeypatch: pytest.MonkeyPatch, change: Callable[[Profile], Profile]) -> None:
    """Let ``locate`` open a cell that is not what its profile says."""

    @contextmanager
    def opened(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(change(profile), **options) as cell:
            yield cell

    monkeypatch.setattr("cellapp.cell.driving.supervision.open_cell", opened)


def swap_splits(run: RunFile) -> None:
    """Let one reading of each arm validate that identified, and the other way round."""
    for name in run.profile.arms:
        words = list(run.readings(name).split or ())
        one, other = words.index("identify"), words.index("validate")
        words[one], words[other] = "validate", "identify"
        run.assign_splits(name, words)


def test_four_points_find_the_station_within_its_stated_uncertainty(moved_run: tuple[RunFile, LocateResult]) -> None:
    run, found = moved_run
    assert (found.verdict, found.moved, found.complaints()) == ("located", True, [])
    assert found.by_arm == {"left": 2, "right": 2}
    assert found.shift_mm == pytest.approx(500.4, abs=0.1)
    truth = sure(found.simulated_pose)
    np.testing.assert_allclose(found.tracker_pose.position, truth.position, atol=0.3e-3)
    assert found.points[0].found_off_mm > 10.0
    assert found.points[-1].found_off_mm < 1.0
    assert found.degrees_of_freedom == 6
    assert 0.0 < found.uncertainty_mm < 0.02
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    np.testing.assert_allclose(sure(model.T_M_M0), found.T_new_old)
    table, *_ = location_tables(found)
    assert len(table.rows) == 4
    assert location_sentences(found)[0].startswith("the tracker was moved 500.")


def test_targets_are_met_from_the_new_station_as_before(moved_run: tuple[RunFile, LocateResult]) -> None:
    run, _ = moved_run
    after = push_run(run, SOME, verify=True)
    for name in ("left", "right"):
        assert after.arms[name].compensated_mm.mean < 45e-3, "the tracker scatters by some 25 um"
        assert after.arms[name].nominal_mm.mean > 1.0
    stages = read_stages(run)
    assert stages.stale_model() == ""
    assert stages.in_force == stages.current[LOCATE]
    basis = sure(stages.current[VERIFY].basis)
    assert list(basis.stages) == [LOCATE]
    assert run_overview(RunState(run)).next_verb == "report"
    assert "Station of the tracker" in Path(report_run(run, write_page).page).read_text("utf-8")


def test_without_locating_nothing_is_found_from_there(run: RunFile) -> None:
    """What the verb is for: the old model points a moved tracker past the SMRs."""
    far = away(run.profile.tracker.pose, (0.4, 0.3, 0.0), (0.0, 0.0, 0.2))
    with pytest.raises(HardwareError, match="--tracker-pose"):
        locate_run(run, simulated_pose=far)
    assert LOCATE not in read_stages(run).current


def test_readings_of_two_stations_are_not_mixed(moved_run: tuple[RunFile, LocateResult]) -> None:
    run, _ = moved_run
    with pytest.raises(InputError, match="two stations do not calibrate together"):
        collect_stops(run, resume=True)


def test_a_moved_base_is_no_motion_of_the_tracker_and_its_model_not_used(
    run: RunFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = run.profile.arms["left"].base
    changed_plant(
        monkeypatch, lambda profile: with_arm(profile, "left", base=away(base, (0.003, 0.0, 0.0), (0.0, 0.0, 0.0)))
    )
    found = locate_run(run)
    assert found.verdict == "not explained"
    (complaint,) = found.complaints()
    assert "'cellapp check DIR' names what" in complaint
    stages = read_stages(run)
    assert stages.in_force == stages.current[DISCOVER]
    assert "no motion of the tracker explains the points" in stages.stale_model()
    with pytest.raises(InputError, match=r"cellapp check \S+ --tracker-moved"):
        push_run(run, SOME, verify=True)
    assert read_results(run).locate == found


def test_one_arm_only_locates_the_tracker_for_itself(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """The right SMR is covered: all points come from the left arm."""
    monkeypatch.setattr(LocatingStops, "best", _only("left", LocatingStops.best), raising=True)
    kicked = away(run.profile.tracker.pose, (0.03, 0.0, 0.0), (0.0, 0.0, 0.01))
    found = locate_run(run, simulated_pose=kicked)
    assert (found.verdict, found.by_arm) == ("located", {"left": 4})
    assert any(note.startswith("arm right: no further joint positions") for note in found.notes)


def _only(wanted: str, best: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, name, T: best(self, name, T) if name == wanted else None


def test_a_fault_leaves_the_model_as_it_was(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Cell] = []

    monkeypatch.setattr("cellapp.cell.driving.supervision.open_cell", opening(opened.append))
    before = (run.folder / CALIBRATION_FILE).read_bytes(), read_stages(run).current

    def protective_stop(event: Progress) -> None:
        if event.job == "locate" and event.done == 1:
            opened[-1].arms["left"].protective_stop()  # type: ignore[attr-defined]

    def lost(event: Progress) -> None:
        tracker = opened[-1].tracker
        assert isinstance(tracker, SimulatedTracker)
        if event.done == 2:
            tracker.cut_link()

    def covered(event: Progress) -> None:
        tracker = opened[-1].tracker
        assert isinstance(tracker, SimulatedTracker)
        if event.done == 2:
            tracker.covered |= {"left", "right"}

    for fault, says in ((protective_stop, "protective stop"), (lost, "link"), (covered, "were not found")):
        with pytest.raises(HardwareError, match=says):
            locate_run(run, control=JobControl(fault))
        assert not any(plant_of(opened[-1]).moving(name) for name in ("left", "right"))
        assert ((run.folder / CALIBRATION_FILE).read_bytes(), read_stages(run).current) == before
    control = JobControl(lambda event: control.stop() if event.done == 1 else None)
    with pytest.raises(Stopped):
        locate_run(run, control=control)
    assert read_stages(run).current == before[1]


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,4,5,nan", "1;2;3;4;5;6", "a,b,c,d,e,f"])
def test_a_pose_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"--tracker-pose: expected x,y,z,roll,pitch,yaw in m and deg"):
        typed_pose(text, "--tracker-pose")


def test_what_cannot_be_done_is_refused_before_anything_moves(run: RunFile) -> None:
    with pytest.raises(InputError, match="--stops: expected at least 4, got 2"):
        locate_run(run, 2)
    assert typed_pose("3.8,0,0.6,0,0,180", "").rpy[2] == pytest.approx(np.pi)
