"""Histories of drawn runs: what changes is found, what does not is not called changed, however many are compared."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.commands.fleet.view import fleet_sentences, fleet_tables
from cellapp.estimation.monitoring.check.records import CheckVerdict
from cellapp.estimation.monitoring.fleet.histories import FALSE_ALARM, fleet_result
from cellapp.estimation.monitoring.fleet.parameters import HOUSING_M, MODEL_CHOICE, determined_values, is_installation
from cellapp.estimation.monitoring.fleet.record import EffectRecord, RunRecord
from cellapp.estimation.monitoring.fleet.records import ArmHistory, CheckPoint, DatedValue, FleetResult, IsoPoint
from cellapp.ground.results import Estimate
from tests.estimation.monitoring.fleet.drawn import arm, effect, geometry, month, run

pytestmark = pytest.mark.fast


def only(result: FleetResult) -> ArmHistory:
    (history,) = result.arms.values()
    assert FleetResult.from_json(result.to_json(), "fleet") == result
    return history


def drawn(seed: int, runs: int, changes: dict[str, float] | None = None, **settings) -> list[RunRecord]:
    """Runs of one arm; from the second on it has changed."""
    rng = np.random.default_rng(seed)
    truths = [None, *[changes] * (runs - 1)]
    return [run(number, {"left": arm(geometry(rng, truth))}, **settings) for number, truth in enumerate(truths)]


def test_what_the_data_determine_is_compared() -> None:
    shape = geometry(np.random.default_rng(1), {"d2": 1e-3, "d3": 1e-3, "theta2": 2e-4})
    values = determined_values(shape, shape)
    assert list(values) == ["x0", "theta2", "d2", "a3", "tx"]
    assert values["d2"].value == pytest.approx(2e-3, abs=10e-6)
    assert values["d2"].standard_error == pytest.approx(2e-6, rel=1e-6)
    assert values["theta2"].standard_error == pytest.approx(5e-6)
    assert values["theta2"].length_m == 0.0
    assert values["d2"].length_m == pytest.approx(2 * HOUSING_M)


@pytest.mark.parametrize(
    ("name", "base_or_tool"),
    [("x0", True), ("theta0", True), ("tz", True), ("theta1", False), ("d10", False), ("alpha20", False)],
)
def test_base_and_tool_may_be_moved_by_people(name: str, base_or_tool: bool) -> None:
    assert is_installation(name) == base_or_tool


@pytest.mark.slow
def test_unchanged_fleets_raise_no_alarm() -> None:
    fleets = [fleet_result(drawn(seed, 12)) for seed in range(120)]
    alarms = [only(one).condition for one in fleets]
    assert set(alarms) <= {"unchanged", "changed", "drifting"}
    assert sum(condition != "unchanged" for condition in alarms) <= 3  # 120 x 1 % is 1.2
    assert fleets[0].comparisons == 11 * 3
    assert fleets[0].trends_tested == 3


@pytest.mark.slow
def test_standard_errors_that_are_too_small_by_the_stated_factor_raise_none_either() -> None:
    rng = np.random.default_rng(4)
    alarms = 0
    for _ in range(60):
        runs = [run(n, {"left": arm(geometry(rng, scatter=MODEL_CHOICE))}) for n in range(12)]
        alarms += only(fleet_result(runs)).condition != "unchanged"
    assert alarms <= 3


def test_a_change_is_found_with_its_size_and_its_displacement() -> None:
    history = only(fleet_result(drawn(3, 3, {"theta2": 100e-6, "x0": 1e-3, "tx": 1e-3})))
    assert history.condition == "changed"
    found = {one.name: one for one in history.parameters}
    changed = [name for name, one in found.items() if one.last is not None and one.last.proven]
    assert changed == ["theta2"], "base and tool were moved by a person"
    last = found["theta2"].last
    assert last is not None
    assert last.difference == pytest.approx(100e-6, abs=4 * last.standard_uncertainty)
    assert found["theta2"].moved_mm == pytest.approx(0.5 * 1e3 * abs(last.difference))
    assert found["x0"].last is not None
    assert found["x0"].last.p_value is None
    assert "theta2 changed by" in history.reasons[0]


def proven(history: ArmHistory) -> list[str]:
    return [one.name for one in history.parameters if one.last is not None and one.last.proven]


def test_links_that_are_warmer_are_longer_and_have_not_changed() -> None:
    runs = drawn(16, 2, {"a3": 40e-6})
    assert proven(only(fleet_result(runs))) == ["a3"]
    for place, (air, joint) in enumerate(((20.0, 30.0), (21.0, 45.0))):
        warm = runs[place].arms["left"].model_copy(update={"temperatures_c": {"air": air, "joint 2": joint}})
        runs[place] = runs[place].model_copy(update={"arms": {"left": warm}})
    assert proven(only(fleet_result(runs))) == []
    far = drawn(16, 2, {"a3": 1e-3, "theta2": 1e-3})
    far[1] = far[1].model_copy(
        update={"arms": {"left": warm.model_copy(update={"geometry": far[1].arms["left"].geometry})}}
    )
    far[0] = far[0].model_copy(update={"arms": runs[0].arms})
    assert proven(only(fleet_result(far))) == ["theta2", "a3"]


def test_the_zero_of_a_joint_that_drifts_within_a_run_is_not_judged() -> None:
    runs = drawn(17, 2, {"theta2": 1e-3, "a3": 1e-3})
    assert proven(only(fleet_result(runs))) == ["theta2", "a3"]
    drift = effect("joint_drift", {"drift2": 1e-3})
    drifted = runs[1].arms["left"].model_copy(update={"effects": (drift,)})
    runs[1] = runs[1].model_copy(update={"arms": {"left": drifted}})
    assert proven(only(fleet_result(runs))) == ["a3"]


def test_a_change_of_the_sum_of_two_parameters_that_act_alike_is_found() -> None:
    history = only(fleet_result(drawn(5, 2, {"d3": 50e-6})))
    assert [one.name for one in history.parameters if one.last is not None and one.last.proven] == ["d2"]


def test_the_more_is_compared_the_more_must_differ() -> None:
    few = drawn(6, 2, {"theta2": 40e-6})
    many = [*few, *(run(n, {"a": arm(geometry(np.random.default_rng(n)), key=f"A{n // 2}")}) for n in range(2, 400))]
    chances = []
    for records in (few, many):
        last = next(one for one in fleet_result(records).arms["S-1"].parameters if one.name == "theta2").last
        assert last is not None
        assert last.p_value is not None
        chances.append(last.p_value)
    assert chances[1] > 50 * chances[0]


def test_an_angle_near_half_a_turn_may_have_either_sign() -> None:
    rng = np.random.default_rng(8)
    runs = [run(n, {"left": arm(geometry(rng, {"theta2": angle}))}) for n, angle in enumerate((np.pi, -np.pi))]
    history = only(fleet_result(runs))
    assert history.condition == "unchanged"


def test_arms_with_other_serial_numbers_are_not_compared() -> None:
    rng = np.random.default_rng(9)
    runs = [
        run(n, {"left": arm(geometry(rng, {"theta2": n * 1e-3}), key=key)})
        for n, key in enumerate(("S-1", "S-1", "S-2"))
    ]
    result = fleet_result(runs)
    assert set(result.arms) == {"S-1", "S-2"}
    assert result.arms["S-2"].condition == "not compared"
    (note,) = result.notes
    assert "'cell, left' is not one arm in all runs: S-1 in logs/00; S-2 in logs/02" in note
    assert note in fleet_sentences(result)


def test_one_serial_number_twice_in_a_run_is_two_arms() -> None:
    rng = np.random.default_rng(9)
    runs = [run(n, {"left": arm(geometry(rng)), "right": arm(geometry(rng))}) for n in range(2)]
    assert set(fleet_result(runs).arms) == {"S-1 (left)", "S-1 (right)"}


def test_a_drift_too_small_for_single_runs_is_found_over_many_and_leads_to_the_tolerance() -> None:
    rng = np.random.default_rng(12)
    slope = 3e-6  # rad a month: 1.5 um a month at a lever of 0.5 m
    runs = [run(n, {"left": arm(geometry(rng, {"theta2": slope * n}))}, tolerance_mm=0.1) for n in range(16)]
    history = only(fleet_result(runs))
    (trend,) = [one for one in history.trends if one.proven]
    assert (trend.figure, trend.name) == ("parameter", "theta2")
    assert trend.slope == pytest.approx(1.5e-3, abs=4 * trend.slope_standard_error)
    assert trend.crossing is not None
    assert trend.crossing.months == pytest.approx(0.1 / trend.slope, rel=1e-3)
    assert trend.crossing.earliest is not None
    assert trend.crossing.latest is not None
    assert trend.crossing.earliest < trend.crossing.date < trend.crossing.latest
    said = "\n".join(fleet_sentences(fleet_result(runs)))
    assert "at this rate it will have moved the SMR by 0.1 mm since the newest calibration in " in said


def verified(values: list[float], tolerance_mm: float | None) -> FleetResult:
    runs = []
    for number, value in enumerate(values):
        point = DatedValue(run=f"logs/{number:02}", time=month(number), value=value)
        runs.append(run(number, {"left": arm(None, figures={"verified": (point,)})}, tolerance_mm=tolerance_mm))
    return fleet_result(runs)


GROWING = [0.030, 0.036, 0.041, 0.047, 0.051, 0.058, 0.062, 0.068]


def test_an_error_that_grows_reaches_the_tolerance() -> None:
    result = verified(GROWING, 0.1)
    history = only(result)
    assert history.condition == "drifting"
    (trend,) = history.trends
    assert trend.crossing is not None
    assert 4.0 < trend.crossing.months < 8.0
    said = "\n".join(fleet_sentences(result))
    assert "at this rate it will reach 0.1 mm in 6 months (95 %: 2027-0" in said


def test_without_a_tolerance_no_date_is_said() -> None:
    (trend,) = only(verified(GROWING, None)).trends
    assert trend.proven
    assert trend.crossing is None


@pytest.mark.parametrize(
    ("values", "condition"),
    [
        (GROWING[::-1], "unchanged"),
        ([0.05, 0.06, 0.05, 0.06, 0.05, 0.06], "unchanged"),
        ([0.05, 0.06, 0.12], "beyond tolerance"),
        ([0.05, 0.12, 0.06], "not compared"),
    ],
    ids=["falls", "no trend", "beyond", "was beyond"],
)
def test_the_condition_follows_from_the_newest_error(values: list[float], condition: str) -> None:
    result = verified(values, 0.1)
    assert only(result).condition == condition
    assert bool(result.complaints()) == (condition == "beyond tolerance")
    assert all(one.crossing is None for one in only(result).trends)


def test_values_of_one_day_are_no_trend() -> None:
    figures = tuple(
        DatedValue(run="logs/00", time=f"2026-01-05T{hour:02}:00:00+00:00", value=0.03 + 0.01 * hour)
        for hour in range(6)
    )
    result = fleet_result([run(0, {"left": arm(None, figures={"verified": figures})})])
    assert only(result).trends == ()
    assert any("too few runs at different times for a trend" in one for one in fleet_sentences(result))


def test_effects_over_time_and_the_worst_arm_first() -> None:
    rng = np.random.default_rng(14)
    smallest = {"backlash": {"half_play1": 5e-6}}
    runs = [
        run(
            n,
            {
                "left": arm(geometry(rng), key="Z", effects=found, smallest=smallest),
                "right": arm(geometry(rng), key="A", effects=()),
            },
        )
        for n, found in enumerate(((), (), (effect("backlash", {"half_play1": 60e-6}),)))
    ]
    result = fleet_result(runs)
    assert list(result.arms) == ["Z", "A"]
    (history,) = result.arms["Z"].effects
    assert (history.state, history.first_found) == ("appeared", month(2))
    assert [size.found for size in history.sizes] == [False, False, True]
    assert result.arms["A"].effects == ()
    assert result.complaints() == [f"Z: changed ({result.arms['Z'].reasons[0]})"]
    titles = [table.title for table in fleet_tables(result)]
    assert "Z: effects, newest against first search" in titles


def checked(verdict: CheckVerdict, *changes: str, when: int = 3) -> ArmHistory:
    """Two unchanged runs, and a check in a later month."""
    rng = np.random.default_rng(15)
    point = CheckPoint(run="logs/00", time=month(when), verdict=verdict, rms_mm=0.05, changes=changes)
    runs = [run(n, {"left": arm(geometry(rng))}) for n in range(2)]
    first = runs[0].arms["left"].model_copy(update={"checks": (point,)})
    return only(fleet_result([runs[0].model_copy(update={"arms": {"left": first}}), runs[1]]))


def test_a_later_check_may_say_that_the_arm_changed() -> None:
    history = checked("arm changed", "theta2")
    assert history.condition == "changed"
    assert history.reasons == ("the check of 2026-04-05 says that the arm changed: theta2",)
    assert checked("arm changed").condition == "unchanged", "it was another arm"
    assert checked("arm changed", "theta2", when=0).condition == "unchanged", "calibrated since"
    assert checked("not explained").condition == "changed"
    assert checked("tracker moved").condition == "unchanged"
    assert checked("valid").condition == "unchanged"


def test_a_characteristic_that_does_not_conform_is_beyond_tolerance() -> None:
    points = [
        IsoPoint(
            run="logs/00",
            time=month(n),
            characteristic="pose_accuracy",
            value_mm=value,
            tolerance_mm=0.1,
            conformity=conformity,
        )
        for n, (value, conformity) in enumerate(((0.2, "does not conform"), (0.05, "conforms")))
    ]
    for order, condition in ((points, "not compared"), (points[::-1], "beyond tolerance")):
        dated = [point.model_copy(update={"time": month(n)}) for n, point in enumerate(order)]
        record = arm(None).model_copy(update={"iso9283": tuple(dated)})
        assert only(fleet_result([run(0, {"left": record})])).condition == condition


def two_armed(n: int, x_m: float, effects: tuple[EffectRecord, ...] = ()) -> RunRecord:
    """A run whose second base stands at ``x_m``."""
    rng = np.random.default_rng([20, n])
    arms = {"left": arm(geometry(rng), effects=effects), "right": arm(geometry(rng), key="S-2")}
    transform = {"x": Estimate(value=x_m, standard_error=10e-6, unit="m")}
    return run(n, arms).model_copy(update={"transforms": {"effects": transform}})


def test_bases_that_moved_against_each_other_are_said_to_have_and_no_arm_changed() -> None:
    result = fleet_result([two_armed(0, 1.7), two_armed(1, 1.701)])
    (pair,) = result.pairs
    assert pair.moved
    assert pair.distances_mm[0].value == pytest.approx(1.0)
    assert {one.condition for one in result.arms.values()} == {"unchanged"}
    assert any("have moved against each other, by 1.000 mm" in sentence for sentence in fleet_sentences(result))
    assert not fleet_result([two_armed(0, 1.7), two_armed(1, 1.70003)]).pairs[0].moved
    unknown = effect("unknown", {})
    assert not fleet_result([two_armed(0, 1.7), two_armed(1, 1.701, (unknown,))]).pairs[0].moved


def test_of_a_large_fleet_only_findings_have_tables() -> None:
    rng = np.random.default_rng(18)
    runs = []
    for n in range(2):
        arms = {f"arm{k}": arm(geometry(rng, {"theta2": 1e-3 * n * (k == 3)}), key=f"S-{k}") for k in range(8)}
        runs.append(run(n, arms))
    result = fleet_result(runs)
    titles = [table.title for table in fleet_tables(result)]
    assert [title for title in titles if "parameters" in title] == ["S-3: parameters, newest against first run"]
    assert "tables of 7 arms without a finding are left out; --page and --json have all" in fleet_sentences(result)


def test_nothing_at_all() -> None:
    result = fleet_result([])
    assert (result.arms, result.runs, result.comparisons) == ({}, (), 0)
    assert fleet_tables(result) == []
    assert result.false_alarm == FALSE_ALARM
