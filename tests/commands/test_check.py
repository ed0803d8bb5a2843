"""The check of a stored calibration on the simulated cell: what it finds, what follows from it, and what stops it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.prior_source import earlier_arms
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.check.run import plant_of
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.stages import append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import stage_in_force
from cellapp.estimation.monitoring.records import CheckResult
from cellapp.ground.control import JobControl, Stopped
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Plant
from cellapp.ground.profile.sections import Smr
from cellapp.ground.progress import Progress
from cellapp.ground.results import CHECK, DISCOVER
from drivers.trackers.simulated import SimulatedTracker
from tests.cell.driving.test_check import SOME, away, swap_splits
from tests.sure import sure
from tests.twin import PROFILES, altered, finished_twin, opening
from tests.twin import plant_of as opened_plant
from tests.verbs import check_run, locate_run, opened_by, push_run

TEN_MINUTES_S = 600.0


@pytest.fixture
def run(finished_copy: Path) -> Iterator[RunFile]:
    with RunFile.open(finished_copy, write=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def checked_folder(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose check found that an arm has changed. No test may write to it."""
    folder = tmp_path_factory.mktemp("checked") / "run"
    shutil.copytree(finished_run, folder)
    with RunFile.open(folder, write=True) as opened:
        check_run(opened, simulated_plant=other_zero(opened.profile))
    return folder


@pytest.fixture
def arm_changed(checked_folder: Path, tmp_path: Path) -> Iterator[tuple[RunFile, CheckResult]]:
    """A copy of that run, and its check."""
    with RunFile.open(Path(shutil.copytree(checked_folder, tmp_path / "changed")), write=True) as opened:
        found = sure(read_results(opened).check)
        yield opened, found


def changed(profile: Profile, arm: str, **effects: Any) -> Plant:
    """The hidden physics of a profile with further effects of one arm."""
    plant = sure(profile.plant)
    return plant.model_copy(update={"effects": {**plant.effects, arm: {**plant.effects.get(arm, {}), **effects}}})


def other_zero(profile: Profile, arm: str = "left", joint: int = 3, rad: float = 0.3e-3) -> Plant:
    """An encoder that was mounted anew: the zero of one joint changed."""
    drift = [rad if number == joint else 0.0 for number in range(1, 7)]
    return changed(profile, arm, joint_drift={"drift": drift, "time_constant": [1e-3] * 6})


def kicked_tracker(profile: Profile) -> Plant:
    plant = sure(profile.plant)
    kicked = away(profile.tracker.pose, (0.02, -0.03, 0.0), (0.002, 0.0, 0.01))
    return plant.model_copy(update={"tracker_pose": kicked})


def kicked_base(profile: Profile) -> Plant:
    return changed(profile, "left", base_step={"shift": [3e-3, 0.0, 0.0], "turn": [0.0, 0.0, 0.0], "time": 0.0})


def remounted_smr(profile: Profile) -> Plant:
    return changed(profile, "left", target_slip={"shift": [0.4e-3, 0.0, -0.3e-3], "time": 0.0})


# -- what it finds ----------------------------------------------------------------------------------------------------


FRICTION = {"friction": [8.0] * 6, "load_friction": [0.1] * 6, "stiffness": [6e4, 5e4, 3e4, 1e4, 1e4, 1e4]}


@pytest.mark.parametrize(
    "hidden", [pytest.param({}, marks=pytest.mark.slow), {"friction_windup": FRICTION}], ids=["twin", "friction"]
)
def test_what_a_calibration_left_unexplained_is_no_change(tmp_path: Path, hidden: dict[str, Any]) -> None:
    profile = finished_twin(80)
    profile = altered(profile, plan={"method": "random"})
    for name in profile.arms:
        profile = profile.model_copy(update={"plant": changed(profile, name, **hidden)})
    with new_planned_run(profile, tmp_path / "run") as run:
        collect_run(run)
        calibrate_run(run)
        first, second = check_run(run), check_run(run)
        assert (first.verdict, second.verdict) == ("valid", "valid")
        errors = [[point.error_mm for stop in one.stops for point in stop.points.values()] for one in (first, second)]
        assert not set(errors[0]) & set(errors[1])  # each measurement has its own noise
        visible = 3.0 * first.visible["left"]["zero of joint 3"]
        found = check_run(run, simulated_plant=other_zero(run.profile, rad=visible))
        assert (found.verdict, found.changes[0].what) == ("arm changed", "zero of joint 3")


