"""Tests of ISO 9283 driven in simulated cells: what is measured is the truth of the cell, and faults stop all arms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.iso9283 import programme, tests
from cellapp.cell.driving.iso9283 import tests as driving
from cellapp.cell.driving.iso9283.programme import ChosenCube, CubeSearch, choose_cube, published_cell
from cellapp.cell.driving.iso9283.tests import (
    IsoFindings,
    IsoTask,
    arm_results,
    drive_tests,
    lost_beam_words,
    missing_words,
    pair_results,
    path_specs,
)
from cellapp.cell.targets.path import PathSpec
from cellapp.estimation.iso9283.norm import IsoTest
from cellapp.estimation.iso9283.records import ArmIso9283
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Progress
from cellapp.robot.kinematics.chain import JointAngles, joint_jacobian
from drivers.arms.simulated import SimulatedArm
from drivers.plant import Plant
from drivers.trackers.simulated import SimulatedTracker
from tests.cell.planning.planned_cells import one_arm, seven_joints, three_arms
from tests.crossed_beam import crossed_beam
from tests.sure import sure
from tests.twin import altered, opening, plant_of, small_twin

REPEATABILITY_RAD = 5e-5


def cell_of(profile: Profile, **plant: Any) -> Profile:
    """The cell without hidden effects, and with other keys of its plant."""
    return altered(profile, plant={"effects": {}, **plant})


def task_of(profile: Profile, *tests: IsoTest, cycles: int = 2, aligned: bool = False, **changes: Any) -> IsoTask:
    """Nominal commands; with ``aligned`` bases are found first, else they are taken from the profile."""
    task = IsoTask(
        profile=profile,
        model=None if aligned else published_cell(profile, {}),
        commands=("nominal",),
        tests=tests,
        arms=tuple(profile.arms),
        cycles=cycles,
        speed=1.0,
        drift_s=60.0,
    )
    return replace(task, **changes)


@pytest.fixture(autouse=True)
def _cubes_are_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cubes of the same cell are the same in every test; a few orientations are enough here."""
    monkeypatch.setattr(programme, "_SEEDS", 4)

    def chosen(search: CubeSearch) -> ChosenCube | str:
        key = (*(arm.geometry.vector().tobytes() for arm in search.cell.arms.values()), search.name.encode())
        if key not in _known():
            _known()[key] = choose_cube(search)
        return _known()[key]

    monkeypatch.setattr(driving, "choose_cube", chosen)


@cache
def _known() -> dict[tuple[bytes, ...], ChosenCube | str]:
    return {}


def only_paths(monkeypatch: pytest.MonkeyPatch, word: str) -> None:
    """Let tests of paths drive those alone that are called by ``word``."""

    def chosen(name: str, cube: ChosenCube, share: float) -> list[PathSpec]:
        specs = path_specs(name, cube, share)
        assert not isinstance(specs, str)
        return [one for one in specs if word in one.name]

    monkeypatch.setattr(tests, "path_specs", chosen)


def driven(task: IsoTask, **more: Any) -> tuple[IsoFindings, Plant]:
    """Drive the tests; also the plant as it is afterwards."""
    findings = IsoFindings()
    cells: list[Cell] = []
    drive_tests(task, findings, opened=cells.append, **more)
    return findings, plant_of(cells[0])


def results(task: IsoTask, findings: IsoFindings) -> dict[str, ArmIso9283]:
    return arm_results(task, findings, np.random.default_rng(1))


@pytest.mark.parametrize("aligned", [False, True], ids=["base given", "base found"])
def test_without_noise_accuracy_is_the_true_error_of_the_cell(*, aligned: bool) -> None:
    task = task_of(cell_of(one_arm(), noise=False), "pose", "multidirectional", "distance", aligned=aligned)
    findings, plant = driven(task)
    programme = findings.programmes["left", "nominal"]
    tests = results(task, findings)["left"].tests["nominal"]
    base = sure(findings.model).arms["left"].nominal.T_M_B()[:3, :3]
    assert [one.pose for one in tests.pose] == ["P1", "P2", "P3", "P4", "P5"]
    for one in tests.pose:
        q = findings.cubes["left"].q[one.pose]
        error_M = plant.smr_positions("left", q[None])[0] - programme.position_M[one.pose]
        assert one.accuracy.value_mm == pytest.approx(1e3 * np.linalg.norm(error_M), abs=1e-6)
        assert one.repeatability.value_mm == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(np.linalg.norm(one.error_mm), one.accuracy.value_mm)
        np.testing.assert_allclose(one.error_mm, 1e3 * error_M @ base, atol=1e-6)
    assert max(one.variation.value_mm for one in tests.multidirectional) == pytest.approx(0.0, abs=1e-6)
    (distance,) = tests.distance
    ends = [plant.smr_positions("left", findings.cubes["left"].q[pose][None])[0] for pose in ("P2", "P4")]
    wanted = distance.commanded_mm
    assert distance.accuracy.value_mm == pytest.approx(1e3 * np.linalg.norm(ends[1] - ends[0]) - wanted, abs=1e-6)
    assert distance.repeatability.value_mm == pytest.approx(0.0, abs=1e-6)
    assert missing_words(findings, task.tests) == ()
    for name, home in ((name, np.array(arm.home)) for name, arm in task.profile.arms.items()):
        np.testing.assert_array_equal(plant.q(name), home)


