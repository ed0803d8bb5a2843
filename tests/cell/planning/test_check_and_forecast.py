"""A plan before it is measured: the gate again, covered ranges, time, and what the stops can show."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.duration import motion_s, planned_time
from cellapp.cell.planning.planned_stops import read_planned_stops, write_planned_stops
from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
from cellapp.cell.planning.view import check_plan_run, forecast_run, joint_coverage
from cellapp.cell.run import RunFile
from cellapp.commands.plan.check_view import check_sentences, forecast_sentences, forecast_tables
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, CancelToken, Progress
from drivers.plant.motion import travel
from tests.cell.planning.hand_made import drivable_stops
from tests.twin import small_twin

STOPS = 24


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with a plan. No test may write to it."""
    folder = tmp_path_factory.mktemp("planned") / "run"
    new_planned_run(small_twin(STOPS, plan={"reserve": 2}), folder).close()
    return folder


@pytest.fixture(scope="module")
def forecast(planned: Path) -> PlanForecastResult:
    with RunFile.open(planned) as run:
        return forecast_run(run)


def with_plan(folder: Path, profile: Profile, **q: np.ndarray) -> RunFile:
    return RunFile.create(folder, profile, lambda run: run.write_plan(q))


def test_a_plan_that_was_just_made_is_safe(planned: Path) -> None:
    heard: list[Progress] = []
    with RunFile.open(planned) as run:
        result = check_plan_run(run, heard.append)
    assert (result.stops, result.ways) == (STOPS + 2, STOPS + 3)
    assert [one for one in result.refused if one.configuration is not None or not one.is_avoided] == []
    assert result.is_safe, "home may be reached one arm after the other"
    assert check_sentences(result)[0].startswith("Safe: 26 stops and 27 ways")
    assert heard[-1].done == heard[-1].total == STOPS + 2
    assert PlanCheckResult.from_json(result.to_json(), "check") == result


def test_every_refused_stop_and_way_is_named(planned: Path, tmp_path: Path) -> None:
    with RunFile.open(planned) as run:
        plan, profile = run.read_plan(), run.profile
    into_floor = plan["left"].copy()
    into_floor[3] = [0.0, 0.6, 0.0, -1.5, 0.0, 0.0]
    with with_plan(tmp_path / "run", profile, left=into_floor, right=plan["right"]) as run:
        result = check_plan_run(run)
    assert not result.is_safe
    by_stop = [one for one in result.refused if one.what == "stop"]
    assert [(one.configuration, one.before) for one in by_stop] == [(3, 2)]
    assert "floor" in by_stop[0].reason
    ways = {one.configuration for one in result.refused if one.what == "way"}
    assert 4 in ways, "the way out of the floor is refused, too"
    sentences = check_sentences(result)
    assert sentences[0].startswith("Not safe")
    assert any("stop 4: arm left: collides with the floor" in sentence for sentence in sentences)


def test_a_way_that_goes_home_first_is_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cellapp.cell.planning import planned_stops
    from cellapp.cell.safety.cell_bodies import home_positions

    straight = new_planned_run(small_twin(4, plan={"method": "random"}), tmp_path / "run")
    with straight as run:
        homes, plan = home_positions(run.profile), run.read_plan()

        def refuse(cell: object, here: dict[str, np.ndarray], there: dict[str, np.ndarray]) -> str:
            away = all(not np.array_equal(q["left"], homes["left"]) for q in (here, there))
            into_second = np.array_equal(there["left"], plan["left"][1]) and not np.array_equal(
                here["left"], there["left"]
            )
            return "a column stands there" if away and into_second else ""

        monkeypatch.setattr(planned_stops, "refuse_motion", refuse)
        result = check_plan_run(run)
    (one,) = result.refused
    assert (one.configuration, one.what, one.via_home) == (1, "way", True)
    assert result.is_safe
    assert "via home" in check_sentences(result)[1]