def test_an_unchanged_cell_is_valid_within_ten_minutes(run: RunFile) -> None:
    found = check_run(run)
    assert (found.verdict, found.complaints(), found.next_step) == ("valid", [], "")
    assert found.sure_after == len(found.stops) <= found.planned == 20
    assert sure(found.seconds) / len(found.stops) * found.planned < TEN_MINUTES_S
    assert set(found.arms) == {"left", "right"}
    assert all(set(stop.points) == {"left", "right"} for stop in found.stops)
    assert max(point.error_mm for stop in found.stops for point in stop.points.values()) < 0.15
    stages = read_stages(run)
    assert (stages.stale_model(), run_overview(RunState(run)).stale) == ("", "")
    assert CheckResult.from_json(stages.current[CHECK].text, "") == found == read_results(run).check
    basis = sure(stages.current[CHECK].basis)
    assert list(basis.stages) == [DISCOVER]


def test_the_other_zero_of_a_joint_is_measured(arm_changed: tuple[RunFile, CheckResult]) -> None:
    run, found = arm_changed
    assert (found.verdict, found.simulated) == ("arm changed", True)
    assert "cellapp calibrate NEW --prior" in found.next_step
    assert found.complaints() == ["the calibration does not hold as it is: arm changed (arm left: zero of joint 3)"]
    assert run_overview(RunState(run)).stale == "the last 'check' found: arm changed"
    change, *others = found.changes
    assert (change.words, change.unit, others) == ("arm left: zero of joint 3", "rad", [])
    assert change.value == pytest.approx(0.3e-3, abs=5e-5)


@pytest.mark.parametrize(
    ("change", "verdict", "says", "next_step"),
    [
        (kicked_tracker, "tracker moved", "tracker", "--tracker-moved"),
        (kicked_base, "base moved", "left", "put the base back"),
        (remounted_smr, "smr moved", "left", "put the SMR back"),
    ],
    ids=["tracker", "base", "smr"],
)
def test_a_change_is_named_and_the_model_not_used(
    run: RunFile, change: Callable[[Profile], Plant], verdict: str, says: str, next_step: str
) -> None:
    found = check_run(run, simulated_plant=change(run.profile))
    assert (found.verdict, found.simulated) == (verdict, True)
    assert says in found.changes[0].words
    assert next_step in found.next_step
    (complaint,) = found.complaints()
    assert verdict in complaint
    stale = read_stages(run).stale_model()
    assert stale == f"the last 'check' found: {verdict}" == run_overview(RunState(run)).stale
    assert compensate_run(run, SOME).notes[0].endswith(stale)
    with pytest.raises(InputError, match="nothing was moved"):
        push_run(run, SOME, verify=True)
    if verdict == "tracker moved":
        assert read_stages(run).next_verb() == "check --tracker-moved"
        assert found.station_shift_mm == pytest.approx(np.hypot(20.0, 30.0), abs=0.5)
        assert found.station_turn_deg == pytest.approx(np.degrees(np.hypot(0.002, 0.01)), abs=0.01)


# -- what follows from it ---------------------------------------------------------------------------------------------


def test_a_located_tracker_makes_the_model_hold_again(run: RunFile) -> None:
    moved = kicked_tracker(run.profile)
    locate_run(run, simulated_pose=moved.tracker_pose)
    assert read_stages(run).stale_model() == ""
    again = check_run(run)
    assert (again.verdict, again.model) == ("valid", "locate")
    back = moved.model_copy(update={"tracker_pose": run.profile.tracker.pose})
    assert check_run(run, simulated_plant=back).verdict == "tracker moved", "moved again since"


def test_no_location_of_the_tracker_mends_an_arm(arm_changed: tuple[RunFile, CheckResult]) -> None:
    run, _ = arm_changed
    locate_run(run)
    stages = read_stages(run)
    assert CHECK not in stages.out_of_date
    assert stages.stale_model() == "the last 'check' found: arm changed"
    assert stages.next_step(run.folder) == "cellapp docs planning"


def test_another_calibration_makes_the_finding_void(arm_changed: tuple[RunFile, CheckResult]) -> None:
    run, _ = arm_changed
    calibrate_run(run)
    assert read_stages(run).stale_model() == "the last 'check' found: arm changed", "the same outcome again"
    swap_splits(run)
    notes = calibrate_run(run).notes
    assert any(note.startswith("the check of the calibration is out of date") for note in notes)
    stages = read_stages(run)
    assert CHECK in stages.out_of_date
    assert "check" not in stages.stale_model()


def test_a_check_that_could_not_say_does_not_refute_a_finding(arm_changed: tuple[RunFile, CheckResult]) -> None:
    run, found = arm_changed
    basis = basis_on_model(run, stage_in_force(run, read_stages(run)))
    append_stage(run, CHECK, found.model_copy(update={"verdict": "not decided", "changes": ()}), basis)
    assert read_results(run).check == found
    assert check_run(run).verdict == "valid"
    assert read_stages(run).stale_model() == ""


def test_a_changed_arm_is_still_a_prior(arm_changed: tuple[RunFile, CheckResult], tmp_path: Path) -> None:
    run, _ = arm_changed
    with RunFile.create(tmp_path / "new", run.profile) as new:
        assert set(earlier_arms(new, run.folder)) == {"left", "right"}


