"""One arm over its runs: what moved is named with its size, what did not is not; who the arm is."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import CONTROLLERS_RESULT, ArmIdentity, ControllerIdentity, arm_identities
from cellapp.commands.compare.run import compare_runs
from cellapp.commands.runs.result import ArmHistory
from cellapp.commands.runs.run import arm_history
from cellapp.commands.runs.view import history_sentences, history_table
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import comparable_arms
from cellapp.estimation.monitoring.moved import EXPANSION, CalibratedArm, determined_values, differences
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Traceability, TraceableArm
from tests.cell.run.small_runs import planned_run
from tests.cell.run.spoiled import spoil_cut
from tests.cell.run.two_arm_cell import two_arms
from tests.commands.measured_runs import Truth, cell, measured_run, set_month
from tests.program import app
from tests.twin import small_twin

SERIALS = ("UR10-77", "UR5-12")
DRIFT = 60e-6
"""Of joint 3 of the left arm [rad a month]."""
MONTHS = 4


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some months of a cell in which the zero of a joint of the left arm moves. No test may write to it."""
    folder = tmp_path_factory.mktemp("worn")
    for month in range(MONTHS):
        truth = Truth((("theta3", DRIFT * month), ("x0", 1e-3 * month)))
        run = measured_run(folder / f"m{month}", 40 + month, truth, profile=cell(40 + month, serials=SERIALS))
        set_month(run, month)
    return folder


def test_the_joint_that_moved_is_named_with_its_size_and_the_moved_base_is_not(worn: Path) -> None:
    result = arm_history("UR10-77", worn)
    assert ArmHistory.from_json(result.to_json(), "history") == result
    assert (result.arm, result.known_by) == ("UR10-77", "profile")
    assert [Path(run.run).name for run in result.runs] == [f"m{month}" for month in range(MONTHS)]
    assert [run.compared for run in result.runs] == [False, True, True, True]
    for month, run in enumerate(result.runs[1:], 1):
        (theta3,) = run.moved
        assert theta3.name == "theta3"
        assert theta3.difference == pytest.approx(month * DRIFT, abs=3 * theta3.standard_uncertainty)
        assert theta3.chance <= result.false_alarm
        assert theta3.moved_mm == pytest.approx(run.moved[0].difference * 0.5e3, rel=0.5), "a lever of some 0.5 m"
    rows = history_table(result).text_rows()
    assert rows[0][-1] == "first calibration"
    assert rows[3][-1].startswith("theta3 +")
    assert "theta3 moves the SMR by" in "\n".join(history_sentences(result))


def test_an_arm_that_did_not_change_moved_nowhere(worn: Path) -> None:
    result = arm_history("right", worn)
    assert result.arm == "UR5-12"
    assert result.comparisons > 40
    assert not any(run.moved for run in result.runs)
    assert {row[-1] for row in history_table(result).text_rows()} == {"first calibration", "nothing"}
    assert "no parameter moved beyond its uncertainty" in "\n".join(history_sentences(result))


def test_the_more_runs_the_more_must_differ(worn: Path, tmp_path: Path) -> None:
    for month in (0, 1):
        shutil.copytree(worn / f"m{month}", tmp_path / f"m{month}")
    few, many = (arm_history("left", folder).runs[1].moved[0].chance for folder in (tmp_path, worn))
    assert many == pytest.approx((MONTHS - 1) * few)


def test_compare_judges_by_the_same_differences(worn: Path) -> None:
    with RunFile.open(worn / "m0") as a, RunFile.open(worn / "m3") as b:
        values = {one.name: one for one in compare_runs(a, b).arms["left"].parameters}
    (theta3,) = arm_history("left", worn).runs[3].moved
    assert (values["theta3"].difference, values["theta3"].standard_uncertainty) == (
        theta3.difference,
        theta3.standard_uncertainty,
    )
    assert values["x0"].differs, "compare shows the base too"


def test_a_name_that_stands_for_two_arms_is_refused_and_serial_numbers_keep_them_apart(
    worn: Path, tmp_path: Path
) -> None:
    shutil.copytree(worn / "m0", tmp_path / "m0")
    measured_run(tmp_path / "other", 9, profile=cell(9, serials=("UR10-78", "UR5-12")))
    with pytest.raises(InputError, match=r"'left' is not one arm in all runs.*'UR10-77', 'UR10-78'"):
        arm_history("left", tmp_path)
    assert [Path(run.run).name for run in arm_history("UR10-78", tmp_path).runs] == ["other"]
    assert len(arm_history("right", tmp_path).runs) == 2
    with pytest.raises(InputError, match=r"no arm 'middle'.*UR10-77, UR10-78, UR5-12"):
        arm_history("middle", tmp_path)
    with RunFile.open(tmp_path / "m0") as a, RunFile.open(tmp_path / "other") as b:
        result = compare_runs(a, b)
    said = f"arm 'left' has the serial number UR10-77 in {tmp_path / 'm0'} and UR10-78 in {tmp_path / 'other'}"
    assert any(note.startswith(said) for note in result.notes)
    assert result.arms["left"].parameters == ()
    assert result.arms["right"].parameters != ()


