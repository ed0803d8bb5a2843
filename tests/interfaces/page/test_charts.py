"""Charts: the values that the results have, limits, and a message that says what a person should see."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run.records import ReferenceDrift
from cellapp.commands.calibrate.charts_accuracy import (
    along_joint,
    error_histogram_chart,
    pair_histogram_chart,
    stage_chart,
)
from cellapp.commands.collect.charts import (
    NO_READINGS,
    NO_REFERENCES,
    drift_chart,
    live_drift_chart,
    live_residual_chart,
    standard_error_chart,
)
from cellapp.commands.discover.charts import candidates_chart, gap_chart, picture_chart
from cellapp.commands.plan.charts_obstacles import cell_map_chart
from cellapp.commands.plan.result import PlannedStop
from cellapp.commands.view.charts import Axis, Chart, Series, bar_chart, enumerated, mm
from cellapp.estimation.calibration.records import PairHeldOut, PairMethodResult
from cellapp.estimation.discovery.records import BeforeAfter, GapStep
from cellapp.ground.profile import Profile
from cellapp.ground.progress import ReferenceReport, StopReport
from cellapp.ground.results import StageErrors
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model.nominal import nominal_arm, pose_matrix
from tests.interfaces.page.cases import ERRORS, calibration, nothing_missing, picture, unknown_effect
from tests.twin import PROFILES

pytestmark = pytest.mark.fast

HOME = (0.0, -1.2, 1.4, -1.7, -1.5, 0.3)


def values(chart: Chart, name: str) -> list[tuple[float, float]]:
    (one,) = [one for one in chart.series if one.name == name]
    return list(zip(one.x.tolist(), one.y.tolist(), strict=True))


# -- the dataclasses --------------------------------------------------------------------------------------------------


def test_axes_have_units_and_series_have_one_shape() -> None:
    assert Axis("residual", "mm").words == "residual [mm]"
    assert Axis("step").words == "step"
    with pytest.raises(ValueError, match="series left: y of shape"):
        Series("left", np.zeros(3), np.zeros(2))
    with pytest.raises(ValueError, match="series left: band of shape"):
        Series("left", np.zeros(3), np.zeros(3), band=np.zeros(1))


def test_a_chart_without_finite_values_is_empty() -> None:
    axes = Axis("x"), Axis("y")
    nothing = Series("left", np.array([1.0, np.nan]), np.array([np.nan, 2.0]))
    assert Chart("", *axes, (), "").is_empty
    assert Chart("", *axes, (nothing,), "").is_empty
    assert not Chart("", *axes, (nothing, Series("right", np.zeros(1), np.zeros(1))), "").is_empty
    assert bar_chart("", {}, Axis("rms", "mm"), "none").is_empty


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00123, "0.0012 mm"), (0.0264, "0.026 mm"), (4.561, "4.56 mm"), (123.45, "123.5 mm"), (np.nan, "unknown")],
)
def test_lengths_in_words(value: float, text: str) -> None:
    assert mm(value) == text


def test_lists_in_words() -> None:
    assert [enumerated(words) for words in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "",
        "a",
        "a and b",
        "a, b and c",
    ]


# -- collection -------------------------------------------------------------------------------------------------------


def report(stop: int, arm: str, residual_mm: float, standard_error_mm: float = 0.1) -> StopReport:
    return StopReport(stop, arm, residual_mm, standard_error_mm)


REPORTS = [report(0, "left", 0.02, 0.4), report(0, "right", 0.03), report(1, "left", 0.06, 0.2)]


def test_residuals_and_standard_errors_of_each_arm_over_the_stops() -> None:
    chart = live_residual_chart(REPORTS)
    assert values(chart, "left") == [(1.0, 0.02), (2.0, 0.06)]
    assert values(chart, "right") == [(1.0, 0.03)]
    assert "left 0.060 mm at stop 2 (median 0.040 mm) and right 0.030 mm at stop 1" in chart.message
    chart = standard_error_chart(REPORTS)
    assert values(chart, "left") == [(1.0, 0.4), (2.0, 0.2)]
    assert "left 0.200 mm (at stop 1: 0.400 mm)" in chart.message


def test_an_arm_keeps_its_style_before_the_other_has_reported() -> None:
    (right,) = live_residual_chart([REPORTS[1]], ("left", "right")).series
    assert (right.name, right.style) == ("right", 1)


@pytest.mark.parametrize("build", [live_residual_chart, standard_error_chart])
def test_before_the_first_reading_a_chart_says_what_to_do(build) -> None:
    chart = build([], ("left", "right"))
    assert chart.is_empty
    assert chart.message == NO_READINGS


def test_drift_of_the_references_against_the_limit() -> None:
    rows = [
        ReferenceDrift(name=name, stops_done=stops, drift_mm=drift)
        for name, stops, drift in [("nest", 0, 0.0), ("left", 0, 0.0), ("nest", 20, 0.011), ("left", 20, 0.004)]
    ]
    chart = drift_chart(rows, 0.05)
    assert values(chart, "nest") == [(0.0, 0.0), (20.0, 0.011)]
    assert [limit.value for limit in chart.limits] == [0.05]
    assert chart.message == "nest moved farthest, 0.011 mm from its first measurement; the limit is 0.050 mm."
    beyond = drift_chart(rows, 0.01)
    assert "beyond the limit of 0.010 mm" in beyond.message


def test_live_drift_counts_the_measurements() -> None:
    chart = live_drift_chart([ReferenceReport({"nest": 0.0}, 0.05), ReferenceReport({"nest": 0.02, "left": 0.0}, 0.05)])
    assert values(chart, "nest") == [(1.0, 0.0), (2.0, 0.02)]
    assert values(chart, "left") == [(2.0, 0.0)]
    assert live_drift_chart([]).message == drift_chart([], 0.05).message == NO_REFERENCES


# -- discovery --------------------------------------------------------------------------------------------------------


def test_the_gap_shrinks_to_the_noise_floor() -> None:
    chart = gap_chart("left", unknown_effect("left"))
    assert values(chart, "held-out rms") == [(0.0, 0.4906), (1.0, 0.1112), (2.0, 0.0299), (3.0, 0.0312)]
    assert [(limit.name, limit.value) for limit in chart.limits] == [("noise floor", 0.0223)]
    assert chart.message == (
        "Held-out error fell from 0.491 mm to 0.031 mm; transmission error explains most of it."
        " The noise floor is 0.022 mm."
    )


def test_a_gap_that_no_effect_closes() -> None:
    assert "the search added no effect" in gap_chart("left", nothing_missing("left")).message
    worse = unknown_effect("left").model_copy(update={"heldout_mm": BeforeAfter(before=0.1, after=0.2)})
    assert "did not fall: 0.100 mm before, 0.200 mm after" in gap_chart("left", worse).message


def test_no_single_effect_explains_most() -> None:
    gaps = {"geometry": 0.5, "backlash": 0.39, "link_bending": 0.28, "thermal_growth": 0.01}
    steps = tuple(GapStep(what=what, effect=what, heldout_mm=gap) for what, gap in gaps.items())
    shared = unknown_effect("left").model_copy(
        update={"steps": steps, "heldout_mm": BeforeAfter(before=0.5, after=0.01)}
    )
    assert "backlash explains 39% of it" in gap_chart("left", shared).message


def test_candidates_are_bars_with_the_most_probable_first() -> None:
    chart = candidates_chart("left", unknown_effect("left"))
    assert chart.categories == ("transmission error", "joint compliance", "link bending", "backlash")
    assert chart.series[0].y.tolist() == [100.0, 87.4, 12.6, 0.3]
    expected = "Probable effects: transmission error > 99 %, joint compliance 87 % and link bending 13 %."
    assert chart.message == expected
    assert candidates_chart("left", nothing_missing("left")).is_empty


def test_a_picture_has_its_curve_with_a_band_of_two_standard_deviations() -> None:
    shown = picture("transmission_error", 1, curve=True)
    chart = picture_chart("left", shown)
    measured, computed = chart.series
    assert (measured.kind, computed.kind) == ("points", "line")
    assert shown.curve is not None
    assert computed.band is not None
    assert computed.band.tolist() == [2.0 * sigma for sigma in shown.curve.band]
    assert chart.x == Axis("joint 1", "deg")
    assert chart.y == Axis("offset of joint 1", "µrad")
    assert chart.message.startswith("The effect is 212 µrad rms at these readings, which scatter 20 µrad rms about it.")
    assert "No reading was taken from 128° to -170°." in chart.message


def test_a_few_far_readings_do_not_flatten_a_picture() -> None:
    shown = picture("joint_compliance", 2)
    far = shown.model_copy(update={"measured": (1e6, *shown.measured[1:])})
    chart = picture_chart("left", far)
    assert chart.y_range is not None
    assert chart.y_range[1] < 1000.0


# -- accuracy ---------------------------------------------------------------------------------------------------------


def test_bars_of_the_stages() -> None:
    arm = calibration("left").arms["left"]
    better = StageErrors(position_mm=ERRORS.model_copy(update={"rms": 0.02}))
    arm = arm.model_copy(update={"validate_": {**arm.validate_, "effects": better}, "tracker_mm": 0.015})
    chart = stage_chart("left", arm)
    assert chart.categories == ("nominal", "geometry and effects")
    assert chart.series[0].y.tolist() == [0.2, 0.02]
    assert chart.message == (
        "Held-out rms error: 0.200 mm nominal, 0.020 mm geometry and effects. The tracker's own noise is 0.015 mm."
    )


def test_a_histogram_counts_every_error_once() -> None:
    rng = np.random.default_rng(3)
    errors = {"nominal": rng.lognormal(0.0, 0.5, 100), "effects": np.append(rng.lognormal(-4.0, 0.5, 60), np.nan)}
    chart = error_histogram_chart("left", errors, 0.02)
    for one, count in zip(chart.series, (100, 60), strict=True):
        assert one.kind == "steps"
        assert one.y.sum() == count
        assert one.y[0] == one.y[-1] == 0.0
        assert np.all(np.diff(one.x) >= 0.0)
    assert [one.style for one in chart.series] == [0, 3]
    assert [(limit.axis, limit.value) for limit in chart.limits] == [("x", 0.02)]
    medians = [mm(float(np.nanmedian(values))) for values in errors.values()]
    assert f"Median error: {medians[0]} (nominal), {medians[1]} (geometry and effects)." in chart.message


def test_histograms_without_errors_say_so() -> None:
    for errors in ({}, {"nominal": np.array([np.nan])}, {"nominal": np.zeros(0)}):
        chart = error_histogram_chart("left", errors, None)
        assert chart.is_empty
        assert "calibrate first" in chart.message
    assert not error_histogram_chart("left", {"nominal": np.zeros(3)}, None).is_empty
    assert pair_histogram_chart(calibration("left", "right")).is_empty


def test_a_histogram_of_the_pair() -> None:
    held_out = PairHeldOut(configuration=(1, 2, 3), cooperative_mm=(0.1, 0.2, 0.4), position_mm={})
    pair = {"proposed": PairMethodResult(cooperative_mm=ERRORS, held_out=held_out)}
    chart = pair_histogram_chart(calibration("left", "right").model_copy(update={"pair": pair}))
    assert chart.series[0].y.sum() == 3.0
    assert "Median error: 0.200 mm (network in the base frame)." in chart.message


def test_the_worst_part_of_a_joint_is_named() -> None:
    angle = np.linspace(-90.0, 90.0, 40)
    assert along_joint(angle, np.where(angle > 45.0, 0.3, 0.1)) == (
        "mean error 0.150 mm, largest from 48° to 67° (0.300 mm)."
    )
    assert along_joint(angle, np.full(40, 0.1)) == "mean error 0.100 mm, about the same along the whole range."
    assert along_joint(angle[:1], np.ones(1)) == "mean error 1.00 mm, about the same along the whole range."


# -- maps -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def twin() -> Profile:
    return load_profile(PROFILES / "twin.yaml")


def planned(measured: int) -> list[PlannedStop]:
    return [
        PlannedStop(configuration=stop, measured=stop < measured, q={"left": HOME, "right": HOME}) for stop in range(3)
    ]


def test_the_map_from_above_is_in_the_cell_frame(twin: Profile) -> None:
    chart = cell_map_chart(twin, planned(1))
    assert chart.equal
    assert values(chart, "base") == [(0.0, 0.85), (0.0, -0.85)]
    assert values(chart, "tracker") == [(3.8, 0.0)]
    arm = twin.arms["left"]
    assert arm.base is not None
    x, y, _ = smr_positions(nominal_arm(arm).with_T_M_B(pose_matrix(arm.base)), np.array([HOME]))[0]
    assert values(chart, "left measured") == [(x, y)]
    assert values(chart, "left planned") == [(x, y)] * 2
    assert chart.message.startswith("1 of 3 planned stops are measured; they are ")


def test_the_tracker_sees_azimuth_and_elevation(twin: Profile) -> None:
    chart = cell_map_chart(twin, planned(0), "tracker")
    left, right = values(chart, "base")  # the tracker looks against x of the cell from 0.6 m above the floor
    azimuth = np.degrees(np.arctan2(0.85, 3.8))
    elevation = np.degrees(np.arctan2(-0.6, np.hypot(3.8, 0.85)))
    assert left == pytest.approx((-azimuth, elevation))
    assert right == pytest.approx((azimuth, elevation))


def test_maps_of_cells_that_are_not_planned_or_not_measured(twin: Profile) -> None:
    chart = cell_map_chart(twin, [])
    assert "no stops yet: plan first" in chart.message
    assert [one.name for one in chart.series] == ["base", "tracker"]
    nowhere = twin.model_copy(update={"tracker": twin.tracker.model_copy(update={"pose": None})})
    chart = cell_map_chart(nowhere, planned(1))
    assert chart.is_empty
    assert "tracker.pose" in chart.message
