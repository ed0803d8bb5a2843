"""Fleets of runs that the product made: unchanged arms, a joint that drifts, backlash that appears and grows."""

from __future__ import annotations

import contextlib
import json
import shutil
import sqlite3
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.commands.compare.run import compare_runs
from cellapp.commands.fleet.run import compare_many, fleet
from cellapp.commands.fleet.view import fleet_sentences, runs_table
from cellapp.commands.schema.results import json_schema
from cellapp.estimation.monitoring.fleet.records import ArmHistory, FleetResult
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.app import app
from tests.cell.run.small_runs import planned_run
from tests.cell.run.spoiled import spoil_cut
from tests.estimation.monitoring.fleet.runs import Truth, cell, measured_run, set_month

SERIALS = ("UR10-77", "UR5-12")
DRIFT = 60e-6
"""Of joint 3 of the left arm [rad a month]."""
PLAY = (0.0, 0.0, 0.0, 4e-5, 1e-4, 1.6e-4)
"""Half of the play of its joints 1 to 3 [rad], by month."""


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six months of a cell whose left arm wears. No test may write to it."""
    folder = tmp_path_factory.mktemp("worn")
    for month, half_play in enumerate(PLAY):
        profile = cell(40 + month, serials=SERIALS, tolerance_m=1e-4)
        truth = Truth((("theta3", DRIFT * month),), half_play)
        set_month(measured_run(folder / f"m{month}", 40 + month, truth, profile=profile, search=True), month)
    return folder


@pytest.fixture(scope="module")
def history(worn: Path) -> FleetResult:
    result = fleet([worn])
    assert FleetResult.from_json(result.to_json(), "fleet") == result
    Draft202012Validator(json_schema(FleetResult)).validate(json.loads(result.to_json()))
    return result


@pytest.fixture
def left(history: FleetResult) -> ArmHistory:
    return history.arms["UR10-77"]


def test_the_worn_arm_comes_first_and_the_other_is_unchanged(history: FleetResult) -> None:
    assert [(name, arm.condition) for name, arm in history.arms.items()] == [
        ("UR10-77", "changed"),
        ("UR5-12", "unchanged"),
    ]
    assert [Path(run.run).name for run in history.runs] == [f"m{month}" for month in range(6)]
    assert {arm.known_by for arm in history.arms.values()} == {"profile"}
    right = history.arms["UR5-12"]
    assert not any(change.proven for one in right.parameters for change in one.changes)
    assert not any(trend.proven for trend in right.trends)
    (pair,) = history.pairs
    assert not pair.moved


def test_the_joint_that_drifts_is_named_with_its_size(left: ArmHistory) -> None:
    theta3 = next(one for one in left.parameters if one.name == "theta3")
    last = theta3.last
    assert last is not None
    assert last.proven
    assert last.difference == pytest.approx(5 * DRIFT, abs=3 * last.standard_uncertainty)
    assert [one.name for one in left.parameters if one.last is not None and one.last.proven] == ["theta3"]
    (trend,) = [trend for trend in left.trends if trend.proven]
    assert (trend.figure, trend.name) == ("parameter", "theta3")
    assert theta3.moved_mm_per_unit is not None
    assert trend.slope == pytest.approx(DRIFT * theta3.moved_mm_per_unit, rel=0.25)
    assert trend.crossing is not None


def test_backlash_appears_when_it_is_there(left: ArmHistory) -> None:
    (backlash,) = left.effects
    assert (backlash.effect, backlash.state, backlash.where.joints) == ("backlash", "appeared", (1, 2, 3))
    assert [size.found for size in backlash.sizes] == [False, False, False, True, True, True]
    sizes = [size.size_mm for size in backlash.sizes if size.size_mm is not None]
    assert sizes == sorted(sizes)


def test_backlash_grows_between_runs_that_both_have_it(worn: Path) -> None:
    result = compare_many([worn / f"m{month}" for month in (3, 4, 5)])
    (backlash,) = result.arms["UR10-77"].effects
    assert backlash.state == "grew"
    assert backlash.difference == pytest.approx(1.2e-4, rel=0.2)


def test_the_first_folder_is_what_others_are_compared_with(worn: Path) -> None:
    result = compare_many([worn / "m5", worn / "m0", worn / "m1"])
    left = result.arms["UR10-77"]
    assert [Path(run).name for run in left.runs] == ["m5", "m0", "m1"]
    assert [effect.state for effect in left.effects] == ["vanished"]
    theta3 = next(one for one in left.parameters if one.name == "theta3")
    assert all(change.difference < 0.0 for change in theta3.changes)


@pytest.mark.parametrize(
    ("names", "says"),
    [(("m0",), "at least two"), (("m0", "m1", "m0"), "is given twice"), (("m0", "m1", "none"), "run folder not found")],
    ids=["one", "twice", "missing"],
)
def test_runs_that_cannot_be_compared(worn: Path, names: tuple[str, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        compare_many([worn / name for name in names])


def test_two_runs_of_other_arms_are_said_to_be_and_their_parameters_not_compared(worn: Path, tmp_path: Path) -> None:
    other = measured_run(tmp_path / "other", 9, profile=cell(9, serials=("UR10-78", "UR5-12")))
    with RunFile.open(worn / "m0") as a, RunFile.open(other) as b:
        result = compare_runs(a, b)
    said = f"arm 'left' has the serial number UR10-77 in {worn / 'm0'} and UR10-78 in {other}"
    assert any(note.startswith(said) for note in result.notes)
    assert result.arms["left"].parameters == ()
    assert result.arms["right"].parameters != ()
    many = compare_many([worn / "m0", worn / "m1", other])
    assert f"arm 'UR10-78' is not in {worn / 'm0'}: it is compared with nothing" in many.notes
    assert many.arms["UR10-78"].condition == "not compared"
    assert set(fleet([worn / "m0", other]).arms) == {"UR10-77", "UR10-78", "UR5-12"}


def test_each_run_counts_once_and_one_that_cannot_be_read_is_a_row(worn: Path, tmp_path: Path) -> None:
    with planned_run(tmp_path / "broken", 200) as run:
        for _ in range(200):
            run.log("info", "x" * 200)
    spoil_cut(tmp_path / "broken" / "run.sqlite")
    result = fleet([worn, worn / "m1", tmp_path])
    assert len(result.runs) == len(PLAY) + 1
    (broken,) = [run for run in result.runs if run.problem]
    assert "is cut off" in broken.problem
    assert broken.problem in fleet_sentences(result)
    assert ("broken", "cannot be read") in [(row[0].split("/")[-1], row[2]) for row in runs_table(result).text_rows()]


def test_copies_of_a_run_are_one_measurement(worn: Path, tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        shutil.copytree(worn / "m0", tmp_path / name)
    shutil.copytree(worn / "m1", tmp_path / "later")
    result = fleet([tmp_path])
    assert len(result.runs) == 2
    assert [note for note in result.notes if "counts once" in note] == [
        f"{tmp_path / 'a'} counts once; copies of it: {tmp_path / 'b'}, {tmp_path / 'c'}"
    ]


def test_a_plan_alone_is_a_run_without_figures(tmp_path: Path) -> None:
    planned_run(tmp_path / "plan").close()
    result = fleet([tmp_path])
    assert {arm.condition for arm in result.arms.values()} == {"not compared"}
    assert [run.notes for run in result.runs] == [("is not calibrated",)]


def test_a_run_that_does_not_say_when_it_was_made_has_the_time_of_its_file(worn: Path, tmp_path: Path) -> None:
    shutil.copytree(worn / "m0", tmp_path / "m0")
    with contextlib.closing(sqlite3.connect(tmp_path / "m0" / "run.sqlite")) as connection:
        connection.execute("DELETE FROM meta WHERE key = 'created'")
        connection.commit()
    (run,) = fleet([tmp_path]).runs
    assert run.problem == ""
    assert run.began.startswith("20")


def test_an_empty_folder_and_none(tmp_path: Path) -> None:
    result = fleet([tmp_path])
    assert result.arms == {}
    assert result.notes == (f"no runs below {tmp_path}; 'cellapp run PROFILE' makes one",)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="folder not found"):
        fleet([tmp_path / "none"])
    with pytest.raises(InputError, match="at least one folder"):
        fleet([])


def test_results_that_no_longer_hold_are_said_and_not_compared(worn: Path, tmp_path: Path) -> None:
    shutil.copytree(worn / "m0", tmp_path / "m0")
    shutil.copytree(worn / "m1", tmp_path / "m1")
    with RunFile.open(tmp_path / "m1", write=True) as run:
        readings = run.readings("left").take([0])
        object.__setattr__(readings, "configuration", readings.configuration + 1000)
        run.add_readings("left", readings)
    result = fleet([tmp_path])
    assert any("'calibrate' is out of date (1 reading was added since)" in note for note in result.runs[1].notes)
    assert result.arms["UR10-77"].compared == (str(tmp_path / "m0"),)
    assert result.arms["UR10-77"].condition == "not compared"


def test_the_command_says_writes_and_judges(worn: Path, tmp_path: Path) -> None:
    page, numbers = tmp_path / "fleet.html", tmp_path / "fleet.json"
    done = CliRunner().invoke(app, ["fleet", str(worn), "--page", str(page), "--json", str(numbers)])
    assert done.exit_code == 0
    assert "UR10-77: changed" in done.stdout
    assert "false alarm: " in done.stdout
    stored = FleetResult.from_json(numbers.read_text("utf-8"), "fleet")
    assert stored.complaints() != []
    assert "UR10-77" in page.read_text("utf-8")
    strict = CliRunner().invoke(app, ["fleet", str(worn), "--strict"])
    assert strict.exit_code == 1
    sound = CliRunner().invoke(app, ["fleet", str(worn / "m0"), "--strict"])
    assert sound.exit_code == 0, sound.stdout
    three = [str(worn / f"m{month}") for month in range(3)]
    done = CliRunner().invoke(app, ["compare", *three, "--json", "-"])
    assert json.loads(done.stdout)["schema"] == "cellapp-fleet"
    two = CliRunner().invoke(app, ["compare", *three[:2], "--json", "-"])
    assert json.loads(two.stdout)["schema"] == "cellapp-comparison"
    unwritable = CliRunner().invoke(app, ["fleet", str(worn), "--page", str(tmp_path / "none" / "fleet.html")])
    assert "fleet.html: folder not found; nothing was done" in str(unwritable.exception)
