"""What people see of targets: words, tables, charts of hand-made results that have everything a result can have."""

from __future__ import annotations

import math

from cellapp.cell.run import RunFile
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
from cellapp.cell.targets.targets import Partner, Target
from cellapp.commands.compensate.charts import parts_chart, target_charts
from cellapp.commands.compensate.charts import target_charts as all_charts
from cellapp.commands.compensate.tables import measured_tables, uncertainty_tables
from cellapp.commands.compensate.target_list import stored_state, target_list, target_state, target_words
from cellapp.commands.compensate.view import target_parts, targets_section
from cellapp.commands.compensate.words import PART_WORDS, compensate_lines, verify_message
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.result import RunResults, read_results
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.table import Table
from cellapp.estimation.uncertainty.records import UncertaintyParts
from cellapp.interfaces.page.drawn import chart_figure
from cellapp.interfaces.tui.plots.drawing import draw
from tests.interfaces.page.cases import ERRORS
from tests.interfaces.page.runs import LEFT, RIGHT, TARGET, UNREACHABLE, targets_of

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
# -- words ------------------------------------------------------------------------------------------------------------


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


def test_every_chart_is_drawn_on_the_page_and_in_a_terminal() -> None:
    charts = [*all_charts(VERIFIED, {"left": 0.02}), parts_chart("parts", [PARTS]), parts_chart("none", [])]
    assert len(charts) == 6
    for number, chart in enumerate(charts):
        assert ("<svg" in chart_figure(f"chart{number}", chart).svg) != chart.is_empty
        assert draw(chart, 60, 20)


# -- Targets that the product compensated and measured: in words, tables, charts and on the page -----------------------


def test_what_the_product_stores_is_shown(whole: RunFile) -> None:
    results = read_results(whole)
    assert results.compensate is not None
    assert results.verify is not None
    lines = compensate_lines(results.compensate)
    assert lines[0] == "4 of 5 targets compensated, 1 refused"
    assert any(line.startswith(f"target {UNREACHABLE}: out of reach: the nearest pose is") for line in lines)
    assert any(line.startswith("95 % bound of the measured error: median") for line in lines)
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


def test_one_target_alone(whole: RunFile) -> None:
    results = read_results(whole)
    state = stored_state(results, TARGET)
    assert state is not None
    parts = target_parts(results, state)
    assert "1 of 1 target compensated" in parts
    assert any(isinstance(one, str) and one.startswith("mean error ") for one in parts)
    assert {row[0] for one in parts if isinstance(one, Table) for row in one.rows} <= {TARGET, "1"}


def test_the_page_begins_with_the_message(whole: RunFile) -> None:
    data = read_report_data(whole)
    floors_mm = {name: arm.tracker_mm for name, arm in data.calibrate.arms.items()}
    section = targets_section(data.results.compensate, data.verify, floors_mm)
    assert section.message.startswith("Mean error ")
    assert sum(isinstance(part, Chart) for part in section.parts) == 5
