"""Stops, speed slider and foreign programs of the emulated controller, with time in the hand of the test."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from drivers.emulators.ur_controller import Braking
from drivers.emulators.ur_controller.controller import Runtime
from drivers.emulators.ur_controller.dashboard import answer
from drivers.emulators.ur_controller.script import ForeignProgram
from tests.drivers.emulators.test_ur_controller_state import MOVE, STOP_JOINTS, Bench, goal

UR10_SPEED = math.radians(120.0)


def moving_bench(rate: float = 1.0, **changes: Any) -> Bench:
    """An arm in the middle of a long motion at a constant speed of its first joint."""
    bench = Bench("e-Series", **changes)
    bench.start_script()
    bench.command(MOVE, (*goal(bench, j1=4.0), rate, 8.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.5)
    return bench


def test_a_ur10_at_full_speed_takes_half_a_second_to_stop() -> None:
    bench = moving_bench(UR10_SPEED, speed=(UR10_SPEED,) * 6)
    received_s = bench.now_s
    assert answer(bench.controller, "stop") == "Stopped"
    took = bench.until(lambda: not bench.controller.moving)
    assert took == pytest.approx(0.5 + 0.02, abs=3 * bench.controller.period_s)
    (record,) = bench.controller.brakes.records
    assert (record.kind, record.received_s) == ("program", received_s)
    assert record.ideal_s == pytest.approx(0.5)
    assert record.began_s is not None
    assert record.rest_s is not None
    assert record.began_s - received_s == pytest.approx(0.02, abs=2 * bench.controller.period_s)
    assert record.rest_s - record.began_s == pytest.approx(0.5, abs=2 * bench.controller.period_s)


def test_braking_follows_the_path() -> None:
    bench = Bench()
    bench.start_script()
    target, start = np.array(goal(bench, j1=4.0, j2=-2.0, j5=1.0)), np.array(bench.config.home)
    bench.command(MOVE, (*target, 1.0, 8.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 0.5)
    bench.controller.stop_program()
    bench.until(lambda: not bench.controller.moving)
    share = (np.array(bench.controller.q) - start)[[0, 1, 4]] / (target - start)[[0, 1, 4]]
    assert np.ptp(share) < 1e-12


@pytest.mark.parametrize(("stated", "acts"), [(2.0, 2.0), (100.0, 10.0)], ids=["stated", "more than the joints can"])
def test_stopj_brakes_at_its_stated_deceleration(stated: float, acts: float) -> None:
    bench = moving_bench()
    bench.command(STOP_JOINTS, (stated,))
    record = bench.controller.brakes.records[-1]
    assert record.kind == "stopj"
    assert record.began_s is not None
    assert record.rest_s is not None
    assert record.rest_s - record.began_s == pytest.approx(1.0 / acts, abs=2 * bench.controller.period_s)


def test_a_harder_stop_takes_the_place_of_a_gentler_one() -> None:
    bench = moving_bench()
    bench.write(STOP_JOINTS, (0.5,), argument=1)
    bench.cycles(50)
    assert bench.controller.moving
    bench.controller.emergency_stop()
    assert bench.until(lambda: not bench.controller.moving) < 0.25
    assert [record.kind for record in bench.controller.brakes.records] == ["stopj"], "one braking, one record"


def test_a_stop_at_rest_needs_no_time() -> None:
    bench = Bench()
    bench.start_script()
    bench.controller.stop_program()
    (record,) = bench.controller.brakes.records
    assert (record.ideal_s, record.rest_s) == (0.0, record.received_s)


def test_a_faster_cell_brakes_faster_by_the_wall() -> None:
    bench = Bench(pace=5.0, braking=Braking(full_speed_s=1.0))
    bench.start_script()
    bench.command(MOVE, (*goal(bench, j1=4.0), math.pi, 9.0), argument=1)
    bench.until(lambda: bench.controller.q[0] > 1.0)
    bench.controller.stop_program()
    took = bench.until(lambda: not bench.controller.moving)
    assert took == pytest.approx(1.02 / 5.0, abs=0.2 / 5.0 + 4 * bench.controller.period_s)


# -- speed slider ------------------------------------------------------------------------------------------------------


def write_slider(bench: Bench, fraction: float) -> None:
    bench.controller.write_input("speed_slider_mask", (1,))
    bench.controller.write_input("speed_slider_fraction", (fraction,))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_slider_value_that_is_no_number_is_refused_and_logged(value: float) -> None:
    bench = Bench()
    write_slider(bench, 0.5)
    write_slider(bench, value)
    assert bench.controller.values["target_speed_fraction"] == (0.5,)
    assert "speed slider" in bench.controller.log[-1]
    bench.start_script()
    bench.command(MOVE, (*goal(bench, j1=0.2), 1.0, 2.0))
    assert bench.controller.q == goal(bench, j1=0.2)


def test_the_slider_scales_a_motion_in_progress_and_at_zero_the_arm_stands() -> None:
    bench = moving_bench()
    bench.controller.set_slider(0.0)
    bench.cycles(int(0.6 / bench.controller.period_s))
    stands = bench.controller.q
    assert bench.controller.at_rest
    assert bench.controller.moving, "its motion is not over"
    assert bench.controller.runtime is Runtime.PLAYING
    assert bench.controller.values["speed_scaling"] == (0.0,)
    assert bench.controller.values["actual_qd"] == (0.0,) * 6
    bench.cycles(500)
    assert bench.controller.q == stands
    bench.controller.set_slider(0.25)
    bench.cycles(int(0.6 / bench.controller.period_s))
    assert bench.controller.values["target_speed_fraction"] == bench.controller.values["speed_scaling"] == (0.25,)
    assert bench.controller.values["actual_qd"][0] == pytest.approx(0.25)
    bench.controller.set_slider(1.0)
    bench.until(lambda: not bench.controller.moving)
    assert bench.controller.values["actual_q"] == goal(bench, j1=4.0)


def test_a_slow_motion_takes_its_time_divided_by_the_slider() -> None:
    bench = Bench()
    bench.controller.set_slider(0.5)
    bench.cycles(int(0.6 / bench.controller.period_s))
    bench.start_script()
    took = bench.command(MOVE, (*goal(bench, j1=0.5), 1.0, 2.0))
    assert took == pytest.approx((0.5 / 1.0 + 1.0 / 2.0) / 0.5, abs=5 * bench.controller.period_s)


def test_an_arm_that_stands_at_slider_zero_can_be_stopped() -> None:
    bench = moving_bench()
    bench.controller.set_slider(0.0)
    bench.cycles(int(0.6 / bench.controller.period_s))
    stands = bench.controller.q
    bench.controller.stop_program()
    bench.until(lambda: bench.controller.runtime is Runtime.STOPPED)
    bench.controller.set_slider(1.0)
    bench.cycles(200)
    assert bench.controller.q == stands


def test_a_slider_moved_to_zero_while_the_arm_brakes_does_not_prolong_the_stop() -> None:
    bench = moving_bench()
    bench.controller.stop_program()
    bench.cycles(20)
    bench.controller.set_slider(0.0)
    assert bench.until(lambda: bench.controller.runtime is Runtime.STOPPED) < 0.2
    bench.cycles(300)
    stands = bench.controller.q
    bench.controller.set_slider(1.0)
    bench.cycles(300)
    assert bench.controller.q == stands


# -- programs of others ------------------------------------------------------------------------------------------------


def test_the_dashboard_names_a_program_that_a_person_started() -> None:
    bench = Bench()
    bench.controller.start_locally(ForeignProgram())
    assert answer(bench.controller, "programState") == "PLAYING palletizing.urp"
    assert answer(bench.controller, "get loaded program") == "Loaded program: /programs/palletizing.urp"
    bench.controller.pause_program()
    bench.cycles(2)
    assert bench.controller.runtime is Runtime.PAUSED
    assert answer(bench.controller, "programState") == "PAUSED palletizing.urp"
    with pytest.raises(ValueError, match="no program can start"):
        bench.controller.start_locally(ForeignProgram())
    assert answer(bench.controller, "stop") == "Stopped"
    bench.until(lambda: bench.controller.runtime is Runtime.STOPPED)
