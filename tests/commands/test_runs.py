"""The list of runs: every run below a folder in a typed row, quickly, without changing any, whatever is there."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import sqlite3
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.requests import taking_requests
from cellapp.cell.run import RunFile, SessionEnd
from cellapp.cell.run.run_arms import CONTROLLERS_RESULT, StoredIdentity, arm_identities
from cellapp.commands.run_results import read_results
from cellapp.commands.runs.result import ArmHistory, RunsResult, RunSummary
from cellapp.commands.runs.run import arm_history, list_runs, summarise
from cellapp.commands.runs.view import history_sentences, history_table, runs_sentences, runs_tables
from cellapp.commands.show.comparison import (
    GEOMETRY,
    TRANSFORM,
    RunComparison,
    ValueComparison,
    compare_runs,
    comparison_sentences,
    comparison_tables,
)
from cellapp.commands.stages import append_stage, basis_of, read_stages
from cellapp.commands.stored_model import comparable_arms
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.monitoring.parameter_changes import EXPANSION, CalibratedArm, determined_values, differences
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.job_client import JOB_FILE
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Traceability, TraceableArm
from cellapp.ground.results import DISCOVER
from drivers.findings import ArmIdentity
from tests.cell.run.small_runs import (
    SPOILED,
    add_stop,
    alter_file,
    collected_run,
    files,
    planned_run,
    set_began,
    spoil_cut,
    two_arms,
)
from tests.commands.measured_runs import Truth, cell, measured_run, set_month
from tests.interfaces.page.runs import without_devices
from tests.program import app
from tests.sure import sure
from tests.twin import small_twin

NEVER_WAITS_S = 5.0
"""Half of the time that a write waits for another program's lock."""


def resumable(folder: Path | None = None) -> RunSummary | None:
    """The newest run that can be resumed."""
    return next((run for run in list_runs(folder).runs if run.resumable), None)


def names(result: RunsResult) -> list[str]:
    return [Path(run.run).name for run in result.runs]


def test_every_run_below_a_folder_newest_first_and_nothing_else(tmp_path: Path) -> None:
    for minute, name in enumerate(("b/first", "second", "a/deep/third", ".hidden/run", "one/two/three/too-deep")):
        planned_run(tmp_path / name).close()
        set_began(tmp_path / name, minute)
    (tmp_path / "empty").mkdir()
    (tmp_path / "note.txt").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "second")
    before = files(tmp_path)
    result = list_runs(tmp_path)
    assert names(result) == ["third", "second", "first"]
    assert files(tmp_path) == before
    assert names(list_runs(tmp_path / "second")) == ["second"], "the folder of a run is a list of one"


@pytest.mark.parametrize(
    ("outcome", "measured", "interrupted", "words"),
    [
        ("complete", 4, False, "4/4"),
        ("complete", 2, False, "2/4"),
        ("accurate enough", 2, False, "2/4 accurate enough"),
        ("stopped", 2, True, "2/4 stopped"),
        ("aborted", 0, True, "0/4 aborted"),
        ("failed", 3, True, "3/4 failed"),
        ("stopped", 4, False, "4/4 stopped"),
        (None, 2, True, "2/4 no end"),
    ],
)
def test_a_run_whose_last_session_ended_early_can_be_resumed(
    tmp_path: Path, outcome: SessionEnd | None, measured: int, interrupted: bool, words: str
) -> None:
    folder = collected_run(tmp_path / "run", outcome, measured)
    row = summarise(folder)
    assert (row.problem, row.profile, row.cell, row.sessions) == ("", "two", "none", 1)
    assert row.last_session == (outcome or "no end")
    assert (row.stops_planned, row.stops_measured, row.stops_left) == (4, measured, 4 - measured)
    assert (row.interrupted, row.resumable) == (interrupted, interrupted)
    assert row.size_bytes == sum(map(len, files(folder).values()))
    assert words in [cell for line in runs_tables(list_runs(tmp_path))[0].text_rows() for cell in line]
    offer = resumable(tmp_path)
    assert (None if offer is None else offer.run) == (str(folder) if interrupted else None)
    said = "\n".join(runs_sentences(list_runs(tmp_path)))
    assert (f"cellapp collect {folder} --resume' continues it" in said) == interrupted