def test_repeatability_is_that_of_the_joints() -> None:
    """The plant's joints stop with normal errors of a known size: RP is that of the positions which they give."""
    task = task_of(cell_of(one_arm(), noise=False, repeatability=REPEATABILITY_RAD), "pose", cycles=30)
    findings, _ = driven(task)
    geometry = published_cell(task.profile, {}).arms["left"].geometry
    rng = np.random.default_rng(3)
    for one in results(task, findings)["left"].tests["nominal"].pose:
        _, J = joint_jacobian(geometry, JointAngles.of(findings.cubes["left"].q[one.pose][None]))
        scatter = REPEATABILITY_RAD * rng.standard_normal((200_000, 6)) @ J[:, :, 0].T
        lengths = np.linalg.norm(scatter - scatter.mean(axis=0), axis=1)
        expected_mm = 1e3 * (lengths.mean() + 3.0 * lengths.std())
        assert one.repeatability.n == 30
        assert abs(one.repeatability.value_mm - expected_mm) < 2.0 * sure(one.repeatability.expanded_mm)
        assert one.repeatability.value_mm == pytest.approx(expected_mm, rel=0.45)


def test_two_arms_are_measured_together() -> None:
    task = task_of(cell_of(small_twin(), noise=False), "cooperative")
    findings, plant = driven(task)
    (pair,) = pair_results(findings, np.random.default_rng(1))
    assert pair.arms == ("left", "right")
    assert pair.refused == ""
    vectors, lengths = pair.vector["nominal"], pair.distance["nominal"]
    assert len(vectors) == len(lengths) == len(findings.pairs["left", "right"]) == 5
    for vector, length, poses in zip(vectors, lengths, findings.pairs["left", "right"], strict=True):
        true, wanted = [], []
        for name, pose in zip(pair.arms, poses, strict=True):
            true.append(plant.smr_positions(name, findings.cubes[name].q[pose][None])[0])
            wanted.append(findings.programmes[name, "nominal"].position_M[pose])
        error = (true[1] - true[0]) - (wanted[1] - wanted[0])
        assert vector.accuracy.value_mm == pytest.approx(1e3 * np.linalg.norm(error), abs=1e-6)
        off = np.linalg.norm(true[1] - true[0]) - np.linalg.norm(wanted[1] - wanted[0])
        assert length.accuracy.value_mm == pytest.approx(1e3 * off, abs=1e-6)


def test_drift_and_paths_of_an_arm_that_does_not_drift() -> None:
    task = task_of(cell_of(one_arm()), "drift", "path")
    findings, _ = driven(task)
    tests = results(task, findings)["left"].tests["nominal"]
    assert tests.drift is not None
    assert len(tests.drift.groups) == 2
    assert tests.drift.minutes >= 0.5
    assert tests.drift.accuracy.value_mm <= 2.0 * sure(tests.drift.accuracy.expanded_mm)
    assert [path.path for path in tests.path] == ["line P2 to P4", "large circle", "small circle"]
    by_name = {path.path: path for path in tests.path}
    for path in tests.path:
        assert (path.accuracy.n, path.speed_mm_s) == (2, 250.0)
        assert path.points == 50
    for name in ("line P2 to P4", "large circle"):
        velocity = sure(by_name[name].velocity)
        if by_name[name].slowed:
            assert velocity.accuracy_percent < 0.1
            assert "allows" in by_name[name].slowed
        else:
            assert abs(velocity.accuracy_percent) < 0.5
            assert velocity.fluctuation_mm_s < 5.0 * velocity.tracker_fluctuation_mm_s
    edge = findings.cubes["left"].edge * 1e3
    assert tests.path[0].length_mm == pytest.approx(0.8 * np.sqrt(3.0) * edge, rel=1e-6)
    assert by_name["large circle"].length_mm == pytest.approx(0.8 * np.pi * edge, rel=1e-3)
    assert by_name["small circle"].length_mm == pytest.approx(0.08 * np.pi * edge, rel=1e-3)


