"""A plan before it is measured: the gate again, covered ranges, time, and what the stops can show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.candidates import CandidatePool, sample_pool
from cellapp.cell.planning.designed_plan import select_stops
from cellapp.cell.planning.information import InformationModel, information_model, sampled_conditions
from cellapp.cell.planning.planned_stops import planned_time, read_planned_stops
from cellapp.cell.planning.records import PlanForecastResult
from cellapp.cell.planning.sweeps import SweepDesign
from cellapp.cell.planning.view import check_plan_run, forecast_run
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import visible
from cellapp.commands.plan.check_view import check_sentences, forecast_sentences, forecast_tables
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, JobToken
from cellapp.robot.paths.joint_path import Sweep
from tests.sure import sure
from tests.twin import PROFILES, altered, small_twin, with_arm, with_arms

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

    with new_planned_run(small_twin(4, plan={"method": "random"}), tmp_path / "run") as run:
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
    token = JobToken()
    token.cancel()
    with RunFile.open(planned) as run:
        for foresee in (check_plan_run, forecast_run):
            with pytest.raises(Cancelled):
                foresee(run, token)
    with RunFile.create(tmp_path / "imported", small_twin()) as run:
        for foresee in (check_plan_run, forecast_run):
            with pytest.raises(InputError, match="the run has no plan"):
                foresee(run)


def test_the_estimated_time_is_that_of_a_simulated_collection(tmp_path: Path) -> None:
    profile = small_twin(12)
    with new_planned_run(profile, tmp_path / "run") as run:
        estimated = planned_time(profile, read_planned_stops(run))
        collect_run(run)
        taken_s = float(run.readings("right").time_s.max())
    parts = (estimated.moving_s, estimated.resting_s, estimated.measuring_s, estimated.references_s)
    assert estimated.total_s == pytest.approx(sum(parts))
    assert taken_s == pytest.approx(estimated.total_s, rel=0.25)


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
        assert 0.0 < sure(backlash.smallest_seen_rms_mm) < sure(backlash.with_scatter_rms_mm)
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
        assert sure(sizes[1]) < sure(sizes[0])


def test_too_few_stops_are_told_and_the_rest_is_foreseen(tmp_path: Path) -> None:
    with new_planned_run(small_twin(5, plan={"method": "random"}), tmp_path / "run") as run:
        few = forecast_run(run)
    assert few.arms["left"].effects == ()
    assert few.arms["left"].accuracy
    assert any("arm 'left': 5 stops are too few" in note for note in few.notes)


def test_an_unknown_smr_offset_is_assumed_and_said(tmp_path: Path) -> None:
    profile = with_arm(small_twin(STOPS, plan={"method": "random"}), "left", smr={"offset": "unknown"})
    with new_planned_run(profile, tmp_path / "run") as run:
        result = forecast_run(run)
    assert any("smr.offset is unknown" in note for note in result.notes)
    assert result.arms["left"].accuracy[0].standard_error_mm < 1.0


def test_what_a_sweep_tells_is_of_the_effects_that_the_plan_is_for():
    """A joint that turns far and evenly tells of its lines; one that hardly moves tells nothing of them."""
    profile = small_twin()
    q = np.array(profile.arms["left"].home) + np.random.default_rng(3).uniform(-0.5, 0.5, (12, 6))
    rows = np.zeros((4, 6))
    still, lively = rows.copy(), rows.copy()
    still[0, 5] = 0.3
    lively[:, 0] = 0.3
    told = {}
    for slugs in ((), ("transmission_error",), ("transmission_error", "backlash")):
        design = SweepDesign.of(altered(profile, plan={"effects": slugs}), "left", q, np.ones_like(q))
        before = design.information
        assert np.isfinite(before).all()
        gains = [
            np.linalg.slogdet(before + design.told(Sweep(q[0], sine, rows, 20.0)))[1] - np.linalg.slogdet(before)[1]
            for sine in (still, lively)
        ]
        told[slugs] = gains[1] - gains[0]
        assert gains[1] > gains[0] > 0.0
    assert told[()] < told["transmission_error",] < told["transmission_error", "backlash"]


# -- The choice of stops -----------------------------------------------------------------------------------------------


COUNT, POOL = 40, 800
FEW: dict[str, Any] = {"effects": ("joint_compliance", "encoder_eccentricity", "backlash")}
Pools = Mapping[str, CandidatePool]


def drawn(profile: Profile, count: int = POOL) -> Pools:
    cell, rng = cell_bodies(profile), np.random.default_rng(3)
    return {name: sample_pool(cell, profile, name, count, rng) for name in cell.arms}


@pytest.fixture(scope="module")
def twin() -> Profile:
    return small_twin(COUNT, plan=FEW)


@pytest.fixture(scope="module")
def pools(twin: Profile) -> Pools:
    return drawn(twin)


@pytest.fixture(scope="module")
def chosen(twin: Profile, pools: Pools) -> Mapping[str, np.ndarray]:
    return select_stops(twin, pools, COUNT, np.random.default_rng(1))


def model_of(profile: Profile, pools: Pools, name: str = "left") -> InformationModel:
    q = {arm: pool.q for arm, pool in pools.items()}
    conditions = sampled_conditions(profile, name, q[name], q, np.random.default_rng(0))
    return information_model(profile, name, pools[name].q, conditions)


def test_each_stop_is_chosen_once_and_the_seed_decides(
    twin: Profile, pools: Pools, chosen: Mapping[str, np.ndarray]
) -> None:
    again = select_stops(twin, pools, COUNT, np.random.default_rng(1))
    for name, q in chosen.items():
        assert len(np.unique(q, axis=0)) == COUNT
        assert not set(map(tuple, q)) <= set(map(tuple, pools[name].q))  # some are near candidates instead
        assert visible(cell_bodies(twin), name, q).all()
        np.testing.assert_array_equal(again[name], q)


def test_a_pool_may_be_smaller_than_the_plan(twin: Profile, pools: Pools) -> None:
    few = {name: replace(pool, q=pool.q[:12]) for name, pool in pools.items()}
    for name, q in select_stops(twin, few, COUNT, np.random.default_rng(1)).items():
        np.testing.assert_array_equal(np.unique(q, axis=0), np.unique(few[name].q, axis=0))
    assert not len(select_stops(twin, few, 0, np.random.default_rng(1))["left"])


TWIN = small_twin(20)
LEFT = TWIN.arms["left"]
CELLS = {
    "one arm": TWIN.model_copy(update={"arms": {"left": LEFT}}),
    "three arms": TWIN.model_copy(update={"arms": {**TWIN.arms, "third": LEFT}}),
    "seven joints": altered(load_profile(PROFILES / "twin-foreign.yaml"), plan={"stops": 20}),
    "without offset": with_arms(TWIN, smr=altered(LEFT.smr, offset="unknown")),
    "straight ways": small_twin(20, plan={"steps": ()}),
}


@pytest.mark.parametrize("cell", CELLS)
def test_any_cell_can_be_designed(cell: str) -> None:
    profile = CELLS[cell]
    pools = drawn(profile, 120)
    chosen = select_stops(profile, pools, 20, np.random.default_rng(1))
    assert {name: len(np.unique(q, axis=0)) for name, q in chosen.items()} == dict.fromkeys(profile.arms, 20)
    coupled = any(part.slug == "pedestal_coupling" for part in model_of(profile, pools, next(iter(pools))).parts)
    assert coupled == (len(profile.arms) == 2)


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        (("backlsh",), "'backlsh' is no effect of the library; known are: joint_compliance,"),
        (("unknown",), "'unknown' is no effect of the library"),
        (("payload_compliance",), "no plan of this cell can show it in arm left"),
    ],
)
def test_effects_that_no_plan_can_show_are_refused(pools: Pools, effects: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError, match=r"plan\.effects") as refused:
        select_stops(small_twin(COUNT, plan={"effects": effects}), pools, COUNT, np.random.default_rng(0))
    assert words in str(refused.value)