def test_a_run_that_a_job_uses_is_not_offered_and_not_disturbed(tmp_path: Path) -> None:
    control = JobControl()
    with planned_run(tmp_path / "run") as run, taking_requests(run.folder, control):
        run.begin_session()
        for stop in range(3):
            add_stop(run, stop)
            row = summarise(run.folder)
            assert (row.stops_measured, row.in_use, row.resumable) == (stop + 1, "a job that runs now", False)
            assert "3/4" not in runs_tables(list_runs(tmp_path))[0].text_rows()[0] or stop == 2
        assert resumable(tmp_path) is None
        assert control.request == "none"
    assert summarise(tmp_path / "run").in_use == ""
    assert resumable(tmp_path) is not None
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["run.sqlite"]


def test_jobs_elsewhere_gone_and_silent_ones(tmp_path: Path) -> None:
    folder = collected_run(tmp_path / "run", None)
    job = folder / JOB_FILE
    job.write_text(json.dumps({"computer": "other", "port": 1, "token": "x"}))
    assert summarise(folder).in_use == "a job on computer 'other', if it still runs"
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        here = os.uname().nodename if hasattr(os, "uname") else socket.gethostname()
        job.write_text(json.dumps({"computer": here, "port": port, "token": "x"}))
        assert summarise(folder).in_use == "a job that does not answer"
    assert summarise(folder).in_use == ""
    job.write_text("not json")
    assert summarise(folder).resumable


@pytest.mark.parametrize(("spoil", "says"), SPOILED)
def test_a_run_that_cannot_be_read_is_a_row_with_its_sentence(
    tmp_path: Path, spoil: Callable[[Path], None], says: str
) -> None:
    collected_run(tmp_path / "sound", "complete", 4)
    with planned_run(tmp_path / "broken", 200) as run:
        for _ in range(200):
            run.log("info", "x" * 200)
    spoil(tmp_path / "broken" / "run.sqlite")
    before = files(tmp_path)
    result = list_runs(tmp_path)
    rows = {Path(run.run).name: run for run in result.runs}
    assert rows["sound"].problem == ""
    problem = rows["broken"].problem
    # without a check of every page the damage shows where something is read, with SQLite's word for it
    assert re.search(says, problem) or ("damaged" in says and "restore" in problem), problem
    assert str(tmp_path / "broken") in problem
    assert problem in runs_sentences(result)
    assert {row[:2] for row in runs_tables(result)[0].text_rows()} == {("sound", "no arms"), ("broken", "unreadable")}
    assert files(tmp_path) == before


def test_a_locked_run_is_a_row_at_once(tmp_path: Path) -> None:
    folder = collected_run(tmp_path / "run", "complete", 4)
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite", isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode=EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        began = time.monotonic()
        problem = summarise(folder).problem
        assert time.monotonic() - began < NEVER_WAITS_S
        other.execute("ROLLBACK")
    assert "locked" in problem
    assert "no other program holds the file" in problem


@pytest.mark.parametrize(
    "statement",
    [
        "INSERT INTO stage VALUES (1, 'calibrate', 'now', 'x', '{}', '{}', NULL)",
        "INSERT INTO stage VALUES (1, 'calibrate', 'now', 'x', 'text', 'text', 'text')",
        "INSERT INTO session VALUES (9, 'now', 'now', 'as never before', '', '')",
        "INSERT INTO reading (arm, configuration, time_s, q, split) VALUES ('nobody', x'00', 'x', 'y', 7)",
        "UPDATE meta SET value = x'ff' WHERE key = 'created'",
        "DROP TABLE reading",
        "INSERT INTO stage VALUES (1, CAST(x'ff' AS TEXT), 'now', 'x', NULL, 'x', 'x')",
    ],
)
def test_strange_content_is_a_row_too(tmp_path: Path, statement: str) -> None:
    folder = collected_run(tmp_path / "run", "complete", 4)
    with contextlib.suppress(sqlite3.IntegrityError):
        alter_file(folder, statement)
    (row,) = list_runs(tmp_path).runs
    assert row.run == str(folder)
    assert "\n" not in row.problem
    assert RunsResult.from_json(list_runs(tmp_path).to_json(), "list").runs == (row,)


# -- Comparing two runs: what differs and by how many standard uncertainties; what cannot be compared is said ----------