def test_a_cycle_on_which_the_beam_broke_is_driven_again_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    only_paths(monkeypatch, "line")
    task, findings = task_of(cell_of(one_arm()), "path"), IsoFindings()
    cells: list[Cell] = []
    crossed = crossed_beam(monkeypatch, cells, "left", 0.5)
    drive_tests(task, findings, opened=cells.append)
    (runs,) = findings.paths
    assert len(crossed) == 1
    assert [track.lost_beams for track in runs.tracks] == [1, 0]
    assert missing_words(findings, task.tests) == ()
    (words,) = lost_beam_words(findings)
    assert words.startswith("path of left, nominal commands, line P2 to P4: the beam broke 1 time; these cycles were")
    (path,) = results(task, findings)["left"].tests["nominal"].path
    assert path.points == 50, "no point is one of the cycle that was not ended"


@pytest.mark.slow
def test_poses_and_paths_are_repeated_at_other_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    only_paths(monkeypatch, "line")
    task = task_of(cell_of(one_arm(), noise=False), "pose", "path", also_speeds=(0.5,))
    findings, _ = driven(task)
    found = results(task, findings)["left"].tests["nominal"]
    (series,) = found.series
    assert series.speed_share == 0.5
    assert [one.pose for one in series.pose] == [one.pose for one in found.pose]
    for one, other in zip(found.pose, series.pose, strict=True):
        assert other.accuracy.value_mm == pytest.approx(one.accuracy.value_mm, abs=1e-6)  # an arm without dynamics
    assert [one.speed_mm_s for one in series.path] == [125.0]
    assert len(findings.measured.visits) == 2 * 2 * 5
    at_half = [runs for runs in findings.paths if runs.series == 0.5]
    assert len(at_half[0].tracks[0].p_M) == pytest.approx(len(findings.paths[0].tracks[0].p_M), rel=0.3)
    assert missing_words(findings, task.tests) == ()


def five_joints() -> Profile:
    """The left arm without its last joint: it cannot hold a rotation."""
    profile = one_arm()
    left = profile.arms["left"]
    capsules = tuple(one for one in left.type.capsules if one.frame <= 5)
    assert left.home is not None
    return altered(
        profile, arms={"left": {"type": {"joints": left.type.joints[:5], "capsules": capsules}, "home": left.home[:5]}}
    )


def test_the_drift_of_a_base_is_found() -> None:
    """A base that moves along its axis by 0.1 mm in ten minutes."""
    profile = cell_of(one_arm(), noise=False)
    drift = {"shift": [0.0, 0.0, 1e-4], "turn": [0.0, 0.0, 0.0], "law": "linear", "time": 600.0}
    task = task_of(altered(profile, plant={"effects": {"left": {"base_drift": drift}}}), "drift", drift_s=600.0)
    findings, _ = driven(task)
    found = sure(results(task, findings)["left"].tests["nominal"].drift)
    assert len(found.groups) == 3
    assert found.minutes == pytest.approx(10.0, abs=1.0)
    assert found.shift_mm == pytest.approx(0.01 * found.minutes, rel=1e-3)
    first, last = np.array(found.groups[0].error_mm), np.array(found.groups[-1].error_mm)
    np.testing.assert_allclose(last - first, [0.0, 0.0, found.shift_mm], atol=2e-3)
    assert found.accuracy.value_mm == pytest.approx(abs(np.linalg.norm(last) - np.linalg.norm(first)), abs=1e-6)


@pytest.mark.parametrize(
    "cell", [three_arms, seven_joints, five_joints], ids=["three arms", "seven joints", "five joints"]
)
def test_other_cells_find_cubes_that_the_gate_accepts(cell: Callable[[], Profile]) -> None:
    task = task_of(cell_of(cell()), "pose", arms=("left",))
    findings, _ = driven(task)
    cube = sure(results(task, findings)["left"].cube)
    assert cube.edge_mm > 200.0
    assert cube.limited_by
    assert missing_words(findings, task.tests) == ()


