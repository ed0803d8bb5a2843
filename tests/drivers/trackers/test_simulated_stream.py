"""The stream of the simulated tracker: packets, its own clock, late arrivals, lost beams, saturation and triggers."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arms.simulated import CYCLE_S, SimulatedArm
from drivers.trackers.imperfections import Imperfections
from drivers.trackers.protocol import PACKETS_HZ, Packet, TargetLost, Track, TrackerError, stream_of
from drivers.trackers.simulated import SimulatedTracker

pytestmark = pytest.mark.fast

INTERVAL_S = 0.004
WAY = np.array([0.2, 0.1, -0.1, 0.1, 0.1, -0.2])
CLOCK = Imperfections(clock_offset_s=512.0, clock_rate=20e-6, packet_jitter_s=0.04)


@pytest.fixture
def plant(make_arm, make_plant):
    return make_plant(make_arm(effects={"backlash": {"play": [2e-4] * 6}}), make_arm("ur5", "right", 1.2), noise=False)


def swung(plant, errors=CLOCK, there_s=2.0):
    """A track of the left arm, which moves there and back; packets, the errors that ended it, the true motion."""
    tracker, arm = SimulatedTracker(plant, errors), SimulatedArm(plant, "left")
    tracker.connect()
    arm.connect()
    packets: list[Packet] = []
    lost: list[TrackerError] = []
    tracker.start_track(plant.targets()[0].p_M, INTERVAL_S, lost.append, packets.append)
    x = np.linspace(0.0, 1.0, round(there_s / CYCLE_S) + 1)[:, None]
    there = plant.q("left") + x**3 * (10.0 - x * (15.0 - 6.0 * x)) * WAY
    arm.start_path(np.concatenate([there, there[::-1]]), CYCLE_S)
    seen = []
    for _ in range(round((2.0 * there_s + 0.5) / CYCLE_S)):
        plant.advance(CYCLE_S)
        seen.append((plant.clock_s, plant.targets()[0].p_M))
    return tracker, tracker.end_track(), packets, lost, seen


def test_points_are_those_of_the_moving_arm_at_their_own_stamps(plant):
    tracker, track, _, lost, seen = swung(plant)
    assert stream_of(tracker) is tracker
    assert lost == []
    np.testing.assert_allclose(np.diff(track.device_time_s), INTERVAL_S * (1.0 + 20e-6), rtol=1e-6)
    at_s = (track.device_time_s - CLOCK.clock_offset_s) / (1.0 + CLOCK.clock_rate)
    times = np.array([time_s for time_s, _ in seen])
    wanted = np.column_stack([np.interp(at_s, times, column) for column in np.array([p for _, p in seen]).T])
    inside = (at_s > times[0]) & (at_s < times[-1])
    # interpolation errs by a h^2 / 8; the play of six joints, 0.2 mm and more, is crossed at the reversal, no earlier
    off = np.linalg.norm(track.p_M - wanted, axis=1)[inside]
    assert np.quantile(off, 0.99) < 1e-5
    assert (off > 2e-5).sum() <= 6
    assert np.isfinite(track.sigma_m).all()


def test_packets_come_late_and_at_most_fifty_a_second(plant):
    _, track, packets, _, _ = swung(plant)
    assert len(packets) / np.ptp(track.device_time_s) <= PACKETS_HZ * 1.05
    assert max(len(packet.p_M) for packet in packets) >= 5
    at_s = (track.device_time_s - CLOCK.clock_offset_s) / (1.0 + CLOCK.clock_rate)
    late = track.arrived_s - at_s
    assert late.min() >= -1e-9
    assert late.max() > 0.03
    # the shortest delay is known to some milliseconds, and no better
    assert 0.0 <= np.mean(track.time_s - at_s) < 5e-3


@pytest.mark.slow
def test_a_slow_receiver_loses_points_and_they_are_counted(plant):
    _, track, _, _, _ = swung(plant, Imperfections(saturated=0.2))
    whole = round(np.ptp(track.device_time_s) / INTERVAL_S) + 1
    assert track.missing(INTERVAL_S) == whole - len(track.p_M)
    assert 0.05 * whole < track.missing(INTERVAL_S) < 0.4 * whole


def test_a_lost_beam_ends_the_track_and_can_be_locked_again(plant):
    tracker, track, _, lost, _ = swung(plant, Imperfections(lost_beams_per_min=60.0, longest_loss_s=0.2))
    assert [type(error) for error in lost] == [TargetLost]
    assert 0 < len(track.p_M) < 4.5 / INTERVAL_S
    plant.advance(0.2)
    tracker.start_track(plant.targets()[0].p_M, 0.02, lost.append)
    assert len(tracker.end_track().p_M) >= 1


def test_pulses_are_stamped_by_the_trackers_clock(plant):
    tracker = SimulatedTracker(plant, CLOCK)
    tracker.connect()
    tracker.start_track(plant.targets()[0].p_M, INTERVAL_S, lambda error: None)
    pulses = []
    for _ in range(3):
        plant.advance(0.05)
        tracker.trigger()
        pulses.append(plant.clock_s)
    track = tracker.end_track()
    np.testing.assert_allclose(track.triggers_s, CLOCK.own_time_s(np.array(pulses)), atol=1e-5)


def test_another_measurement_ends_a_track_and_intervals_are_checked(plant):
    tracker = SimulatedTracker(plant)
    tracker.connect()
    p_M = plant.targets()[0].p_M
    for wrong in (1e-4, 2.0, np.nan):
        with pytest.raises(ValueError, match=r"measures one each 0\.001 to 1 s"):
            tracker.start_track(p_M, wrong, lambda error: None)
    tracker.start_track(p_M, INTERVAL_S, lambda error: None)
    tracker.measure(p_M, 0.1)
    assert len(tracker.end_track().p_M) == 0


def test_no_packets_are_an_empty_track():
    track = Track.of([])
    assert (len(track.time_s), track.p_M.shape, track.missing(0.01)) == (0, (0, 3), 0)
