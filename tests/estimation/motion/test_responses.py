"""Answers of joints to the course of a motion, against differential equations that are solved step by step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellapp.estimation.motion.joint_path import BEND_S, joint_path
from cellapp.estimation.motion.streams import JointStream

U = np.linspace(0.5, 9.5, 60)


def position(t):
    return 0.3 * np.sin(1.3 * t + 0.4) + 0.1 * np.cos(3.0 * t)


def speed(t):
    return 0.39 * np.cos(1.3 * t + 0.4) - 0.3 * np.sin(3.0 * t)


def acceleration(t):
    return (position(t + BEND_S) - 2.0 * position(t) + position(t - BEND_S)) / BEND_S**2


@pytest.fixture(scope="module")
def even():
    t = np.arange(0.0, 10.0, 0.008)
    q, qd = (np.repeat(f(t)[:, None], 2, axis=1) for f in (position, speed))
    return joint_path(JointStream(time_s=t, q=q, qd=qd)).even


def test_a_time_constant_is_a_first_order_lag(even):
    T = 0.03
    start = [position(0.0) - T * speed(0.0)]
    solved = solve_ivp(lambda t, x: (position(t) - x) / T, (0.0, 9.9), start, dense_output=True, rtol=1e-9, atol=1e-12)
    late, by_T = (even.at(one, U) for one in even.lagging(0, T))
    np.testing.assert_allclose(late, solved.sol(U)[0] - position(U), atol=1e-6)
    more, less = (even.at(even.lagging(0, T + step)[0], U) for step in (1e-4, -1e-4))
    np.testing.assert_allclose(by_T, (more - less) / 2e-4, atol=1e-3)


def test_vibration_is_what_a_damped_spring_adds_to_its_slow_deflection(even):
    hz, damping = 9.0, 0.05
    w = 2.0 * np.pi * hz

    def moved(t, x):
        return [
            x[1],
            -w * w * (-0.507 * np.sin(1.3 * t + 0.4) - 0.9 * np.cos(3.0 * t)) - 2 * damping * w * x[1] - w * w * x[0],
        ]

    start = [-acceleration(0.0), 0.0]
    solved = solve_ivp(moved, (0.0, 9.9), start, dense_output=True, rtol=1e-8, atol=1e-9, max_step=0.01)
    late = U[U > 3.0]  # what began otherwise has died away
    found = even.at(even.of_shape(0, hz, damping, 0), late)
    np.testing.assert_allclose(found, solved.sol(late)[0] + acceleration(late), atol=2e-3)
    for part, step in ((1, (0.01, 0.0)), (2, (0.0, 1e-3))):
        more = even.of_shape(0, hz + step[0], damping + step[1], 0)
        less = even.of_shape(0, hz - step[0], damping - step[1], 0)
        slope = (more - less) / (2.0 * sum(step))
        assert np.abs(even.of_shape(0, hz, damping, part) - slope).max() < 0.05 * np.abs(slope).max()