# -- faults ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def cells(monkeypatch: pytest.MonkeyPatch) -> list[Cell]:
    """The cells that are opened."""
    opened: list[Cell] = []
    monkeypatch.setattr("cellapp.cell.driving.supervision.open_cell", opening(opened.append))
    return opened


def tracker_of(cell: Cell) -> SimulatedTracker:
    assert isinstance(cell.tracker, SimulatedTracker)
    return cell.tracker


def at(done: int, act: Callable[[], object]) -> Callable[[Progress], None]:
    """Act at one visit."""

    def listen(event: Progress) -> None:
        if event.job == "iso9283" and event.done == done and event.total > done:
            act()

    return listen


@pytest.mark.parametrize("fault", ["protective stop", "link", "covered"])
def test_a_fault_in_mid_cycle_stops_all_arms_and_keeps_what_was_measured(fault: str, cells: list[Cell]) -> None:
    task = task_of(cell_of(small_twin()), "pose", arms=("left",))
    acts: dict[str, Callable[[], object]] = {
        "protective stop": lambda: cells[0].arms["right"].protective_stop(),  # type: ignore[attr-defined]
        "link": lambda: tracker_of(cells[0]).cut_link(),
        "covered": lambda: tracker_of(cells[0]).covered.add("left"),
    }
    findings = IsoFindings()
    with pytest.raises(HardwareError, match="without a measurement" if fault == "covered" else fault):
        drive_tests(task, findings, JobControl(at(4, acts[fault])))
    assert 2 <= len(findings.measured.visits) <= 5
    assert not any(plant_of(cells[0]).moving(name) for name in task.profile.arms)
    assert any("of 2 cycles" in words for words in missing_words(findings, task.tests))


EVENTS: dict[str, tuple[Callable[[SimulatedArm, SimulatedTracker], None], str]] = {
    "beam": (lambda arm, tracker: tracker.covered.add("left"), "the beam broke .* its SMR is not found again"),
    "protective stop": (lambda arm, tracker: arm.protective_stop(), "protective stop"),
    "emergency stop": (lambda arm, tracker: arm.emergency_stop(), "emergency stop"),
    "lost link": (lambda arm, tracker: arm.cut_link(), "link is cut"),
}


@pytest.mark.parametrize("event", EVENTS, ids=EVENTS)
def test_an_event_in_mid_path_stops_all_arms(event: str, cells: list[Cell], monkeypatch: pytest.MonkeyPatch) -> None:
    only_paths(monkeypatch, "line")
    happen, words = EVENTS[event]
    start, brake, braked = SimulatedArm.start_path, SimulatedArm.brake, list[str]()

    def started(arm: SimulatedArm, q: Any, period_s: float) -> None:
        plant = plant_of(cells[0])
        plant.schedule.at(plant.clock_s + 1.0, lambda: happen(arm, tracker_of(cells[0])))
        start(arm, q, period_s)

    def noted(arm: SimulatedArm) -> None:
        braked.append(arm.name)
        brake(arm)

    monkeypatch.setattr(SimulatedArm, "start_path", started)
    monkeypatch.setattr(SimulatedArm, "brake", noted)
    task = task_of(cell_of(small_twin()), "path", arms=("left",))
    with pytest.raises(HardwareError, match=words):
        drive_tests(task, IsoFindings())
    assert set(braked) == {"left", "right"}
    plant = plant_of(cells[0])
    plant.advance(1.0)  # after a lost link it is not watched until it rests
    assert not any(plant.moving(name) for name in ("left", "right"))


@pytest.mark.parametrize("verb", ["stop", "abort"])
def test_a_person_stops_the_test(verb: str, cells: list[Cell]) -> None:
    findings = IsoFindings()
    control = JobControl(at(3, lambda: control.ask(verb)))  # type: ignore[arg-type]
    task = task_of(cell_of(one_arm()), "pose")
    with pytest.raises(Exception, match=r"stopped|aborted"):
        drive_tests(task, findings, control)
    assert 1 <= len(findings.measured.visits) <= 3
    assert not plant_of(cells[0]).moving("left")


def test_paths_are_refused_by_name_where_the_tracker_cannot_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of(cell_of(one_arm()), "path")
    monkeypatch.setattr(SimulatedTracker, "stream_limits", lambda tracker: None)
    findings, _ = driven(task)
    assert findings.refused["left"]["path"] == "this tracker's driver cannot measure a moving SMR"
    assert missing_words(findings, task.tests) == ("arm left: this tracker's driver cannot measure a moving SMR",)
    assert missing_words(findings, ("pose", "path")) == ()