def test_runs_that_cannot_be_compared_say_why(worn: Path, tmp_path: Path) -> None:
    for month in (0, 1):
        shutil.copytree(worn / f"m{month}", tmp_path / f"m{month}")
    with RunFile.open(tmp_path / "m1", write=True) as run:
        readings = run.readings("left").take([0])
        run.add_readings("left", replace(readings, configuration=readings.configuration + 1000))
    RunFile.create(tmp_path / "plan", cell(serials=SERIALS)).close()
    with planned_run(tmp_path / "broken", 200) as run:
        for _ in range(200):
            run.log("info", "x" * 200)
    spoil_cut(tmp_path / "broken" / "run.sqlite")
    result = arm_history("left", tmp_path)
    remarks = {Path(run.run).name: run.remark for run in result.runs}
    assert remarks["m0"] == "first calibration"
    assert "'calibrate' is out of date (1 reading was added since)" in remarks["m1"]
    assert remarks["plan"] == "not calibrated"
    assert any("is cut off" in problem for problem in result.problems)
    assert "nothing is compared" in history_sentences(result)[-1]


def test_links_that_are_warmer_are_longer_and_have_not_moved(worn: Path) -> None:
    cool, warm = (calibrated(worn / name) for name in ("m0", "m1"))
    cool, warm = (replace(arm, temperatures_c={"air": t}) for arm, t in ((cool, 20.0), (warm, 35.0)))
    same = {one.name: one for one in differences(replace(cool, temperatures_c={}), warm)}
    other = {one.name: one for one in differences(cool, warm)}
    for name, one in other.items():
        growth = EXPANSION * 15.0 * one.later.length_m
        assert one.standard_uncertainty == pytest.approx(np.hypot(same[name].standard_uncertainty, growth))
        assert (growth > 0.0) == (one.unit == "m")


def test_an_angle_near_half_a_turn_may_have_either_sign(worn: Path) -> None:
    first = calibrated(worn / "m0")
    names, vector = first.model.geometry.names, first.model.geometry.vector()
    vector[names.index("theta3")] += 2.0 * np.pi
    turned = replace(first, model=replace(first.model, geometry=first.model.geometry.with_vector(vector)))
    assert all(abs(one.difference) < 1e-12 for one in differences(first, turned))


def test_a_change_of_a_parameter_that_others_take_over_is_found_in_these(worn: Path) -> None:
    first = calibrated(worn / "m0")
    dropped, takers = next((name, takers) for name, takers in first.merged.items() if takers)
    assert dropped in first.identified
    before = determined_values(first, first)
    vector = first.model.geometry.vector()
    vector[first.model.geometry.names.index(dropped)] += 1e-3
    moved = replace(first, model=replace(first.model, geometry=first.model.geometry.with_vector(vector)))
    after = determined_values(moved, first)
    for name, share in takers.items():
        if name in before:
            assert after[name].value - before[name].value == pytest.approx(1e-3 * share)


def calibrated(folder: Path) -> CalibratedArm:
    """The left arm of a run."""
    with RunFile.open(folder) as run:
        return comparable_arms(run, read_stages(run))["left"]


def test_the_command_says_and_writes(worn: Path, tmp_path: Path) -> None:
    numbers = tmp_path / "history.json"
    done = CliRunner().invoke(app, ["runs", str(worn), "--history", "left", "--json", str(numbers)])
    assert done.exit_code == 0
    assert "theta3 +" in done.stdout
    assert ArmHistory.from_json(numbers.read_text("utf-8"), "history").arm == "UR10-77"


# -- who an arm is ----------------------------------------------------------------------------------------------------


def identities(folder: Path, profile: Profile, serials: dict[str, str]) -> dict[str, ArmIdentity]:
    with planned_run(folder, profile=profile) as run:
        if serials:
            recorded = {name: ControllerIdentity("UR10", serial, "5.1", "") for name, serial in serials.items()}
            run.write_result(CONTROLLERS_RESULT, json.dumps({name: vars(one) for name, one in recorded.items()}))
        return dict(arm_identities(run))


@pytest.mark.fast
def test_an_arm_is_known_by_its_controller_then_by_the_profile_then_by_names(tmp_path: Path) -> None:
    profile = two_arms()
    given = profile.model_copy(
        update={
            "traceability": Traceability(arms={"left": TraceableArm(serial="P-1"), "right": TraceableArm(serial="P-2")})
        }
    )
    bare = identities(tmp_path / "bare", profile, {})
    assert bare["left"] == ArmIdentity("two, left (left)", "names")
    by_profile = identities(tmp_path / "profile", given, {"right": ""})
    assert [one.key for one in by_profile.values()] == ["P-1", "P-2"]
    by_controller = identities(tmp_path / "controller", given, {"left": "C-1"})
    assert by_controller["left"] == ArmIdentity("C-1", "controller", "C-1")
    assert by_controller["right"].known_by == "profile"
    assert by_controller["right"].is_other_than(ArmIdentity("P-3", "profile", "P-3"))
    assert not by_controller["right"].is_other_than(by_controller["left"]), "numbers of different things"
    assert not bare["left"].is_other_than(bare["right"])


@pytest.mark.fast
def test_a_damaged_record_of_controllers_leaves_the_names(tmp_path: Path) -> None:
    with planned_run(tmp_path / "run") as run:
        run.write_result(CONTROLLERS_RESULT, "[]")
        assert arm_identities(run)["left"].known_by == "names"


@pytest.mark.fast
def test_simulated_arms_have_no_serial_number_of_their_own(tmp_path: Path) -> None:
    profile = small_twin()
    with RunFile.create(tmp_path / "run", profile) as run:
        recorded = {name: vars(ControllerIdentity("simulated", f"SIM-{name}", "", "")) for name in profile.arms}
        run.write_result(CONTROLLERS_RESULT, json.dumps(recorded))
        assert {one.known_by for one in arm_identities(run).values()} == {"names"}
