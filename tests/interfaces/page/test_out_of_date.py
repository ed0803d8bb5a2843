"""Results that no longer hold: listed first with their reason, and never presented as those of the present model."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.report.result import read_results
from cellapp.commands.report.view import all_tables, out_of_date_sentences
from cellapp.commands.stages import CALIBRATION_FILE, NOT_RECORDED
from cellapp.estimation.discovery.records import DiscoverResult, with_effects
from cellapp.ground.results import CALIBRATE, DISCOVER, VERIFY
from tests.interfaces.page.cases import discovery, unknown_effect
from tests.interfaces.page.parsed_page import Page, page_of
from tests.interfaces.page.runs import LEFT, RIGHT, fill, store_discovery


@pytest.fixture
def changing(whole_folder: Path, tmp_path: Path) -> Iterator[RunFile]:
    """A copy of the run with every result."""
    shutil.copytree(whole_folder, tmp_path / "run")
    with RunFile.open(tmp_path / "run", write=True) as run:
        yield run


def add_readings(run: RunFile, count: int) -> None:
    """Measure some stops again, later."""
    for name in run.arms():
        readings = run.readings(name)
        again = readings.take(np.arange(count))
        shifted = {"configuration": again.configuration + len(readings), "time_s": again.time_s + 1e4}
        run.add_readings(name, type(again)(**{**vars(again), **shifted}))


def assert_no_verification(page: Page) -> None:
    assert "verified targets" not in page.text
    assert "Targets: measured distance from where they should be [mm]" not in page.texts


def test_a_verification_of_an_earlier_model_is_not_presented_as_holding(changing: RunFile, whole_page: Page) -> None:
    assert "2 verified targets" in whole_page.text
    store_discovery(changing, discovery(LEFT, RIGHT))
    page = page_of(changing)
    assert_no_verification(page)
    (line,) = (text for text in page.texts if text.startswith("Verification at new targets: "))
    assert "the run was searched for missing effects again since, with another outcome" in line
    assert f"Next step: cellapp push {changing.folder} TARGETS --verify" in page.words


def test_added_readings_outdate_everything_until_it_is_repeated(changing: RunFile) -> None:
    add_readings(changing, 5)
    page = page_of(changing)
    assert_no_verification(page)
    for title in ("Calibration", "Missing effects", "Verification at new targets"):
        assert f"{title}: 10 readings were added since" in page.text
    assert "discovery-1" not in page.values("id")
    assert "no effects: the search is out of date" in page.text
    assert "effects, position" not in page.texts

    calibrate_run(changing)
    page = page_of(changing)
    assert "Calibration: " not in page.text
    assert f"Arm {LEFT}" in page.texts
    assert "discovery-1" not in page.values("id")
    assert "the run was calibrated again since, with another outcome" in page.text

    store_discovery(changing, discovery(LEFT, RIGHT))
    page = page_of(changing)
    assert "discovery-1" in page.values("id")
    assert "effects, position" in page.texts
    assert_no_verification(page)


def test_a_result_of_an_older_version_is_not_shown(single: RunFile) -> None:
    single.write_result(DISCOVER, json.dumps({"schema": "cellapp-discover", "version": 1, "arms": {"only": {}}}))
    page = page_of(single)
    (line,) = (text for text in page.texts if text.startswith("Missing effects: "))
    assert "version of cellapp stored it" in line
    assert f"Next step: cellapp discover {single.folder}" in page.words


def test_effects_that_an_older_version_wrote_into_the_calibration_are_not_shown(
    single: RunFile, tmp_path: Path
) -> None:
    result = read_results(single).calibrate
    assert result is not None
    both = with_effects(result, DiscoverResult(arms={"only": unknown_effect("only")}))
    with RunFile.create(tmp_path / "old", single.profile) as old:
        fill(old)
        old.assign_splits("only", list(single.readings("only").split or ()))
        old.write_result(CALIBRATE, both.to_json())
        shutil.copy(single.folder / CALIBRATION_FILE, old.folder)
        page = page_of(old)
    assert "geometry, position" in page.texts
    assert "effects, position" not in page.texts
    assert f"Calibration: {NOT_RECORDED}" in page.text


def test_terminal_tables_leave_out_what_does_not_hold(changing: RunFile) -> None:
    titles = {table.title for table in all_tables(read_results(changing))}
    assert out_of_date_sentences(read_results(changing)) == []
    store_discovery(changing, discovery(LEFT, RIGHT))
    results = read_results(changing)
    left = {table.title for table in all_tables(results)}
    assert "Targets: measured distance from where they should be [mm]" in titles - left
    assert [line for line in out_of_date_sentences(results) if VERIFY in line]
