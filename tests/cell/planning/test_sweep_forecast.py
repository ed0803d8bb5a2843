"""What stops and sweeps are expected to tell of an arm before anything moves."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.driving.records import SweepCount
from cellapp.cell.planning.planned_stops import straight_stops
from cellapp.cell.planning.sweeps import PlannedSweep, SweepDesign, forecast_sweeps
from cellapp.commands.plan.check_view import sweep_sentences, sweep_tables
from cellapp.ground.errors import InputError
from cellapp.robot.paths.sweep import Sweep
from tests.twin import small_twin

SOURCES = ("stops", "sweeps", "both")


@pytest.fixture(scope="module")
def profile():
    return small_twin()


@pytest.fixture(scope="module")
def planned(profile):
    """Stops of both arms near home, and at half of them a sweep of the left arm: of all joints but the last."""
    rng = np.random.default_rng(3)
    home = {name: np.array(arm.home) for name, arm in profile.arms.items()}
    stops = straight_stops({name: q + rng.uniform(-0.5, 0.5, (12, 6)) for name, q in home.items()})
    still = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    sweeps = [
        PlannedSweep(
            arm="left",
            stop=stop,
            period_s=20.0,
            sine=tuple(map(tuple, (0.2 * still * rng.normal(size=(4, 6))).tolist())),
            cosine=tuple(map(tuple, (0.2 * still * rng.normal(size=(4, 6))).tolist())),
        )
        for stop in range(0, 12, 2)
    ]
    return stops, sweeps


def test_both_tell_more_than_either_and_more_sweeps_more_than_few(profile, planned):
    stops, sweeps = planned
    found = forecast_sweeps(profile, stops, sweeps)
    assert list(found) == ["left"], "the other arm does not sweep"
    errors = {source: found["left"].accuracy[source].standard_error_mm for source in SOURCES}
    assert errors["both"] < min(errors["stops"], errors["sweeps"])
    few = forecast_sweeps(profile, stops, sweeps[:2])["left"]
    assert few.accuracy["stops"] == found["left"].accuracy["stops"]
    assert few.accuracy["sweeps"].standard_error_mm > errors["sweeps"]
    for law, of_few in zip(found["left"].laws, few.laws, strict=True):
        for joint, size in law.smallest["sweeps"].items():
            least = of_few.smallest["sweeps"][joint]
            assert least is None or (size is not None and size <= least), (law.effect, joint)


def test_only_motion_shows_delays_and_dense_lines_and_only_of_joints_that_move(profile, planned):
    laws = {(law.effect, law.cycles): law.smallest for law in forecast_sweeps(profile, *planned)["left"].laws}
    for key in (("tracking_lag", 0), ("transmission_error", 40)):
        assert set(laws[key]["stops"].values()) == {None}
        assert laws[key]["sweeps"]["joint 1"] is not None
    assert laws["transmission_error", 2]["sweeps"]["joint 1"] is not None
    assert laws["tracking_lag", 0]["sweeps"]["joint 6"] is None, "it does not move"


def test_an_arm_whose_place_is_not_known_is_named(profile, planned):
    unknown = {**profile.arms, "left": profile.arms["left"].model_copy(update={"base": None})}
    with pytest.raises(InputError, match="base"):
        forecast_sweeps(profile.model_copy(update={"arms": unknown}), *planned)


def test_tables_have_every_source_and_the_sentences_say_what_they_rest_on(profile, planned):
    count = SweepCount(n=6, seconds=120.0, forecast=forecast_sweeps(profile, *planned)["left"])
    errors, laws = sweep_tables({"left": count, "right": SweepCount(n=1, seconds=20.0)})
    assert [column.title for column in errors.columns[1:4]] == list(SOURCES)
    assert {row[0] for row in laws.rows} >= {"tracking lag"}
    assert len({row[0] for row in laws.rows}) == len(laws.rows) == 6
    said = " ".join(sweep_sentences({"left": count}))
    assert "arm left: 6 sweeps about its stops, 2.0 min" in said
    assert "half second" in said
    assert sweep_sentences(None) == []
    assert sweep_tables(None) == []


def test_what_a_sweep_tells_is_of_the_effects_that_the_plan_is_for(profile, planned):
    """A joint that turns far and evenly tells of its lines; one that hardly moves tells nothing of them."""
    stops, _ = planned
    q = stops.q["left"]
    rows = np.zeros((4, 6))
    still, lively = rows.copy(), rows.copy()
    still[0, 5] = 0.3
    lively[:, 0] = 0.3
    told = {}
    for slugs in ((), ("transmission_error",), ("transmission_error", "backlash")):
        plan = profile.plan.model_copy(update={"effects": slugs})
        design = SweepDesign.of(profile.model_copy(update={"plan": plan}), "left")
        before = design.before(q, np.ones_like(q))
        assert np.isfinite(before).all()
        gains = [
            np.linalg.slogdet(before + design.told(Sweep(q[0], sine, rows, 20.0)))[1] - np.linalg.slogdet(before)[1]
            for sine in (still, lively)
        ]
        told[slugs] = gains[1] - gains[0]
        assert gains[1] > gains[0] > 0.0
    assert told[()] < told["transmission_error",] < told["transmission_error", "backlash"]