def test_a_check_is_cancelled_and_needs_a_plan(planned: Path, tmp_path: Path) -> None:
    token = CancelToken()
    token.cancel()
    with RunFile.open(planned) as run:
        for foresee in (check_plan_run, forecast_run):
            with pytest.raises(Cancelled):
                foresee(run, cancel=token)
    with RunFile.create(tmp_path / "imported", small_twin()) as run:
        for foresee in (check_plan_run, forecast_run):
            with pytest.raises(InputError, match="the run has no plan"):
                foresee(run)


def test_coverage_names_the_used_part_and_the_largest_gap() -> None:
    ranges = np.array([[-1.0, 3.0], [0.0, 1.0]])
    q = np.array([[0.0, 0.5], [1.0, 0.5], [0.5, 0.5]])
    first, second = joint_coverage(ranges, q)
    assert first.used == (0.0, 1.0)
    assert first.largest_gap == pytest.approx(2.0)
    assert first.share == pytest.approx(0.25)
    assert second.share == 0.0


def test_motions_take_what_the_simulated_arm_takes() -> None:
    arm = small_twin().arms["left"]
    speed = np.array([joint.speed for joint in arm.type.joints]) * arm.speed_scale
    acceleration = np.array([joint.acceleration for joint in arm.type.joints]) * arm.speed_scale
    ways = np.random.default_rng(3).uniform(-2.0, 2.0, (40, 6)) * np.logspace(-4, 0, 40)[:, None]
    expected = [travel(0.0, np.zeros(6), way, speed, acceleration) for way in ways]
    np.testing.assert_allclose(motion_s(arm, ways), [motion.duration_s for motion in expected if motion], rtol=1e-12)
    assert motion_s(arm, np.zeros((1, 6)))[0] == 0.0


def test_the_estimated_time_is_that_of_a_simulated_collection(tmp_path: Path) -> None:
    profile = small_twin(12)
    with new_planned_run(profile, tmp_path / "run") as run:
        estimated = planned_time(profile, read_planned_stops(run))
        collect_run(run)
        taken_s = float(run.readings("right").time_s.max())
    parts = (estimated.moving_s, estimated.resting_s, estimated.measuring_s, estimated.references_s)
    assert estimated.total_s == pytest.approx(sum(parts))
    assert taken_s == pytest.approx(estimated.total_s, rel=0.25)


def test_the_time_of_approaches_legs_and_dwells_is_foreseen(tmp_path: Path) -> None:
    stops = drivable_stops(6, np.full(6, 0.06))
    between = {name: 0.5 * (q[2] + q[3]) for name, q in stops.q.items()}
    stops.dwell_s["left"][4] = 20.0
    legs = tuple((between,) if stop == 3 else () for stop in range(6))
    profile = small_twin(6)
    with RunFile.create(tmp_path / "run", profile) as run:
        write_planned_stops(run, replace(stops, legs=legs))
        estimated = planned_time(profile, read_planned_stops(run))
        collect_run(run)
        taken_s = float(run.readings("left").time_s.max())
    assert estimated.resting_s > 20.0
    assert taken_s == pytest.approx(estimated.total_s, rel=0.25)


def test_references_and_warm_up_take_their_time(planned: Path) -> None:
    with RunFile.open(planned) as run:
        profile, plan = run.profile, read_planned_stops(run)
    reference = profile.collection.reference.model_copy(update={"every": 5})
    longer = profile.collection.model_copy(update={"reference": reference, "warm_up": 600.0})
    before, after = (planned_time(p, plan) for p in (profile, profile.model_copy(update={"collection": longer})))
    assert after.warm_up_s == 600.0
    assert after.references_s > 0.0 == before.references_s
    assert after.total_s > before.total_s + 600.0


