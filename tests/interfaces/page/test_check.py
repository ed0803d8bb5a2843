"""A check in words, tables and charts, and as a section of the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.check.view import check_charts, check_sentences, check_tables, error_chart, evidence_chart
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.headlines import out_of_date_lines
from cellapp.commands.report.sections import report_sections
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.commands.stages import append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import stage_in_force
from cellapp.estimation.monitoring.check.records import (
    CheckedArm,
    CheckedPoint,
    CheckedStop,
    CheckResult,
    FoundChange,
    WeakChange,
)
from cellapp.ground.results import CHECK
from cellapp.interfaces.page.drawn import drawn_sections
from cellapp.interfaces.page.page import template

ODD = "<b>left</b>"


def stop(number: int, **errors_mm: float) -> CheckedStop:
    points = {
        name: CheckedPoint(q=(0.1,) * 6, measured_M=(3.0, 0.1, 0.4), error_mm=error_mm)
        for name, error_mm in errors_mm.items()
    }
    return CheckedStop(points=points, log_evidence=2.0 * number, log_valid=-number, p_value=0.1, time_s=9.0 * number)


def result(**changes: Any) -> CheckResult:
    """A check of two arms, of which the first has changed and the second was not measured at the last stop."""
    zero = FoundChange(
        arm="left",
        what="zero of joint 3",
        value=2.985e-4,
        standard_error=5.2e-6,
        unit="rad",
        p_value=0.0,
        moved_mm=0.187,
        rivals=("base of arm left",),
    )
    fields: dict[str, Any] = {
        "verdict": "arm changed",
        "model": "discover",
        "planned": 20,
        "sure_after": 3,
        "p_value": 2e-9,
        "sure_change": 6.2,
        "sure_valid": 4.6,
        "arms": {
            "left": CheckedArm(stops=3, expected_mm=0.026, rms_mm=0.221, left_mm=0.187),
            "right": CheckedArm(stops=2, expected_mm=0.027, rms_mm=0.025),
        },
        "changes": (zero,),
        "weak": (WeakChange(arm="right", what="a5", moved_mm=0.03, detected=0.07e-3, unit="m"),),
        "stops": (stop(1, left=0.25, right=0.02), stop(2, left=0.23, right=0.03), stop(3, left=0.21)),
        "seconds": 27.4,
        "next_step": "calibrate again",
        "notes": ("a note",),
    }
    return CheckResult(**{**fields, **changes})


def test_the_sentences_say_what_changed_by_how_much_and_what_to_do() -> None:
    said = check_sentences(result())
    assert said[0] == "an arm changed (arm left: zero of joint 3): 3 of 20 stops were measured in 27 s"
    assert said[1].startswith("probability of errors as large if nothing had changed: 2e-09;")
    assert said[2] == (
        "arm left: zero of joint 3 by 0.2985 +- 0.0052 mrad: it moves the SMR by 0.187 mm rms over the calibration's"
        " readings (p < 1e-12)"
    )
    assert sum(
        sentence.startswith("arm left: predictions of the stored model are off by 0.187 mm") for sentence in said
    )
    assert not any(sentence.startswith("arm right: predictions") for sentence in said)
    assert said[-2:] == ["next: calibrate again", "a note"]


def test_the_tracker_s_motion_is_stated() -> None:
    tracker = FoundChange(
        arm="tracker", what="tracker", value=None, standard_error=None, unit="", p_value=1e-5, moved_mm=3.0
    )
    moved = result(verdict="tracker moved", changes=(tracker,), station_shift_mm=36.07, station_turn_deg=0.5839)
    said = check_sentences(moved)
    assert said[0].startswith("the tracker moved; the arms are as they were calibrated")
    assert said[2] == "it stands 36.070 mm and 0.5839 deg from where it was"
    assert said[3].startswith("tracker: it moves the SMR by 3.000 mm rms")
    assert moved.complaints() == ["the calibration does not hold as it is: tracker moved (tracker)"]


def test_the_tables_have_every_arm_change_and_stop() -> None:
    arms, changes, weak, stops = check_tables(result())
    assert weak.text_rows() == (("right", "a5", "0.07", "mm"),)
    assert [row[0] for row in arms.rows] == ["left", "right"]
    assert changes.text_rows()[0][:5] == ("left", "zero of joint 3", "0.2985", "0.0052", "mrad")
    assert [row[0] for row in stops.rows] == [1, 2, 3]
    assert stops.rows[2][3] is None, "not measured there"
    assert len(check_tables(result(changes=(), weak=(), stops=(), verdict="valid"))) == 1


def test_the_charts_show_evidence_and_errors_with_a_message() -> None:
    evidence, errors = check_charts(result())
    assert [one.y.tolist() for one in evidence.series] == [[2.0, 4.0, 6.0], [-1.0, -2.0, -3.0]]
    assert [limit.value for limit in evidence.limits] == [6.2, 4.6]
    assert "of a change 6.0 (sure at 6.2)" in evidence.message
    assert [len(one.x) for one in errors.series] == [3, 2]
    assert "arm left 0.221 mm rms, 0.026 mm expected" in errors.message
    empty = result(stops=())
    assert evidence_chart(empty).is_empty
    assert error_chart(empty).message == "No stop was measured."


@pytest.mark.parametrize(
    ("verdict", "complaint"),
    [("valid", None), ("cannot say", "not known"), ("not explained", "does not hold")],
    ids=["valid", "cannot say", "not explained"],
)
def test_complaints(verdict: str, complaint: str | None) -> None:
    found = result(verdict=verdict, changes=(), stale="'discover' is out of date (reasons)")
    said = found.complaints()
    assert len(said) == (0 if complaint is None else 1)
    assert complaint is None or complaint in said[0]
    assert found.complaints(strict=True)[len(said) :] == [f"the model was out of date already: {found.stale}"]


def test_the_page_and_the_overview_show_it(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        basis = basis_on_model(run, stage_in_force(run, read_stages(run)))
        append_stage(run, CHECK, result(notes=(ODD,)), basis)
        assert "do not use it as it is: the last 'check' found: arm changed" in overview_sentences(run_overview(run))
        data = read_report_data(run)
        (section,) = (one for one in report_sections(run, data) if one.key == "check")
    warned = dict(out_of_date_lines(data))
    assert warned["Check of the calibration"].endswith("arm changed (arm left: zero of joint 3)")
    assert section.message.startswith("An arm changed (arm left: zero of joint 3)")
    drawn = template("sections/layout.html").module.folding(drawn_sections([section])[0])  # type: ignore[attr-defined]
    assert "zero of joint 3 by 0.2985 +- 0.0052 mrad" in drawn
    assert "Check: evidence over the stops" in drawn
    assert "&lt;b&gt;left" in drawn
    assert ODD not in drawn
