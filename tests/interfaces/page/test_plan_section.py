"""The page's section on a plan: maps, joints and time of every plan, more of a designed one, nothing without a plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.planning.planned_stops import (
    PLAN_DESIGN_RESULT,
    read_plan_design,
    read_planned_stops,
    write_planned_stops,
)
from cellapp.cell.run import RunFile
from cellapp.commands.plan.check_view import design_tables
from cellapp.commands.plan.result import StopsResult
from cellapp.commands.plan.run import new_planned_run, plan_result, stored_plan
from cellapp.commands.plan.view import plan_section
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section
from cellapp.ground.errors import InputError
from tests.interfaces.page.plan_cases import plan_design
from tests.twin import small_twin


def charts_of(section: Section) -> list[Chart]:
    return [part for part in section.parts if isinstance(part, Chart)]


def test_every_plan_is_drawn_and_a_designed_one_says_more(tmp_path: Path) -> None:
    with new_planned_run(small_twin(12, plan={"method": "random"}), tmp_path / "run") as run:
        plain = plan_section(run)
        assert plain is not None
        assert [chart.title for chart in charts_of(plain)] == [
            "The cell from above",
            "The cell as the tracker sees it",
            "Time of the plan",
            "Arm left: joint ranges",
            "Arm right: joint ranges",
        ]
        assert charts_of(plain)[2].message.startswith("Collecting takes about")
        write_planned_stops(run, read_planned_stops(run), design=plan_design(12))
        designed = plan_section(run)
        assert designed is not None
        assert len(charts_of(designed)) == len(charts_of(plain)) + 3
        assert "The order of the stops saves 40 %" in charts_of(designed)[4].message


def test_imported_readings_have_no_plan(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", small_twin()) as run:
        assert plan_section(run) is None


# -- What is printed of a designed plan, after planning and from the run -----------------------------------------------


def test_tables_state_candidates_errors_gaps_and_errors_by_stops() -> None:
    tables = {table.title: table for table in design_tables(plan_design())}
    assert list(tables) == [
        "Candidates",
        "Expected errors against random stops",
        "Observability",
        "Largest gap of each joint",
        "Arm left: errors after the first stops",
        "Arm right: errors after the first stops",
    ]
    candidates = tables["Candidates"]
    assert candidates.headings == ("configurations", "arm left", "arm right")
    assert candidates.text_rows()[0] == ("drawn", "600000", "600000")
    assert candidates.text_rows()[2] == ("excluded by collides", "180000", "180000")
    assert candidates.text_rows()[-1] == ("candidates", "20000", "20000")
    assert tables["Observability"].text_rows()[0] == ("left", "designed", "0.4", "0.02", "0.3", "0.006", "0.05")
    errors = tables["Expected errors against random stops"].text_rows()
    assert errors[0] == ("left", "designed", "400", "0.700", "0.0070", "0.0210")
    assert errors[2] == ("left", "equal to random", "", "840 stops", "640 stops", "1280 stops")
    assert tables["Largest gap of each joint"].text_rows()[0][:2] == ("left", "11.5")


def test_a_design_is_stored_with_its_plan_and_shown_from_the_run(tmp_path: Path) -> None:
    with new_planned_run(small_twin(3, plan={"method": "random"}), tmp_path / "run") as run:
        assert stored_plan(run).design is None
        write_planned_stops(run, read_planned_stops(run), design=plan_design(8))
        stops = stored_plan(run)
        assert stops.design == plan_result(run).design == plan_design(8)
        assert StopsResult.from_json(stops.to_json(), "stops") == stops
        write_planned_stops(run, read_planned_stops(run))
        assert read_plan_design(run) == plan_design(8)


def test_a_damaged_design_is_named(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", small_twin(3)) as run:
        run.write_result(PLAN_DESIGN_RESULT, '{"schema": "cellapp-plan-design"}')
        with pytest.raises(InputError, match="plan_design"):
            read_plan_design(run)
