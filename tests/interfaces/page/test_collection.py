"""What is shown of collecting: in the terminal, with ``show``, and on the page; nothing for runs without sessions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.records import CollectedStop, CollectResult, ResidualRange
from cellapp.cell.run import Outcome, ReferenceRow, RunFile
from cellapp.cell.run.records import MissingReading
from cellapp.commands.collect.charts import stored_residual_chart
from cellapp.commands.collect.run import collect_stops
from cellapp.commands.collect.state import collection_state
from cellapp.commands.collect.view import (
    collect_lines,
    collection_tables,
    other_notes,
    residual_range_words,
    stored_view,
)
from cellapp.commands.plan.run import plan_new_run
from cellapp.commands.view.charts import Chart
from cellapp.interfaces.page.page import page_text
from cellapp.interfaces.render.chart import legend_of
from tests.cell.run.small_runs import add_stop, planned_run
from tests.interfaces.page.parsed_page import NOON
from tests.twin import small_twin

HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A collected run in which one reading is missing, a person paused, and references drifted."""
    folder = tmp_path_factory.mktemp("collected") / "run"
    plan_new_run(small_twin(20, plan={"method": "random"}), folder)
    with RunFile.open(folder, write=True) as run:
        run.add_stop(3, {}, [Outcome(3, "left", "not measured", HOSTILE), Outcome(3, "right", "left out", "forbidden")])
        collect_stops(run, resume=True)
        session = run.begin_session()
        run.record_request(session, "pause", "paused by a person")
        for number, x_mm in enumerate((0.0, 0.02, 0.05)):
            run.add_reference(
                ReferenceRow("nest A", 10 * number, 60.0 * number, np.array([x_mm * 1e-3, 0, 0]), session)
            )
    return folder


@pytest.fixture
def run(folder: Path) -> Iterator[RunFile]:
    with RunFile.open(folder) as opened:
        yield opened


def test_sessions_requests_missing_readings_drift_and_errors_are_tables(run: RunFile) -> None:
    state = collection_state(run)
    assert state is not None
    sessions, requests, drift, errors, doubtful = (
        table for table in collection_tables(state) if not table.title.startswith("Missing")
    )
    assert [row[3] for row in sessions.text_rows()] == ["complete", "the program died"]
    assert [row[2:] for row in requests.text_rows()] == [("pause", "paused by a person")]
    assert [row[1] for row in drift.text_rows()] == ["0.0000", "0.0200", "0.0500"]
    assert "limit 0.100 mm" in drift.title
    assert {row[0] for row in errors.text_rows()} == {"left", "right"}
    ratios = [float(row[4]) for row in doubtful.text_rows()]
    assert ratios == sorted(ratios, reverse=True)
    assert "10 of " in doubtful.title
    (chart,) = (part for part in stored_view(state).parts if isinstance(part, Chart))
    assert [(entry.look and entry.look.colour, entry.text) for entry in legend_of(chart)] == [
        ("arm1", "nest A"),
        ("ink", "limit"),
    ]
    assert "the limit is 0.100 mm" in chart.message


def test_every_tried_stop_has_its_residual_or_the_reason(run: RunFile) -> None:
    state = collection_state(run)
    assert state is not None
    rows = {(one.stop, one.arm): one for one in state.stops}
    assert len(rows) == len(state.stops)
    assert rows[3, "left"].residual_mm is not None
    assert [key for key, one in rows.items() if one.retried] == [(3, "left")]
    assert {(stop, "left") for stop in run.readings("left").configuration.tolist()} < set(rows)
    measured = [one for one in state.stops if one.arm == "left" and one.residual_mm is not None]
    assert state.residual_ranges["left"].before_mm == pytest.approx(
        np.percentile([one.residual_mm for one in measured if one.residual_mm is not None], 95)
    )
    assert state.residual_ranges["left"].after_mm is None
    assert "after" not in residual_range_words(state)
    assert "right up to " in residual_range_words(state)


