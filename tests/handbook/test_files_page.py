"""The chapter on files says what the code reads and writes: columns, tables, keys; its examples are read."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cellapp.cell.exports.formats import all_formats
from cellapp.cell.profile import load_profile
from cellapp.cell.run.sqlite_file import SCHEMA_VERSION, create_tables
from cellapp.commands.docs.handbook import chapter_text, topic_text
from cellapp.commands.init.answers import write_answers
from cellapp.commands.registry import records
from cellapp.commands.schema import written_results
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import Profile
from cellapp.ground.results import STAGE_NAMES
from cellapp.robot.model import CellModel
from tests.handbook.declarations import results_part
from tests.twin import PROFILES


def block(section: str, language: str) -> str:
    """The first example in a language of a section."""
    found = re.search(rf"^#+ {re.escape(section)}\n.*?```{language}[^\n]*\n(.*?)```", topic_text("files"), re.M | re.S)
    assert found is not None, section
    return found[1]


def rows(section: str) -> dict[str, str]:
    """First cell -> the rest, of the tables of a section."""
    text = re.search(rf"^#+ {re.escape(section)}\n(.*?)(?=^#+ |\Z)", topic_text("files"), re.M | re.S)
    assert text is not None, section
    return dict(re.findall(r"^\| (.+?) \| (.+) \|$", text[1], re.M))


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    shutil.copytree(PROFILES / "arms", tmp_path / "arms")
    (tmp_path / "my-cell.yaml").write_text(block("Profile", "yaml"), "utf-8")
    return tmp_path / "my-cell.yaml"


def test_the_least_profile_is_a_profile_and_every_section_is_listed(profile: Path) -> None:
    assert list(load_profile(profile).arms) == ["left"]
    listed = set(re.findall(r"`(\w+)(?:\.NAME)?`", " ".join(rows("Profile"))))
    assert listed == {field.alias or name for name, field in Profile.model_fields.items()} - {
        "schema",
        "version",
        "name",
        "seed",
    }


def test_every_column_of_readings_is_described_with_its_unit() -> None:
    described = rows("Readings")
    for column in COLUMNS:
        names = column.csv_names(9) if column.shape != "joints" else (f"{column.csv[0]}1",)
        row = next(cells for first, cells in described.items() if names[0] in re.split(r"[`, ]+", first))
        assert row.startswith(column.unit.replace("^2", "²") or "|"), (column.name, row)
        assert ("**required**" in row) == column.required


def test_answers_without_a_tracker_are_refused_in_a_sentence(tmp_path: Path) -> None:
    answers = tmp_path / "answers.yaml"
    answers.write_text(block("Answers", "yaml").partition("tracker:\n")[0], "utf-8")
    with pytest.raises(InputError, match=r"tracker\.pose: missing"):
        write_answers(answers, tmp_path / "other")


def test_the_tables_of_a_run_file_are_those_that_are_made() -> None:
    described = rows("run.sqlite")
    assert f"(schema {SCHEMA_VERSION})" in chapter_text("files")
    with closing(sqlite3.connect(":memory:")) as connection:
        create_tables(connection)
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        assert {f"`{name}`" for name in tables} == set(described) - {"table", "---"}
        for table in tables:
            columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
            words = re.findall(r"`(\w+)`", described[f"`{table}`"])
            assert set(columns) <= set(words), table
    listed = re.search(r"names in `stage` are ([^.]+)\.", chapter_text("files"))
    assert listed is not None
    assert tuple(listed[1].replace("\n", " ").split(", ")) == STAGE_NAMES


def test_every_format_and_every_result_is_listed() -> None:
    listed = set(re.findall(r"`([\w-]+)`", " ".join(rows("Exports"))))
    assert listed == set(all_formats())
    assert results_part() in chapter_text("files"), "renew them: python -m tests.handbook"
    assert len(rows("Results as JSON")) == len(written_results(records())) + 2


def test_the_model_file_has_the_keys_that_are_listed() -> None:
    twin = load_profile(PROFILES / "twin.yaml")
    model = json.loads(CellModel({"left": nominal_model(twin, "left")}).to_json())
    example = json.loads(block("calibration.json", "json"))
    assert set(example) - {"pair"} <= set(model)
    listed = {name for first in rows("calibration.json") for name in re.findall(r"`(\w+)`", first)}
    assert set(model["arms"]["left"]) == listed - {"key"}
    of_example, of_model = (one["arms"]["left"]["geometry"]["parameters"] for one in (example, model))
    assert set(of_example) <= set(of_model)
