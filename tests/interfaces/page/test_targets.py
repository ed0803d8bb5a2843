"""What people see of targets: words, tables, charts of hand-made results that have everything a result can have."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellapp.cell.targets.records import (
    ArmVerification,
    CompensateResult,
    MeasuredPair,
    MeasuredTarget,
    TargetCommand,
    TargetRecord,
    UnknownCondition,
    VerifyResult,
)
from cellapp.cell.targets.targets import FramePoint, Partner, Target, WorkFrame, WorkingConditions
from cellapp.commands.compensate.charts import bound_chart, pair_chart, parts_chart, rounds_chart, target_chart
from cellapp.commands.compensate.charts import target_charts as all_charts
from cellapp.commands.compensate.details import place_lines, side_words, stored_state, target_details
from cellapp.commands.compensate.tables import (
    command_tables,
    measured_tables,
    predicted_tables,
    refusal_tables,
    stored_tables,
    uncertainty_tables,
    unknown_tables,
    verification_tables,
)
from cellapp.commands.compensate.target_list import target_list, target_state, target_words
from cellapp.commands.compensate.words import compensate_lines, push_lines, verify_lines, verify_message
from cellapp.commands.report.result import RunResults
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.table import most_urgent, part_table
from cellapp.estimation.uncertainty.records import UncertaintyParts
from cellapp.interfaces.page.drawn import chart_figure
from cellapp.interfaces.tui.plots.drawing import draw
from tests.interfaces.page.cases import ERRORS

pytestmark = pytest.mark.fast

PARTS = UncertaintyParts(
    parameters=0.010, effects=0.006, network=0.004, extrapolation=0.0, noise=0.012, conditions=0.002
)
ONE = Target(name="one", arm="left", position=(0.1, 0.2, 0.3), rpy=(0.0, 0.0, math.pi / 2), tolerance=1e-4)
BOTH = Target(
    name="both",
    arm="left",
    position=(0.5, 0.0, 0.2),
    frame="tracker",
    partner=Partner(arm="right", position=(0.3, 0.0, 0.0)),
    tolerance=5e-5,
)
FAR = Target(name="far", arm="right", position=(4.0, 0.0, 0.0))


def record(target: Target, arm: str = "") -> TargetRecord:
    partner = "" if target.partner is None else next(name for name in target.arms if name != (arm or target.arm))
    return TargetRecord(
        name=target.name,
        arm=arm or target.arm,
        position=target.position,
        rpy=target.rpy,
        tolerance_mm=target.tolerance_mm,
        frame=target.frame,
        partner=partner,
    )


def command(target: Target, arm: str = "", **values: object) -> TargetCommand:
    known = {"refusal": "", "q_nominal": (0.0,) * 6, "q_compensated": (0.1,) * 6, "uncertainty_mm": 0.013}
    return TargetCommand.model_validate({**dict(record(target, arm)), **known, **values})


def measured(target: Target, before: float | None, *after: float, arm: str = "", **values: object) -> MeasuredTarget:
    known = {"nominal_mm": before, "compensated_mm": after[0] if after else None, "rounds_mm": after, "note": ""}
    if len(after) > 1:
        known["corrected_mm"] = after[-1]
    return MeasuredTarget.model_validate({**dict(record(target, arm)), **known, **values})


COMPENSATED = CompensateResult(
    targets=(
        command(
            ONE,
            branches=4,
            visible=True,
            residual_um=0.0004,
            residual_urad=0.0012,
            parts=PARTS,
            within_mm=0.061,
            verdict="in",
            approach=(1, 0, -1, 0, 0, 0),
            unknown=(UnknownCondition(condition="temperature", effects=("thermal_growth",), mm=0.04),),
        ),
        command(BOTH, parts=PARTS, within_mm=0.07, verdict="out"),
        command(BOTH, "right", parts=PARTS, within_mm=0.02, verdict="in", visible=False),
        command(FAR, q_nominal=None, q_compensated=None, uncertainty_mm=None, refusal="out of reach"),
    )
)
VERIFIED = VerifyResult(
    arms={"left": ArmVerification(nominal_mm=ERRORS, compensated_mm=ERRORS, corrected_mm=ERRORS)},
    targets=(
        measured(
            ONE,
            4.2,
            0.05,
            0.02,
            within_mm=0.061,
            verdict="in",
            wanted_M=(1.0, 2.0, 3.0),
            predicted_M=(1.0, 2.0, 3.0),
            measured_M=(1.00003, 2.0, 3.00004),
        ),
        measured(BOTH, 3.0, 0.08, within_mm=0.07, verdict=""),
        measured(FAR, None, note="out of reach"),
    ),
    pairs=(
        MeasuredPair(
            name="both", arms=("left", "right"), wanted_mm=300.0, nominal_mm=2.0, compensated_mm=0.06,
            tolerance_mm=0.05, verdict="out",
        ),
    ),
    cooperative=ArmVerification(nominal_mm=ERRORS, compensated_mm=ERRORS),
)  # fmt: skip
RESULTS = RunResults(run="run", compensate=COMPENSATED, verify=VERIFIED)
OLD = CompensateResult(
    targets=(TargetCommand(name="old", arm="left", refusal="", q_nominal=(0.0,), q_compensated=(0.0,)),)
)
"""As an earlier version wrote it."""


# -- words ------------------------------------------------------------------------------------------------------------


def test_compensate_says_what_is_in_and_out_unknown_and_refused() -> None:
    text = "\n".join(compensate_lines(COMPENSATED))
    assert text.splitlines()[0] == "2 of 3 targets compensated, 1 of them cooperative, 1 refused"
    assert "tolerances, predicted: 2 in, 1 out, 0 cannot say; out: both" in text
    assert "95 % bound of the measured error: median 0.061 mm, largest 0.070 mm at both" in text
    assert "temperature is not stated: thermal_growth may move the SMR by 0.040 mm at one; state conditions:" in text
    assert "not seen by the tracker, so that a push cannot measure them: both" in text
    assert "target far: out of reach; move the target nearer to the arm" in text
    assert compensate_lines(OLD) == ["1 of 1 target compensated"]


def test_a_verification_is_one_sentence_and_what_needs_more() -> None:
    assert verify_message(VERIFIED) == (
        "1 of 2 measurements within tolerance, 1 out: both (0.060 mm); mean error 3.60 -> 0.050 mm at 2 targets;"
        " distance of both SMRs 2.00 -> 0.060 mm at 1 cooperative targets"
    )
    text = "\n".join(verify_lines(VERIFIED))
    assert "the model alone came to 0.0500 mm in the mean; 1 correction by measuring brought it to 0.0200 mm" in text
    assert "1 of 2 measured errors are within the predicted 95 % bound" in text
    assert "target far: out of reach" in text


def test_a_push_without_measurements_counts_what_was_reached() -> None:
    pushed = VerifyResult(arms={}, targets=(measured(ONE, None), measured(FAR, None, note="out of reach")))
    assert push_lines(pushed) == ["1 of 2 targets reached", "target far: out of reach"]
    assert push_lines(VERIFIED) == verify_lines(VERIFIED)


def test_a_target_in_its_details() -> None:
    details = target_details(target_state(ONE, RESULTS))
    text = "\n".join(details.sentences)
    assert "one of 4 solutions within the joint limits" in text
    assert "the tracker sees the SMR there" in text
    assert "made for the approach: joint 1 +, joint 3 -" in text
    assert "95 % of measured errors are within 0.0610 mm" in text
    assert "predicted against 0.1 mm: in" in text
    assert "measured 0.0500 mm from the target, 4.2000 mm with the nominal command; within the predicted bound" in text
    assert "0.0500 -> 0.0200 mm" in text
    (points,) = details.tables
    assert points.text_rows()[-1] == ("measured - predicted", "0.0300", "0.0000", "0.0400", "0.0500")
    (parts,) = details.charts
    assert parts.categories == ("geometry", "effects", "network", "noise", "conditions")
    assert parts.message == "Most of it is noise: 0.012 mm."
    both = "\n".join(target_details(target_state(BOTH, RESULTS)).sentences)
    assert "arm right: the tracker does not see the SMR there" in both
    assert "arms left and right: distance of 300.000 mm off by 0.0600 mm, 2.0000 mm with the nominal" in both
    far = target_details(target_state(FAR, RESULTS))
    assert far.sentences[0].startswith("arm right: refused: out of reach; move the target nearer")
    state = stored_state(RESULTS, "both")
    assert state == target_state(BOTH, RESULTS)
    assert stored_state(RESULTS, "nobody") is None


def test_where_a_target_is() -> None:
    points = [FramePoint(nominal=(x, y, 0.0), measured=(x, y, 1.0)) for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]
    target = ONE.model_copy(
        update={
            "frame": "fixture",
            "work_frame": WorkFrame(name="fixture", points=tuple(points)),
            "conditions": WorkingConditions(payload=2.0, temperature=22.5),
            "approach": (1, -1, 0, 0, 0, 0),
        }
    )
    text = "\n".join(place_lines(target))
    assert "x 100.000, y 200.000, z 300.000 mm, roll 0.000, pitch 0.000, yaw 90.000 deg" in text
    assert "in work frame fixture: 3 points measured in the tracker frame, 0.000 mm rms" in text
    assert "conditions of arm left: payload 2 kg, 22.5 degC" in text
    assert "preferred approach: joint 1 +, joint 2 -" in text
    both = "\n".join(place_lines(BOTH))
    assert "any rotation, in the tracker frame" in both
    assert "with arm right: its SMR at x 300.000, y 0.000, z 0.000 mm, any rotation" in both
    assert side_words((0, 0)) == "any side"


# -- the list ---------------------------------------------------------------------------------------------------------


def test_the_list_has_the_state_of_every_target() -> None:
    table = target_list((ONE, BOTH, FAR), RESULTS)
    rows = [dict(zip(table.headings, row)) for row in table.text_rows()]
    assert [row["arm"] for row in rows] == ["left", "left + right", "right"]
    assert [row["state"] for row in rows] == ["in, measured", "out, measured", "out of reach"]
    assert [row["error [mm]"] for row in rows] == ["4.200 -> 0.020", "2.000 -> 0.060", ""]
    assert [row["frame"] for row in rows] == ["base", "tracker", "base"]
    assert [row["rounds"] for row in rows] == ["1", "0", ""]
    assert [row["95 % [mm]"] for row in rows] == ["0.061", "0.070", ""]
    needing = [target_state(target, RESULTS).needs_attention for target in (ONE, BOTH, FAR)]
    assert needing == [False, True, True]
    predicted = RunResults(run="run", compensate=COMPENSATED)
    assert [row[3] for row in target_list((ONE, BOTH), predicted).rows] == ["in, predicted", "out, predicted"]
    edited = target_words(ONE.model_copy(update={"tolerance": 1e-5}), RESULTS)
    assert edited.startswith("one: measured 0.0200 mm from the target")
    assert "out of tolerance" in edited
    moved = target_words(ONE.model_copy(update={"position": (0.1, 0.2, 0.31)}), RESULTS)
    assert moved.startswith("one: not compensated yet")
    assert "distance of both SMRs off by 0.0600 mm; out of tolerance" in target_words(BOTH, RESULTS)


# -- tables -----------------------------------------------------------------------------------------------------------


def test_tables_of_commands_and_predictions() -> None:
    assert [row[-1] for row in predicted_tables(COMPENSATED)[0].rows] == ["in", "out", "in"]
    uncertainties = uncertainty_tables(COMPENSATED)[0]
    assert uncertainties.headings[2:8] == ("geometry", "effects", "network", "extrapolation", "noise", "conditions")
    assert uncertainties.text_rows()[0][-2:] == ("4", "yes")
    assert unknown_tables(COMPENSATED)[0].text_rows()[0][:5] == ("temperature", "thermal_growth", "0.0400", "one", "1")
    assert refusal_tables(COMPENSATED)[0].text_rows()[0][:3] == ("far", "right", "out of reach")
    assert len(command_tables(COMPENSATED)) == 2
    assert len(stored_tables(OLD)) == 1, "an earlier version stored commands only"


def test_tables_of_measurements() -> None:
    titles = [table.title for table in measured_tables(VERIFIED)]
    assert titles[0] == "Arm left: each target [mm]"
    assert titles[1].startswith("Cooperative targets")
    assert titles[2] == "Targets that were not measured"
    arm = measured_tables(VERIFIED)[0]
    assert {"before", "after", "met"} <= set(arm.headings)
    assert arm.text_rows()[0][:2] == ("1", "one")
    summary, tolerances = verification_tables(VERIFIED)
    assert summary.rows[-1][0] == "between arms, compensated"
    assert [row[0] for row in tolerances.rows] == ["one", "both", "both"]


def test_a_long_table_keeps_what_is_most_urgent_in_its_order() -> None:
    assert most_urgent(range(5), lambda value: value % 4, 3) == [1, 2, 3]
    table = part_table("Targets", (), [(), ()], 5)
    assert table.title == "Targets: 2 of 5, --json has all"


# -- charts -----------------------------------------------------------------------------------------------------------


def verified(*pairs: tuple[float | None, float | None]) -> VerifyResult:
    targets = tuple(
        MeasuredTarget(name=f"t{number}", arm="left", nominal_mm=before, compensated_mm=after, note="")
        for number, (before, after) in enumerate(pairs)
    )
    return VerifyResult(arms={"left": ArmVerification(nominal_mm=ERRORS, compensated_mm=ERRORS)}, targets=targets)


def points(chart: Chart, name: str) -> list[tuple[float, float]]:
    (found,) = [one for one in chart.series if one.name == name]
    return list(zip(found.x.tolist(), found.y.tolist()))


def test_targets_before_and_after() -> None:
    chart = target_chart("left", verified((2.0, 0.1), (None, 0.1), (1.0, 1.3)), 0.02)
    assert points(chart, "uncompensated") == [(1.0, 2.0), (2.0, 1.0)]
    assert points(chart, "compensated") == [(1.0, 0.1), (2.0, 1.3)]
    assert chart.message == "Mean error at 2 targets: 1.50 mm uncompensated, 0.700 mm compensated; 1 became better."
    assert "all became better" in target_chart("left", verified((2.0, 0.1)), None).message
    for verify in (None, verified((None, 0.1))):
        assert target_chart("left", verify, None).is_empty


def test_corrections_and_targets_out_of_tolerance_are_marked() -> None:
    chart = target_chart("left", VERIFIED, None)
    assert points(chart, "compensated") == [(1.0, 0.05), (2.0, 0.08)]
    assert points(chart, "corrected") == [(1.0, 0.02)]
    assert "0.050 mm corrected by measuring" in chart.message
    assert points(pair_chart(VERIFIED), "out of tolerance") == [(1.0, 0.06)]
    rounds = rounds_chart(VERIFIED)
    assert points(rounds, "mean") == [(0.0, 0.05), (1.0, 0.02)]
    assert rounds.message == "Mean error at 1 target: 0.050 mm by the model alone, 0.020 mm in the end."


def test_the_bound_is_compared_with_what_was_measured() -> None:
    chart = bound_chart(VERIFIED)
    assert points(chart, "arm left") == [(0.061, 0.05), (0.07, 0.08)]
    assert np.array_equal(chart.series[-1].x, chart.series[-1].y)
    assert chart.message == "1 of 2 measured errors are within the predicted 95 % bound: 95 % are to be expected."
    assert bound_chart(verified((2.0, 0.1))).is_empty


def test_every_chart_is_drawn_on_the_page_and_in_a_terminal() -> None:
    charts = [*all_charts(VERIFIED, {"left": 0.02}), parts_chart("parts", [PARTS]), parts_chart("none", [])]
    assert len(charts) == 6
    for number, chart in enumerate(charts):
        assert ("<svg" in chart_figure(f"chart{number}", chart).svg) != chart.is_empty
        assert draw(chart, 60, 20)
