"""Figures: whatever the numbers, they can be drawn, in the colours of the page."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cellapp.reporting import cell_figures, figures
from cellapp.reporting.charts_discovery import is_line
from cellapp.results import Picture
from tests.reporting.cases import picture

pytestmark = pytest.mark.fast


def cloud_or_line(x: np.ndarray, y: np.ndarray) -> Picture:
    values = tuple(y.tolist())
    return Picture(title="", effect="", x_label="", y_label="", x=tuple(x.tolist()), measured=values, computed=values)


def test_a_line_is_drawn_through_a_function_and_none_through_a_cloud() -> None:
    x = np.linspace(0.0, 5.0, 200)
    rng = np.random.default_rng(0)
    for function in (np.sin(12.0 * x), np.sign(x - 2.0), x**2, np.ones(200)):
        assert is_line(cloud_or_line(x, function))
    for cloud in (rng.uniform(0.0, 1.0, 200), x * rng.uniform(0.5, 1.0, 200)):
        assert not is_line(cloud_or_line(x, cloud))
    assert is_line(picture("transmission_error", 1, curve=True))


def test_steps_are_drawn_against_the_floor() -> None:
    with_floor = figures.steps_figure("a", np.array([0.5, 0.1, 0.03]), 0.02)
    without = figures.steps_figure("a", np.array([0.5, 0.1, 0.03]), None)
    assert with_floor.count("stroke-dasharray") == without.count("stroke-dasharray") + 1
    assert "<path" in figures.steps_figure("a", np.array([0.5]), None)
    assert "<path" in figures.certainty_figure("a", np.array([0.1, 0.2]), np.array([0.0, 0.3]))


def test_arrows_have_a_round_scale() -> None:
    vectors = np.array([[3.0e-4, 0.0, 0.0]] * 9 + [[0.0, 9.0e-4, 0.0]])
    assert figures.scale_length_mm(vectors) == pytest.approx(0.2)
    assert figures.scale_length_mm(np.zeros((2, 3))) > 0.0
    assert "0.2 mm" in figures.vector_figure("a", np.eye(3), vectors[:3], 0.2)


def test_arms_in_space_are_drawn_wherever_they_are_mounted() -> None:
    for base in ([3.0, 1.0, -1.0], [0.0, 0.0, 2.0], [-2.0, 0.0, 0.0]):
        chain = np.array([base, [base[0], base[1], base[2] + 1.0]])
        svg = cell_figures.space_figure("a", [cell_figures.ArmDrawing(chain + 0.1, chain[0], chain)])
        (box,) = re.findall(r'viewBox="([^"]*)"', svg)
        numbers = [float(number) for number in box.split()]
        assert min(numbers[2:]) > 100.0
        assert "nan" not in svg.lower()


def test_a_perfect_model_can_be_drawn() -> None:
    nothing = {"nominal": np.zeros(3), "geometry": np.zeros(3)}
    assert "<path" in figures.error_figure("a", np.arange(3), nothing, None)
    assert "<path" in figures.error_histogram("a", nothing, None)
    assert "<path" in figures.error_figure("a", np.array([7]), {"nominal": np.ones(1)}, 0.01)