def compared(a: Path, b: Path) -> RunComparison:
    with RunFile.open(a) as first, RunFile.open(b) as second:
        result = compare_runs(first, second)
    assert RunComparison.from_json(result.to_json(), "comparison") == result
    return result


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same cell, measured twice."""
    folder = tmp_path_factory.mktemp("compared")
    return measured_run(folder / "a", 1), measured_run(folder / "b", 2)


def geometry(values: tuple[ValueComparison, ...]) -> dict[str, ValueComparison]:
    return {value.name: value for value in values if value.of == GEOMETRY}


def test_two_calibrations_of_one_cell_differ_as_their_standard_errors_say(two_runs: tuple[Path, Path]) -> None:
    result = compared(*two_runs)
    assert [(entry.key, entry.a, entry.b) for entry in result.profile] == [("seed", "1", "2")]
    assert list(result.arms) == ["left", "right"]
    z = np.array([one.z for values in result.arms.values() for one in values if one.z is not None])
    assert len(z) > 40
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    assert {value.name for value in result.pair if value.of == TRANSFORM} >= {"x", "y", "z"}
    assert [note.partition(" ")[2] for note in result.notes] == ["was not searched for missing effects"] * 2


def test_a_base_that_moved_is_flagged(two_runs: tuple[Path, Path], tmp_path: Path) -> None:
    moved = measured_run(tmp_path / "moved", 3, Truth((("x0", 2e-3),)))
    result = compared(two_runs[0], moved)
    values = geometry(result.arms["left"])
    assert values["x0"].differs
    assert values["x0"].difference == pytest.approx(2e-3, abs=2e-4)
    assert not geometry(result.arms["right"])["x0"].differs
    said = "\n".join(comparison_sentences(result))
    assert "arm left: " in said
    assert "x0" in said
    back = geometry(compared(moved, two_runs[0]).arms["left"])
    assert back["x0"].difference == -values["x0"].difference  # type: ignore[operator]


def test_every_value_is_in_the_tables(two_runs: tuple[Path, Path]) -> None:
    result = compared(*two_runs)
    tables = {table.title: table for table in comparison_tables(result)}
    assert tables["Profile: what differs"].text_rows() == (("seed", "1", "2"),)
    assert [row[1] for row in tables["Arm left"].text_rows()] == [value.name for value in result.arms["left"]]
    assert len(tables["Pair"].rows) == len(result.pair)


def test_effects_in_one_run_only_and_in_both(finished_run: Path, finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        found = sure(read_results(run).discover)
        (backlash, *rest) = found.arms["right"].accepted
        changed = {
            name: value.model_copy(update={"value": 1.5 * value.value}) for name, value in backlash.parameters.items()
        }
        right = found.arms["right"].model_copy(
            update={"accepted": (backlash.model_copy(update={"parameters": changed}), *rest)}
        )
        left = found.arms["left"].model_copy(update={"accepted": ()})
        store(run, found.model_copy(update={"arms": {"left": left, "right": right}}))
    result = compared(finished_run, finished_copy)
    twins = [value for value in result.arms["right"] if value.of.startswith(f"{backlash.title} (")]
    assert twins
    for value in twins:
        assert value.difference == pytest.approx(0.5 * sure(value.a))
    said = "\n".join(comparison_sentences(result))
    assert "is in a only" in said
    assert f"{backlash.title} (" in said
    assert f"{finished_copy}: out of date: " in said
    assert "is in b only" in "\n".join(comparison_sentences(compared(finished_copy, finished_run)))


def store(run: RunFile, result: DiscoverResult) -> None:
    """Append a discovery that the product did not make; nothing rests on its model here."""
    append_stage(run, DISCOVER, result, basis_of(run))


def test_runs_without_results_are_compared_by_their_profiles(tmp_path: Path) -> None:
    planned_run(tmp_path / "a").close()
    planned_run(tmp_path / "b").close()
    result = compared(tmp_path / "a", tmp_path / "b")
    assert result.profile == ()
    assert result.pair == ()
    assert result.arms == {"left": (), "right": ()}
    assert comparison_tables(result) == []
    assert f"{tmp_path / 'b'} is not calibrated" in result.notes
    assert "the profiles are the same" in comparison_sentences(result)


def test_other_arms_and_other_types_are_sentences(two_runs: tuple[Path, Path], tmp_path: Path) -> None:
    profile = without_devices("left", "right")
    swapped = profile.model_copy(
        update={"arms": {"left": profile.arms["right"], "third": profile.arms["left"]}, "name": "other"}
    )
    other = measured_run(tmp_path / "other", 4, profile=swapped)
    result = compared(two_runs[0], other)
    assert list(result.arms) == ["left"]
    assert not geometry(result.arms["left"])
    said = "\n".join(result.notes)
    assert f"arm 'right' is in {two_runs[0]} only; the arms of {other} are left, third" in said
    assert f"arm 'third' is in {other} only" in said
    assert "arm 'left' is of type UR10" in said
    keys = {entry.key: entry for entry in result.profile}
    assert keys["name"].b == '"other"'
    assert keys["arms.left.type.model"].a == '"UR10"'
    assert any(key.startswith("arms.third.") and entry.a is None for key, entry in keys.items())


# -- One arm over its runs: what moved is named with its size, what did not is not; who the arm is ---------------------

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


def test_a_name_that_stands_for_two_arms_is_refused_and_serial_numbers_keep_them_apart(
    worn: Path, tmp_path: Path
) -> None:
    shutil.copytree(worn / "m0", tmp_path / "m0")
    measured_run(tmp_path / "other", 9, profile=cell(9, serials=("UR10-78", "UR5-12")))
    with pytest.raises(InputError, match=r"'left' is not one arm in all runs.*'UR10-77', 'UR10-78'"):
        arm_history("left", tmp_path)
    assert [Path(run.run).name for run in arm_history("UR10-78", tmp_path).runs] == ["other"]
    assert len(arm_history("right", tmp_path).runs) == 2
    with pytest.raises(InputError, match=r"no arm 'middle'.*'UR10-77', 'UR10-78', 'UR5-12'"):
        arm_history("middle", tmp_path)
    with RunFile.open(tmp_path / "m0") as a, RunFile.open(tmp_path / "other") as b:
        result = compare_runs(a, b)
    said = f"arm 'left' has the serial number UR10-77 in {tmp_path / 'm0'} and UR10-78 in {tmp_path / 'other'}"
    assert any(note.startswith(said) for note in result.notes)
    assert not geometry(result.arms["left"])
    assert geometry(result.arms["right"])


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
    rotated = replace(first, model=replace(first.model, geometry=first.model.geometry.with_vector(vector)))
    assert all(abs(one.difference) < 1e-12 for one in differences(first, rotated))


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


def identities(folder: Path, profile: Profile, serials: dict[str, str]) -> dict[str, StoredIdentity]:
    with planned_run(folder, profile=profile) as run:
        if serials:
            recorded = {name: ArmIdentity("UR10", serial, "5.1") for name, serial in serials.items()}
            run.write_document(CONTROLLERS_RESULT, json.dumps({name: vars(one) for name, one in recorded.items()}))
        return dict(arm_identities(run))


def test_an_arm_is_known_by_its_controller_then_by_the_profile_then_by_names(tmp_path: Path) -> None:
    profile = two_arms()
    given = profile.model_copy(
        update={
            "traceability": Traceability(arms={"left": TraceableArm(serial="P-1"), "right": TraceableArm(serial="P-2")})
        }
    )
    bare = identities(tmp_path / "bare", profile, {})
    assert bare["left"] == StoredIdentity("two, left (left)", "names")
    by_profile = identities(tmp_path / "profile", given, {"right": ""})
    assert [one.key for one in by_profile.values()] == ["P-1", "P-2"]
    by_controller = identities(tmp_path / "controller", given, {"left": "C-1"})
    assert by_controller["left"] == StoredIdentity("C-1", "controller", "C-1")
    assert by_controller["right"].known_by == "profile"
    assert by_controller["right"].is_other_than(StoredIdentity("P-3", "profile", "P-3"))
    assert not by_controller["right"].is_other_than(by_controller["left"]), "numbers of different things"
    assert not bare["left"].is_other_than(bare["right"])


def test_a_damaged_record_of_controllers_leaves_the_names(tmp_path: Path) -> None:
    with planned_run(tmp_path / "run") as run:
        run.write_document(CONTROLLERS_RESULT, "[]")
        assert arm_identities(run)["left"].known_by == "names"


def test_simulated_arms_have_no_serial_number_of_their_own(tmp_path: Path) -> None:
    profile = small_twin()
    with RunFile.create(tmp_path / "run", profile) as run:
        recorded = {name: vars(ArmIdentity("simulated", f"SIM-{name}", "")) for name in profile.arms}
        run.write_document(CONTROLLERS_RESULT, json.dumps(recorded))
        assert {one.known_by for one in arm_identities(run).values()} == {"names"}
