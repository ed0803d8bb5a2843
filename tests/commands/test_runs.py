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

import pytest

from cellapp.cell.driving.requests import taking_requests
from cellapp.cell.run import RunFile, SessionEnd
from cellapp.commands.runs.history import list_runs, summarise
from cellapp.commands.runs.result import RunsResult, RunSummary
from cellapp.commands.runs.view import runs_sentences, runs_tables
from cellapp.commands.show.overview import run_overview
from cellapp.ground.asking import JOB_FILE
from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from tests.cell.run.small_runs import add_stop, collected_run, planned_run, set_began
from tests.cell.run.spoiled import SPOILED

NEVER_WAITS_S = 5.0
"""Half of the time that a write waits for another program's lock."""


def resumable(folder: Path | None = None) -> RunSummary | None:
    """The newest run that can be resumed."""
    return next((run for run in list_runs(folder).runs if run.resumable), None)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def names(result: RunsResult) -> list[str]:
    return [Path(run.run).name for run in result.runs]


@pytest.mark.fast
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


@pytest.mark.fast
def test_a_folder_without_runs_and_none_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert list_runs().runs == ()
    assert "no runs below logs" in runs_sentences(list_runs())[0]
    assert runs_tables(list_runs()) == []
    assert resumable() is None
    (tmp_path / "file").write_text("x")
    for path, says in (("nowhere", "folder not found"), ("file", "is not a folder")):
        with pytest.raises(InputError, match=f"{path}.*{says}"):
            list_runs(Path(path))


@pytest.mark.fast
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


@pytest.mark.fast
def test_a_plan_alone_was_not_interrupted(tmp_path: Path) -> None:
    planned_run(tmp_path / "run").close()
    row = summarise(tmp_path / "run")
    assert (row.sessions, row.last_session, row.interrupted, row.next_verb) == (0, None, False, "collect")


@pytest.mark.fast
def test_the_newest_interrupted_run_is_offered(tmp_path: Path) -> None:
    for minute, (name, outcome) in enumerate((("old", "stopped"), ("newer", None), ("newest", "complete"))):
        collected_run(tmp_path / name, outcome, 4 if outcome == "complete" else 1)  # type: ignore[arg-type]
        set_began(tmp_path / name, minute)
    offer = resumable(tmp_path)
    assert offer is not None
    assert Path(offer.run).name == "newer"


@pytest.mark.fast
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


@pytest.mark.fast
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


@pytest.mark.fast
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
    assert len(runs_tables(result)[0].rows) == 1
    assert files(tmp_path) == before


@pytest.mark.fast
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


@pytest.mark.fast
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
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection:
        with contextlib.suppress(sqlite3.IntegrityError):
            connection.execute(statement)
        connection.commit()
    (row,) = list_runs(tmp_path).runs
    assert row.run == str(folder)
    assert "\n" not in row.problem
    assert RunsResult.from_json(list_runs(tmp_path).to_json(), "list").runs == (row,)


def test_a_finished_run_has_its_figures(finished_run: Path) -> None:
    row = summarise(finished_run)
    assert row.cell == "simulated"
    assert [stage.name for stage in row.stages] == ["calibrate", "discover", "compensate", "verify"]
    assert (row.next_verb, row.next_step) == ("report", f"cellapp report {finished_run}")
    for name, effect in (("left", "joint_compliance"), ("right", "backlash")):
        figures = row.figures[name]
        assert figures.best_stage == "effects"
        assert effect in figures.effects
        assert figures.heldout_mm is not None
        assert figures.heldout_mm.after < figures.heldout_mm.before
    verified = row.figures["left"].verified_mm
    assert verified is not None
    assert verified.after < verified.before
    text = str([table.text_rows() for table in runs_tables(list_runs(finished_run))])
    assert "joint compliance" in text


def test_the_list_says_what_the_overview_says(finished_copy: Path) -> None:
    def both() -> list[tuple[dict[str, str | None], str, dict[str, int]]]:
        row = summarise(finished_copy)
        with RunFile.open(finished_copy) as run:
            shown = run_overview(run)
        return [
            (
                {stage.name: stage.out_of_date for stage in state.stages},
                state.next_step,
                {name: arm.measured for name, arm in state.arms.items()},
            )
            for state in (row, shown)
        ]

    listed, shown = both()
    assert listed == shown
    with RunFile.open(finished_copy, write=True) as run:
        left = run.readings("left")
        rows = {name: run.readings(name).take([0]) for name in run.profile.arms}
        for name, row in rows.items():
            run.add_readings(name, replace(row, configuration=row.configuration + 999))
    listed, shown = both()
    assert listed == shown
    assert listed[0]["calibrate"] == "2 readings were added since"
    assert listed[2]["left"] == len(left) + 1
    figures = summarise(finished_copy).figures["left"]
    assert figures.best_stage != "effects", "the stage of a discovery that no longer holds is not a headline"


def test_other_versions_of_results_are_said_to_be_unreadable(finished_copy: Path) -> None:
    with contextlib.closing(sqlite3.connect(finished_copy / "run.sqlite")) as connection:
        connection.execute("UPDATE stage SET text = '{\"arms\": 3}' WHERE name = 'discover'")
        connection.commit()
    row = summarise(finished_copy)
    assert row.problem == ""
    assert {stage.name: bool(stage.out_of_date) for stage in row.stages}["discover"]
    assert row.figures["left"].verdict is None


def test_a_run_of_an_older_schema(tmp_path: Path) -> None:
    old = Path(__file__).parents[1] / "fixtures" / "run-schema-2"
    folder = Path(shutil.copytree(old, tmp_path / "old"))
    row = summarise(folder)
    assert row.problem == ""
    assert row.figures
    assert all(stage.out_of_date for stage in row.stages)
