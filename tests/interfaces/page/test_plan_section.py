"""The page's section on a plan: maps, joints and time of every plan, more of a designed one, nothing without a plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.planning.planned_stops import read_planned_stops, write_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.plan.view import plan_section
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section
from tests.interfaces.page.plan_cases import plan_design
from tests.twin import small_twin

pytestmark = pytest.mark.fast


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
