"""Targets that the product compensated and measured: in words, tables, charts and on the page."""

from __future__ import annotations

import math

from cellapp.cell.run import RunFile
from cellapp.commands.compensate.charts import target_charts
from cellapp.commands.compensate.details import stored_state, target_details
from cellapp.commands.compensate.tables import measured_tables, refusal_tables, uncertainty_tables
from cellapp.commands.compensate.target_list import target_list
from cellapp.commands.compensate.view import targets_section
from cellapp.commands.compensate.words import PART_WORDS, compensate_lines, verify_message
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.result import read_results
from cellapp.commands.view.charts import Chart
from tests.interfaces.page.runs import LEFT, RIGHT, TARGET, UNREACHABLE, targets_of


def test_what_the_product_stores_is_shown(whole: RunFile) -> None:
    results = read_results(whole)
    assert results.compensate is not None
    assert results.verify is not None
    lines = compensate_lines(results.compensate)
    assert lines[0] == "4 of 5 targets compensated, 1 refused"
    assert any(line.startswith(f"target {UNREACHABLE}: out of reach: the nearest pose is") for line in lines)
    assert any(line.startswith("95 % bound of the measured error: median") for line in lines)
    assert (
        refusal_tables(results.compensate)[0].rows[0][-1]
        == "move the target nearer to the arm, or leave its rotation free"
    )
    assert verify_message(results.verify).startswith("mean error ")
    assert [table.title for table in measured_tables(results.verify)][-1] == "Targets that were not measured"
    states = [row[3] for row in target_list(targets_of(LEFT, RIGHT), results).rows]
    assert states[:2] + states[3:] == ["measured"] * 4
    assert str(states[2]).startswith("out of reach")
    charts = target_charts(results.verify, {LEFT: 0.02, RIGHT: None})
    assert [chart.title for chart in charts][2:] == ["Stated bounds"]
    assert not any(chart.is_empty for chart in charts)


def test_the_parts_add_up_to_the_uncertainty(whole: RunFile) -> None:
    results = read_results(whole)
    assert results.compensate is not None
    for target in results.compensate.targets:
        if target.parts is not None and target.uncertainty_mm is not None:
            parts = [getattr(target.parts, part) for part in PART_WORDS]
            assert math.isclose(math.hypot(*parts), target.uncertainty_mm, rel_tol=1e-9)
    (table,) = uncertainty_tables(results.compensate)
    assert len(table.rows) == 4


def test_one_target_in_its_details(whole: RunFile) -> None:
    state = stored_state(read_results(whole), TARGET)
    assert state is not None
    details = target_details(state)
    text = "\n".join(details.sentences)
    assert "solutions within the joint limits" in text
    assert "mm with the nominal command" in text
    assert len(details.charts) == 1
    assert [row[0] for row in details.tables[0].rows][:3] == ["wanted", "predicted", "measured"]


def test_the_page_begins_with_the_message(whole: RunFile) -> None:
    data = read_report_data(whole)
    floors_mm = {name: arm.tracker_mm for name, arm in data.calibrate.arms.items()}
    section = targets_section(data.results.compensate, data.verify, floors_mm)
    assert section.message.startswith("Mean error ")
    assert sum(isinstance(part, Chart) for part in section.parts) == 5
