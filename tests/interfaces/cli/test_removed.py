"""What earlier versions had is answered by what to do instead; what they stored opens."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest
import yaml

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, import_csv
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.export.run import export_run
from cellapp.commands.runs.history import summarise
from cellapp.commands.show.overview import run_history, run_overview
from cellapp.commands.show.view import overview_sentences, overview_tables
from cellapp.commands.stages import append_stage, basis_of
from cellapp.estimation.readings import Reading
from cellapp.ground import removed
from cellapp.ground.errors import InputError
from cellapp.interfaces.tui.workspace import load_workspace
from tests.interfaces.page.cases import calibration
from tests.program import app
from tests.twin import PROFILES, small_twin

KEYS = {"arms.*.teleport": "drive it", "magic": "nothing takes its place"}


@pytest.fixture
def some_removed(monkeypatch):
    monkeypatch.setattr(
        removed,
        "COMMANDS",
        {"dance": "use 'cellapp run'", "trials dance": "use 'cellapp run'", "iso9283 dance": "use 'cellapp run'"},
    )
    monkeypatch.setattr(removed, "PROFILE_KEYS", KEYS)


@pytest.mark.parametrize("command", ["dance", "trials dance", "iso9283 dance"])
def test_a_removed_command_says_what_to_do_instead(some_removed, command):
    with pytest.raises(InputError, match=rf"^'cellapp {command}' was removed in [\d.]+: use 'cellapp run'$") as error:
        app([*command.split(), "--option"], prog_name="cellapp", standalone_mode=False)
    assert error.value.exit_code == 2


def test_every_removed_command_says_something_else_that_is_there():
    for name, instead in removed.COMMANDS.items():
        assert instead.strip().rstrip(".") == instead, name


def test_a_removed_key_of_a_users_profile_is_refused_by_name(some_removed, tmp_path):
    content = yaml.safe_load((PROFILES / "twin.yaml").read_text("utf-8"))
    content["magic"] = 1
    for arm in content["arms"].values():
        arm["type"] = str(PROFILES / arm["type"])
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(content), "utf-8")
    with pytest.raises(InputError, match=r"cell\.yaml:\d+: magic: was removed in [\d.]+: nothing takes its place"):
        load_profile(path)


def test_a_run_of_an_earlier_version_opens_and_says_what_is_ignored(some_removed, tmp_path):
    profile = load_profile(PROFILES / "twin.yaml")
    with RunFile.create(tmp_path / "run", profile) as run:
        path = run.path
        run.append_stage("dance", None, "{}", None)
    with closing(sqlite3.connect(path)) as connection, connection:
        ((text,),) = connection.execute("SELECT value FROM meta WHERE key = 'profile'")
        content = json.loads(text)
        content["magic"] = 1
        content["arms"]["left"]["teleport"] = {"far": True}
        connection.execute("UPDATE meta SET value = ? WHERE key = 'profile'", (json.dumps(content),))
    with RunFile.open(path.parent) as run:
        assert run.profile == profile
        state, history = run_overview(run), run_history(run)
    assert set(state.ignored_keys) == {
        "magic",
        "arms.left.teleport",
    }
    assert [one.out_of_date for one in (*state.stages, *history.stages)] == [
        "an earlier version made it; this one has no such step"
    ] * 2
    assert any("arms.left.teleport" in sentence for sentence in overview_sentences(state))
    assert any("dance" in str(table) for table in overview_tables(state))


def old_rows(path, columns, rows):
    """Add rows of a kind that no version stores any more; they are of the left arm, at three stops."""
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executemany(
            f"INSERT INTO reading (arm, configuration, q, approach, {columns}) VALUES ('left', ?, ?, ?, ?, ?)",
            [(stop, json.dumps([0.1 * stop] * 6), "[0, 0, 0, 0, 0, 0]", *row) for stop in range(3) for row in rows],
        )


@pytest.mark.parametrize(
    ("rows", "columns", "what", "last"),
    [
        ([("[null, null, null]", "cup")], "p_m, point", "a ball in sockets", ",,,,cup"),
        ([("[3.0, 0.1, 0.2]", "A"), ("[3.0, 0.2, 0.2]", "B")], "p_m, smr", "several SMRs at a stop", "3.0,0.1,0.2,A"),
    ],
)
def test_a_run_of_removed_readings_opens_for_show_and_export_and_calibrate_says_why_not(
    tmp_path, rows, columns, what, last
):
    profile = load_profile(PROFILES / "twin.yaml")
    with RunFile.create(tmp_path / "run", profile) as run:
        path = run.path
        run.add_stop(0, {"right": Reading(q=np.zeros(6), p_M=np.array([3.0, 0.5, 0.1]))})
    old_rows(path, columns, rows)
    with RunFile.open(path.parent, write=True) as run:
        state = run_overview(run)
        assert (state.arms["left"].measured, state.next_step) == (3, "")
        assert state.complaints[0].startswith(f"arm 'left': readings of {what} were removed in ")
        exported = export_run(run, tmp_path / "out.csv", None)
        assert exported.readings == {"left": 3, "right": 1}
        assert (tmp_path / "out.csv").read_text("utf-8").splitlines()[1].endswith(last)
        with pytest.raises(InputError, match=rf"arm 'left': readings of {what}.*'cellapp show'"):
            calibrate_run(run)
        append_stage(run, "calibrate", calibration("left", "right"), basis_of(run))
        (stage,) = run_overview(run).stages
        assert stage.out_of_date == "an earlier version made it, from readings of a kind that was removed"
    opened = load_workspace(None, path.parent)
    assert (opened.problem, opened.folder, opened.conformity) == ("", path.parent, "cannot say")
    assert summarise(path.parent).problem == ""


def test_an_import_of_what_was_exported_of_sockets_is_refused(tmp_path):
    (tmp_path / "out.csv").write_text("configuration,arm,q1,x_m,y_m,z_m,point\n0,left,0.1,,,,cup\n", "utf-8")
    with pytest.raises(InputError, match=r"out\.csv:1: point: readings of a ball in sockets were removed"):
        import_csv(small_twin(), tmp_path / "out.csv", tmp_path / "again")
