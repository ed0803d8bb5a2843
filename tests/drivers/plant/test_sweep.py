"""A sweep on record: the lag of the joints, play along the path, two clocks, samples and beams that are lost."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from drivers.plant import Plant
from drivers.plant.servo import LOOKAHEAD_S
from drivers.plant.sweep import Recorder, SweepRecord, record_sweep, recorder_of
from tests.twin import small_twin

CYCLE_S = 0.008
EXACT = Recorder(lost_samples=0.0, jitter_s=0.0, lost_beams_per_min=0.0)


def plant_with(effects: dict[str, dict[str, object]]) -> Plant:
    quiet = {"effects": {"left": effects, "right": {}}, "noise": False, "repeatability": 0.0}
    return build_plant(small_twin(plant=quiet))


def swing(plant: Plant, seconds: float = 8.0, joint: int = 0, reach: float = 0.2) -> np.ndarray:
    """Commands of one joint that swings forth and back twice, from rest to rest."""
    time_s = np.arange(0.0, seconds, CYCLE_S)
    q = np.repeat(plant.q("left")[None], len(time_s), axis=0)
    q[:, joint] += reach * np.sin(np.pi * time_s / seconds) ** 2 * np.sin(4.0 * np.pi * time_s / seconds)
    return q


def at_points(record: SweepRecord, recorder: Recorder) -> np.ndarray:
    """Joint positions at the times of the points, by the clocks as they are."""
    time_s = (record.point_time_s - recorder.offset_s) / (1.0 + 1e-6 * recorder.rate_ppm)
    return np.column_stack([np.interp(time_s, record.joint_time_s, column) for column in record.q.T])


def test_joints_lag_behind_their_commands_and_rest_at_both_ends() -> None:
    plant = plant_with({})
    commanded = swing(plant)
    record = record_sweep(plant, EXACT, "left", commanded, CYCLE_S)
    time_s = record.joint_time_s - record.joint_time_s[0]
    np.testing.assert_allclose(record.q[0], commanded[0], atol=1e-9)
    np.testing.assert_allclose(record.q[-1], commanded[-1], atol=1e-4)
    delays = np.arange(0.0, 0.1, 0.001)
    at = np.arange(len(commanded)) * CYCLE_S + 0.5
    misses = [np.abs(np.interp(time_s - d, at, commanded[:, 0]) - record.q[:, 0]).max() for d in delays]
    assert delays[int(np.argmin(misses))] == pytest.approx(LOOKAHEAD_S, abs=0.005)
    np.testing.assert_allclose(np.gradient(record.q[:, 0], time_s), record.qd[:, 0], atol=2e-3)


def test_points_are_those_of_the_arm_at_the_same_joints() -> None:
    plant = plant_with({"joint_compliance": {"stiffness": [9e4, 6e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]}})
    record = record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
    expected = plant.smr_positions("left", at_points(record, EXACT))
    np.testing.assert_allclose(record.p_M, expected, atol=2e-6)


def test_play_lags_behind_each_reversal_by_its_width() -> None:
    play = 2e-4
    plant = plant_with({"backlash": {"play": [play, 0.0, 0.0, 0.0, 0.0, 0.0]}})
    record = record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
    q = at_points(record, EXACT)
    signs = (np.tile([sign, 0, 0, 0, 0, 0], (len(q), 1)) for sign in (1, -1))
    forth, back = (plant.smr_positions("left", q, approach=sign) for sign in signs)
    loop = np.linalg.norm(forth - back, axis=1)
    speed = np.gradient(q[:, 0])
    crossed = np.convolve(np.abs(speed), np.ones(100), mode="same") > 3.0 * play
    for way, expected in ((speed > 2e-5, forth), (speed < -2e-5, back)):
        late = way & crossed & np.roll(way, 60) & np.roll(way, 30)
        assert late.sum() > 100
        assert np.abs(record.p_M[late] - expected[late]).max() < 0.1 * loop.max()


def test_clocks_differ_as_stated_and_losses_are_gaps() -> None:
    plant = plant_with({})
    recorder = Recorder(offset_s=12.0, rate_ppm=1000.0, lost_samples=0.1, lost_beams_per_min=60.0, seed=3)
    commanded = swing(plant)
    record = record_sweep(plant, recorder, "left", commanded, CYCLE_S)
    assert 0.05 < 1.0 - len(record.joint_time_s) / (9.0 * 125.0) < 0.2
    lost = np.isnan(record.p_M).any(axis=1)
    assert 0.0 < lost.mean() < 1.0
    np.testing.assert_allclose(np.diff(record.point_time_s), 1.001 / recorder.point_hz, rtol=1e-9)
    seen = ~lost
    expected = plant.smr_positions("left", at_points(record, recorder)[seen])
    np.testing.assert_allclose(record.p_M[seen], expected, atol=5e-5)
    assert recorder_of(plant) == recorder_of(plant_with({}))


def test_the_arm_ends_where_it_began_and_time_has_passed() -> None:
    plant = plant_with({})
    before, began_s = plant.q("left"), plant.clock_s
    record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
    np.testing.assert_allclose(plant.q("left"), before, atol=1e-4)
    assert plant.clock_s - began_s == pytest.approx(9.0, abs=0.01)
    assert plant.joint_temperatures_c("left")[0] > plant.joint_temperatures_c("left")[1]


def test_a_sweep_that_begins_elsewhere_or_meets_a_motion_is_refused() -> None:
    plant = plant_with({})
    with pytest.raises(ValueError, match="not where its sweep begins"):
        record_sweep(plant, EXACT, "left", swing(plant) + 0.1, CYCLE_S)
    plant.start_move("right", plant.q("right") + 0.1, np.ones(6), np.ones(6))
    with pytest.raises(ValueError, match="no other motion"):
        record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