def test_a_run_whose_tracker_was_located_is_a_prior_by_the_model_of_its_readings(run: RunFile, tmp_path: Path) -> None:
    locate_run(run)
    with RunFile.create(tmp_path / "new", run.profile) as new:
        assert earlier_arms(new, run.folder)["left"].stage == "discover"


def test_a_model_that_is_out_of_date_is_checked_and_said_to_be(run: RunFile) -> None:
    swap_splits(run)
    found = check_run(run)
    assert "out of date" in found.stale
    assert found.notes[0].startswith("the model in force, that of 'discover', was checked although")
    assert found.complaints(strict=True)[-1].startswith("the model was out of date")
    assert found.verdict != "valid" or not found.complaints()


# -- what stops it ----------------------------------------------------------------------------------------------------


def test_the_stop_key_ends_it_and_nothing_is_stored(run: RunFile) -> None:
    opened: list[Cell] = []

    def pressed(event: Progress) -> None:
        if event.job == "check" and event.done == 2:
            control.stop()

    control = JobControl(pressed)
    with pytest.raises(Stopped), opened_by(opening(opened.append)):
        check_run(run, control)
    assert CHECK not in read_stages(run).current
    assert not any(opened_plant(opened[0]).moving(name) for name in run.profile.arms)


def covering(run: RunFile, *arms: str, at: int) -> CheckResult:
    """Check while the SMRs of some arms are covered from one stop on."""
    opened: list[Cell] = []

    last: list[Progress] = []

    def cover(event: Progress) -> None:
        last[:] = [event]
        if event.job == "check" and event.done == at:
            tracker = opened[0].tracker
            assert isinstance(tracker, SimulatedTracker)
            tracker.covered |= set(arms)

    with opened_by(opening(opened.append)):
        found = check_run(run, JobControl(cover))
    assert (last[0].job, last[0].done) == ("check", last[0].total)
    return found


def test_an_smr_that_is_lost_leaves_the_verdict_open(run: RunFile) -> None:
    found = covering(run, "left", at=1)
    assert found.verdict == "not decided"
    assert any("arm left: its SMR was not found at 3 stops in a row" in note for note in found.notes)
    assert found.complaints() == ["whether the calibration holds is not known"]
    assert set(found.stops[-1].points) == {"right"}
    assert read_stages(run).stale_model() == ""


def test_without_any_smr_nothing_is_stored(run: RunFile) -> None:
    with pytest.raises(HardwareError, match="no SMR could be measured at any stop"):
        covering(run, "left", "right", at=0)
    assert CHECK not in read_stages(run).current


def test_what_cannot_be_checked_is_refused_before_anything_moves(run: RunFile, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--stops: expected at least 4, got 3"):
        check_run(run, stops=3)
    with pytest.raises(InputError, match="unknown arm third"):
        check_run(run, simulated_plant=Plant(effects={"third": {}}))
    with RunFile.create(tmp_path / "empty", run.profile) as empty, pytest.raises(InputError, match="not calibrated"):
        check_run(empty)
    real = PROFILES / "ur10-ur5.yaml"
    with pytest.raises(InputError, match="has no section 'plant'"):
        plant_of(real)
    assert load_profile(real).plant is None


def test_another_plant_is_refused_for_arms_that_are_not_simulated(run: RunFile) -> None:
    from cellapp.commands.check.run import _with_plant

    plant = sure(run.profile.plant)
    with pytest.raises(InputError, match="--simulated-plant changes a simulated cell"):
        _with_plant(load_profile(PROFILES / "ur10-ur5.yaml"), plant)


def test_a_probe_shows_a_change_that_positions_do_not(tmp_path: Path) -> None:
    """Joint 6 hardly moves an SMR near its axis; a 6-D probe on the flange shows that it turns."""
    twin = finished_twin(40)
    left = twin.arms["left"]
    smr = Smr.model_validate({**left.smr.model_dump(), "probe": {"rpy": (0.1, -0.2, 0.3), "sigma": 1e-4}})
    alone = altered(
        twin, arms={"left": left.model_copy(update={"smr": smr})}, plant={"effects": {}}, plan={"method": "random"}
    )
    with new_planned_run(alone, tmp_path / "run") as run:
        collect_run(run)
        calibrate_run(run)
        same = check_run(run)
        assert same.verdict == "valid"
        assert sum(stop.points["left"].error_mrad is not None for stop in same.stops) >= len(same.stops) - 2
        found = check_run(run, simulated_plant=other_zero(alone, joint=6, rad=5e-4))
        assert found.verdict == "arm changed"
        assert "zero of joint 6" in {name for one in found.changes for name in (one.what, *one.rivals)}
        assert found.changes[0].turned_mrad is not None
        assert found.changes[0].moved_mm < 0.03
