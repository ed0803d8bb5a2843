"""Stops that tell most: more than random ones on unseen points, phases covered, for any cell; what they tell."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.planning.candidates import CandidatePool, draw_pool
from cellapp.cell.planning.designed import arm_design, select_stops
from cellapp.cell.planning.information import (
    EXPECTED_EFFECT_M,
    POTENTIAL_CYCLES,
    InformationModel,
    drawn_conditions,
    even_conditions,
    information_model,
)
from cellapp.cell.planning.records import ArmDesign
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.design.block_design import gap_limits, largest_gaps
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, CancelToken
from tests.twin import PROFILES, small_twin, with_arms

COUNT, POOL = 40, 800
FEW: dict[str, Any] = {"effects": ("joint_compliance", "encoder_eccentricity", "backlash")}
Pools = Mapping[str, CandidatePool]


def drawn(profile: Profile, count: int = POOL) -> Pools:
    cell, rng = cell_bodies(profile), np.random.default_rng(3)
    return {name: draw_pool(cell, profile, name, count, rng) for name in cell.arms}


@pytest.fixture(scope="module")
def twin() -> Profile:
    return small_twin(COUNT, plan=FEW)


@pytest.fixture(scope="module")
def pools(twin: Profile) -> Pools:
    return drawn(twin)


@pytest.fixture(scope="module")
def chosen(twin: Profile, pools: Pools) -> Mapping[str, np.ndarray]:
    return select_stops(twin, pools, COUNT, np.random.default_rng(1))


@pytest.fixture(scope="module")
def judged(twin: Profile, pools: Pools, chosen: Mapping[str, np.ndarray]) -> ArmDesign:
    stops = {name: pools[name].q[rows] for name, rows in chosen.items()}
    return arm_design(twin, pools["left"], "left", stops, np.random.default_rng(2))


def model_of(profile: Profile, pools: Pools, name: str = "left") -> InformationModel:
    others = {other: pool.q for other, pool in pools.items() if other != name}
    conditions = drawn_conditions(profile, name, pools[name].q, others, np.random.default_rng(0))
    return information_model(profile, name, pools[name].q, conditions)


def test_each_stop_is_chosen_once_and_the_seed_decides(
    twin: Profile, pools: Pools, chosen: Mapping[str, np.ndarray]
) -> None:
    again = select_stops(twin, pools, COUNT, np.random.default_rng(1))
    for name, rows in chosen.items():
        assert len(set(rows.tolist())) == COUNT
        np.testing.assert_array_equal(again[name], rows)


def test_designed_stops_tell_more_than_random_ones_on_unseen_points(judged: ArmDesign) -> None:
    designed, random = judged.designed, judged.random
    assert random.parameters == pytest.approx(1.0)
    assert designed.parameters < 0.95
    assert designed.mean_mm < 0.95 * random.mean_mm
    assert designed.worst_mm < 0.85 * random.worst_mm
    assert all(number > 1.1 * COUNT for number in judged.equal_to_random.values())
    assert designed.indices.o1 > random.indices.o1
    assert designed.indices.o5 > random.indices.o5


def test_errors_by_number_of_stops_fall(judged: ArmDesign) -> None:
    assert [one.stops for one in judged.by_stops] == [25, COUNT]
    assert judged.by_stops[0].mean_mm > judged.by_stops[1].mean_mm
    assert judged.by_stops[1] == judged.designed
    assert ArmDesign.model_validate_json(judged.model_dump_json()) == judged


def test_no_phase_of_a_joint_is_left_out(pools: Pools, chosen: Mapping[str, np.ndarray]) -> None:
    for name, rows in chosen.items():
        q = pools[name].q
        gaps = largest_gaps(q[rows])
        limits, unreachable = gap_limits(q, COUNT, None), largest_gaps(q)
        parts_without = unreachable > limits
        assert np.all(gaps <= np.where(parts_without, unreachable + limits, limits))


def test_the_largest_gap_of_the_profile_holds(pools: Pools) -> None:
    limit = math.radians(20.0)
    strict = small_twin(60, plan={**FEW, "largest_gap": limit})
    q = pools["left"].q
    rows = select_stops(strict, {"left": pools["left"]}, 60, np.random.default_rng(1))["left"]
    reachable = largest_gaps(q) < limit
    assert np.all(largest_gaps(q[rows])[reachable] <= limit)


def test_kept_stops_count(twin: Profile, pools: Pools) -> None:
    """Beside stops at which the third joint is bent one way, the others are chosen from the other side."""
    q = pools["left"].q
    one_way = np.flatnonzero(q[:, 2] > 0.5)[:200]
    only = {"left": pools["left"]}
    free = select_stops(twin, only, 10, np.random.default_rng(1))["left"]
    beside = select_stops(twin, only, 10, np.random.default_rng(1), kept={"left": q[one_way]})["left"]
    assert np.mean(q[beside, 2] > 0.5) < np.mean(q[free, 2] > 0.5)


def test_a_pool_may_be_smaller_than_the_plan(twin: Profile, pools: Pools) -> None:
    few = {name: replace(pool, q=pool.q[:12], incidence=pool.incidence[:12]) for name, pool in pools.items()}
    rows = select_stops(twin, few, COUNT, np.random.default_rng(1))
    assert {name: sorted(found.tolist()) for name, found in rows.items()} == {name: list(range(12)) for name in few}
    assert not len(select_stops(twin, few, 0, np.random.default_rng(1))["left"])


def one_arm() -> Profile:
    profile = small_twin(20)
    return profile.model_copy(update={"arms": {"left": profile.arms["left"]}})


def three_arms() -> Profile:
    profile = small_twin(20)
    return profile.model_copy(update={"arms": {**profile.arms, "third": profile.arms["left"]}})


def seven_joints() -> Profile:
    profile = load_profile(PROFILES / "twin-foreign.yaml")
    return profile.model_copy(update={"plan": profile.plan.model_copy(update={"stops": 20})})


def without_offset() -> Profile:
    profile = small_twin(20)
    smr = profile.arms["left"].smr.model_copy(update={"offset": "unknown"})
    return with_arms(profile, smr=smr)


def straight_ways() -> Profile:
    return small_twin(20, plan={"steps": ()})


@pytest.mark.parametrize("cell", [one_arm, three_arms, seven_joints, without_offset, straight_ways])
def test_any_cell_can_be_designed(cell: Any) -> None:
    profile = cell()
    pools = drawn(profile, 120)
    rows = select_stops(profile, pools, 20, np.random.default_rng(1))
    assert {name: len(set(found.tolist())) for name, found in rows.items()} == dict.fromkeys(profile.arms, 20)
    coupled = any(one.startswith("pedestal_coupling") for one in model_of(profile, pools, next(iter(pools))).names)
    assert coupled == (len(profile.arms) == 2)


def test_the_columns_are_geometry_listed_effects_and_potential_terms(twin: Profile, pools: Pools) -> None:
    model = model_of(twin, pools)
    slugs = [name.split(": ")[0] for name in model.names[len(model.parameters.columns) :]]
    assert set(slugs[: model.wanted - len(model.parameters.columns)]) == set(FEW["effects"])
    assert model.potential == 2 * len(POTENTIAL_CYCLES) * 6
    everything = model_of(small_twin(COUNT), pools)
    assert {"joint_compliance", "base_step", "tracker_scale"} <= {name.split(": ")[0] for name in everything.names}
    assert not any(name.startswith(("unknown", "payload_compliance")) for name in everything.names)
    assert model_of(small_twin(COUNT, plan={"effects": ()}), pools).wanted == len(model.parameters.columns)


def test_rows_are_whitened_displacements_per_expected_size(twin: Profile, pools: Pools) -> None:
    model, q = model_of(twin, pools), pools["left"].q[:300]
    conditions = even_conditions(twin, "left", q, {"right": pools["right"].q}, np.random.default_rng(4))
    moved = model.prediction_rows(q, conditions)
    rms = np.sqrt(np.mean(np.sum(moved**2, axis=1), axis=0))
    effects = slice(len(model.parameters.columns), model.wanted)
    assert np.median(rms[effects]) == pytest.approx(EXPECTED_EFFECT_M, rel=0.05)
    assert rms[effects].max() < 1.3 * EXPECTED_EFFECT_M, "less where a coefficient would be beyond its bound"
    told, size = model.rows(q, conditions), np.linalg.norm(moved, axis=1)
    assert np.all(np.linalg.norm(told, axis=1) < size / 1e-4), "the scatter of the arm alone is 0.1 mm"
    assert np.all(np.linalg.norm(told, axis=1) > 0.9 * size / np.hypot(1e-4, 4e-5))


def test_oblique_stops_tell_less(twin: Profile, pools: Pools) -> None:
    q, plan = pools["left"].q[:200], twin.plan
    conditions = drawn_conditions(twin, "left", q, {}, np.random.default_rng(4))
    told = []
    for limit in (plan.incidence, math.radians(1.0)):
        profile = twin.model_copy(update={"plan": plan.model_copy(update={"incidence": limit})})
        told.append(np.linalg.norm(information_model(profile, "left", q, conditions).rows(q, conditions), axis=(1, 2)))
    assert np.all(told[1] <= told[0] * (1.0 + 1e-12))
    assert np.any(told[1] < 0.98 * told[0])


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


def test_a_selection_can_be_cancelled(twin: Profile, pools: Pools) -> None:
    token = CancelToken()
    token.cancel()
    with pytest.raises(Cancelled):
        select_stops(twin, pools, COUNT, np.random.default_rng(1), cancel=token)