def test_a_forecast_counts_covers_and_survives_json(forecast: PlanForecastResult) -> None:
    assert PlanForecastResult.from_json(forecast.to_json(), "forecast") == forecast
    for arm in forecast.arms.values():
        assert (arm.stops, arm.reserves) == (STOPS, 2)
        assert [one.joint for one in arm.coverage] == [1, 2, 3, 4, 5, 6]
        alone, scattered = arm.accuracy
        assert (alone.scatter_mm, scattered.scatter_mm) == (0.0, 0.1)
        assert 0.0 < alone.standard_error_mm < scattered.standard_error_mm
        assert alone.standard_error_mm < alone.largest_mm
        assert {"x0", "tx", "theta2"} <= set(alone.parameters)
    tables = forecast_tables(forecast)
    assert len(tables) == 6
    assert any("Collecting takes about" in sentence for sentence in forecast_sentences(forecast))


def test_what_geometry_can_follow_is_invisible_and_backlash_is_not(forecast: PlanForecastResult) -> None:
    for arm in forecast.arms.values():
        effects = {one.effect: one for one in arm.effects}
        assert not effects["tracker_scale"].visible
        assert "payload does not vary" in effects["payload_compliance"].reason
        backlash = effects["backlash"]
        assert backlash.visible
        assert backlash.smallest_seen_rms_mm is not None
        assert backlash.with_scatter_rms_mm is not None
        assert 0.0 < backlash.smallest_seen_rms_mm < backlash.with_scatter_rms_mm
        assert {"half_play1", "half_play2"} & set(backlash.smallest_seen)


def test_more_stops_show_smaller_effects(forecast: PlanForecastResult, planned: Path, tmp_path: Path) -> None:
    with RunFile.open(planned) as run:
        plan = run.read_plan()
    twice = {name: np.concatenate([q[:STOPS], q[:STOPS][::-1]]) for name, q in plan.items()}
    with with_plan(tmp_path / "run", small_twin(2 * STOPS), **twice) as run:
        more = forecast_run(run)
    for name, arm in more.arms.items():
        for before, after in zip(forecast.arms[name].accuracy, arm.accuracy, strict=True):
            ratio = after.standard_error_mm / before.standard_error_mm
            assert math.sqrt(0.5) - 0.01 <= ratio < 0.9, "priors hold a part that does not improve"
        sizes = [
            next(one.smallest_seen_rms_mm for one in source.effects if one.effect == "joint_compliance")
            for source in (forecast.arms[name], arm)
        ]
        assert sizes[0] is not None
        assert sizes[1] is not None
        assert sizes[1] < sizes[0]


def test_too_few_stops_are_told_and_the_rest_is_foreseen(tmp_path: Path) -> None:
    with new_planned_run(small_twin(5, plan={"method": "random"}), tmp_path / "run") as run:
        few = forecast_run(run)
    assert few.arms["left"].effects == ()
    assert few.arms["left"].accuracy
    assert any("arm 'left': 5 stops are too few" in note for note in few.notes)


def test_an_unknown_smr_offset_is_assumed_and_said(tmp_path: Path) -> None:
    profile = small_twin(STOPS, plan={"method": "random"})
    smr = profile.arms["left"].smr.model_copy(update={"offset": "unknown"})
    arms = {**profile.arms, "left": profile.arms["left"].model_copy(update={"smr": smr})}
    with new_planned_run(profile.model_copy(update={"arms": arms}), tmp_path / "run") as run:
        result = forecast_run(run)
    assert any("smr.offset is unknown" in note for note in result.notes)
    assert result.arms["left"].accuracy[0].standard_error_mm < 1.0


@pytest.mark.parametrize("kind", ["paper", "full"])
def test_other_parameter_sets_have_finite_errors(kind: str, planned: Path, tmp_path: Path) -> None:
    with RunFile.open(planned) as run:
        plan, profile = run.read_plan(), run.profile
    calibration = profile.calibration.model_copy(update={"parameter_set": kind})
    with with_plan(tmp_path / "run", profile.model_copy(update={"calibration": calibration}), **plan) as run:
        result = forecast_run(run)
    errors = [one.standard_error for one in result.arms["left"].accuracy[0].parameters.values()]
    assert len(errors) == {"paper": 26, "full": 34}[kind]
    assert all(error is not None and 0.0 < error < 1.0 for error in errors)
