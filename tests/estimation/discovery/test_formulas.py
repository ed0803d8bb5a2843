"""Short formulas: the one that a curve was made from is among them, and those that do not vary are left out."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.discovery.accepted import formulas
from cellapp.robot.effects.data_driven import Quantity, Variable

Q1, Q2, Q3 = (Variable(Quantity.JOINT_ANGLE, joint) for joint in range(3))


def explained(values: np.ndarray, y: np.ndarray) -> float:
    fitted = values @ np.linalg.lstsq(values, y, rcond=None)[0]
    return 1.0 - float(np.sum((y - fitted) ** 2) / np.sum(y**2))


@pytest.mark.parametrize(
    ("variables", "shape", "text"),
    [
        ((Q2,), lambda x, y: 3.0 * np.sin(2.0 * x + 0.4), "c sin(2 q2 + phase)"),
        ((Variable(Quantity.TORQUE, 2),), lambda x, y: 0.2 * np.abs(x), "c |torque3|"),
        ((Q1, Q3), lambda x, y: np.sin(x - y), "c sin(q1 - q3 + phase)"),
        ((Q1, Q3), lambda x, y: np.sin(x) * np.cos(y), "c sin(q1) cos(q3)"),
    ],
)
def test_the_formula_that_made_a_curve_explains_all_of_it(variables, shape, text) -> None:
    x, y = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 200))
    found = formulas(variables, [x, y][: len(variables)])
    best = max(found, key=lambda one: explained(one.values, shape(x, y)))
    assert best.text == text
    assert explained(best.values, shape(x, y)) == pytest.approx(1.0)


def test_an_oscillation_in_time_has_its_period() -> None:
    t = np.linspace(0.0, 6000.0, 300)
    best = max(
        formulas([Variable(Quantity.TIME)], [t]),
        key=lambda one: explained(one.values, np.sin(2.0 * np.pi * t / 1200.0)),
    )
    assert best.text == "c sin(2 pi time / 20 min + phase)"


def test_a_constant_variable_has_no_formula() -> None:
    assert formulas([Variable(Quantity.PAYLOAD)], [np.zeros(5)]) == []