def test_a_stop_without_a_reading_says_why_and_a_run_without_a_model_has_no_residuals(tmp_path: Path) -> None:
    with planned_run(tmp_path / "run") as run:
        run.begin_session()
        add_stop(run, 0)
        run.add_stop(
            1, {}, [Outcome(1, "left", "not measured", "no SMR"), Outcome(1, "right", "left out", "forbidden")]
        )
        state = collection_state(run)
    assert state is not None
    assert [(one.stop, one.arm, one.residual_mm, one.suspicion) for one in state.stops] == [
        (0, "left", None, ""),
        (0, "right", None, ""),
        (1, "left", None, "not measured: no SMR"),
        (1, "right", None, "left out: forbidden"),
    ]
    assert residual_range_words(state) == ""


def test_the_range_after_calibration_is_that_of_its_held_out_stops(run: RunFile) -> None:
    state = collection_state(run)
    assert state is not None
    ranges = {"left": ResidualRange(before_mm=0.3, after_mm=0.06), "right": ResidualRange()}
    words = residual_range_words(state.model_copy(update={"residual_ranges": ranges}))
    assert words == (
        "Normal range of a residual (95 %): left up to 0.300 mm before calibration (running model),"
        " up to 0.060 mm after it (held-out stops)."
    )


def test_the_chosen_stop_is_marked_in_the_chart_of_residuals() -> None:
    stops = [CollectedStop(stop=k, arm=arm, residual_mm=0.1 * k + 0.1) for k in range(3) for arm in ("left", "right")]
    stops.append(CollectedStop(stop=3, arm="left", suspicion="not measured: no SMR"))
    assert [one.name for one in stored_residual_chart(stops).series] == ["left", "right"]
    chart = stored_residual_chart(stops, ("left", "right"), stops[3])
    assert (chart.series[-1].x.tolist(), chart.series[-1].y.tolist()) == ([2.0], [0.2])
    assert chart.message.startswith("Chosen: stop 2, arm right, 0.200 mm.")
    assert len(stored_residual_chart(stops, (), stops[-1]).series) == 2


def test_the_page_has_a_section_and_escapes_what_devices_said(double: RunFile) -> None:
    session = double.begin_session()
    double.record_request(session, "suspend", HOSTILE)
    for number in range(2):
        double.add_reference(ReferenceRow(HOSTILE, number, float(number), np.array([number * 1e-5, 0, 0]), session))
    text = page_text(double, NOON)
    assert "<h2>Collecting</h2>" in text
    assert HOSTILE not in text
    assert "&lt;script&gt;alert(1)" in text


def missing(count: int, *, reason: str = "no SMR") -> tuple[MissingReading, ...]:
    return tuple(MissingReading(stop=2 * k, arm="left", kind="not measured", reason=reason) for k in range(count))


def test_the_first_missing_readings_are_printed_and_counted() -> None:
    result = CollectResult(
        stops=380, notes=(), missing=missing(14), missing_share=0.0175, tolerated_share=0.05,
        standard_error_mm={"left": 0.0123},
    )  # fmt: skip
    lines = collect_lines(result)
    assert lines[0] == "380 stops stored: complete"
    assert lines[1] == "14 planned readings are missing (1.8%, tolerated 5.0%):"
    assert lines[2] == "  stop 1, arm left: not measured: no SMR"
    assert len([line for line in lines if line.startswith("  stop")]) == 10
    assert "and 4 more" in lines[12]
    assert lines[-1] == "standard error of a predicted position: left 0.0123 mm"


def test_stops_in_a_row_are_one_line_and_notes_do_not_repeat_them() -> None:
    left = tuple(
        MissingReading(stop=stop, arm=arm, kind="not tried", reason="the session ended before")
        for stop in range(10, 30)
        for arm in ("left", "right")
    )
    notes = ("stop 3, arm left: not measured: no SMR", "smallest distance between the arms 80 mm")
    result = CollectResult(stops=10, notes=notes, missing=(*missing(1), *left), missing_share=0.5)
    assert [line for line in collect_lines(result) if line.startswith("  stop")] == [
        "  stop 1, arm left: not measured: no SMR",
        "  stop 11 to 30, arm left: not tried: the session ended before",
        "  stop 11 to 30, arm right: not tried: the session ended before",
    ]
    assert other_notes(result, notes) == [notes[1]]
    assert other_notes(None, notes) == list(notes)
