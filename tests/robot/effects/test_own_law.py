"""Laws of a user, written as plain functions: what they move, where, and which are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cellapp.robot.effects import Channel, Effect, EffectContext, Linear, MeasurementConditions, Tuned, own_law
from cellapp.robot.kinematics.chain import smr_positions
from tests.robot.effects.cell import context_of

N = 7


def context(**conditions: Any) -> EffectContext:
    """Seven readings of an arm of the twin."""
    return context_of(N, conditions=MeasurementConditions(**conditions))


def test_a_law_of_joints_has_a_parameter_for_each() -> None:
    @own_law("cable", drag=Linear("rad", 1e-3), width=Tuned("rad", 0.5, 1.0))
    def cable(q: Any, drag: Any, width: Any) -> Any:
        return drag * np.tanh(q / width)

    effect, here = cable(), context()
    laws = effect.laws(here)
    assert [law.constants["width"] for law in laws] == [0.5, 1.0]
    assert {law.tried for law in laws} == {2}
    columns = effect.columns(here, laws[1])
    assert [column.name for column in columns] == [f"drag{j + 1}" for j in range(6)]
    for j, column in enumerate(columns):
        assert column.channel is Channel.JOINT
        assert column.offset == pytest.approx(np.tanh(here.q[:, j]))
    assert cable.slug == "cable"
    assert effect.missing_data(here) == ""


@pytest.mark.parametrize(("acts_on", "frame"), [("base", 0), ("tool", 6), ("tracker", None)])
def test_a_shift_is_in_the_axes_of_its_frame(acts_on: Any, frame: int | None) -> None:
    @own_law("sag", acts_on=acts_on, sag=Linear("m", 1e-3))
    def sag(q: Any, sag: Any) -> Any:
        return np.stack([sag * np.sin(q[:, 1]), 0.0 * q[:, 0], 0.0 * q[:, 0]], axis=1)

    here = context()
    (column,) = sag().columns(here, sag().law())
    axis = np.broadcast_to([1.0, 0.0, 0.0], (N, 3)) if frame is None else here.frames[0][frame][:, :, 0]
    assert column.shift_M == pytest.approx(np.sin(here.q[:, 1])[:, None] * axis)


def test_an_offset_of_the_law_is_the_joint_s_own() -> None:
    @own_law("cable", drag=Linear("rad", 1e-3))
    def cable(q: Any, drag: Any) -> Any:
        return drag * q

    here = context()
    column = cable().columns(here, cable().law())[1]
    assert column.offset is not None
    turned = here.q.copy()
    turned[:, 1] += 1e-6 * column.offset
    moved = smr_positions(here.geometry, turned) - smr_positions(here.geometry, here.q)
    expected = 1e-6 * column.offset[:, None] * np.cross(here.frames[0][1, :, :, 2], here.p_M - here.frames[1][1])
    assert moved == pytest.approx(expected, abs=1e-10)


def test_what_a_reading_lacks_stands_at_the_mean_of_the_run() -> None:
    @own_law("sun", acts_on="base", growth=Linear("m/K", 1e-3))
    def sun(air_c: Any, growth: Any) -> Any:
        return growth * (air_c - 20.0)[:, None] * np.array([0.0, 0.0, 1.0])

    effect = sun()
    air = np.linspace(18.0, 24.0, N)
    (law,) = effect.laws(context(air_c=air))
    (column,) = effect.columns(context(), law)
    assert column.shift_M is not None
    assert np.linalg.norm(column.shift_M, axis=1) == pytest.approx(np.full(N, air.mean() - 20.0))
    assert effect.missing_data(context()) == "air_c is not in the readings, or does not vary"


def _another_shape(q: Any, drag: Any) -> Any:
    return drag[0] * q[:, 0]


def _moves_always(q: Any, drag: Any) -> Any:
    return drag * q + 1e-6


def _not_linear(q: Any, drag: Any) -> Any:
    return np.sin(1e3 * drag * q)


def _unknown_argument(q: Any, drag: Any, wind: Any) -> Any:
    return drag * q * wind


def _without_quantity(drag: Any) -> Any:
    return drag


def _without_parameter(q: Any) -> Any:
    return q


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (_another_shape, r"returns shape \(12,\), expected \(12, 6\) for joints"),
        (_moves_always, "it moves something where all its linear parameters are zero"),
        (_not_linear, "it is not linear in 'drag'; declare that as Tuned"),
        (_unknown_argument, "argument 'wind' is no quantity of readings"),
        (_without_quantity, "the function does not take a quantity"),
        (_without_parameter, "the function does not take parameter 'drag'"),
    ],
)
def test_a_law_that_cannot_be_used_is_refused_when_it_is_declared(function: Callable[..., Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        own_law("wrong", drag=Linear("rad", 1e-3))(function)


def test_constants_that_may_be_zero_are_tuned_by_steps() -> None:
    @own_law("wave", height=Linear("rad", 1e-3), phase=Tuned("rad", -1.5, 0.0, 1.5))
    def wave(q: Any, height: Any, phase: Any) -> Any:
        return height * np.cos(q - phase)

    effect: Effect = wave()
    (_, middle, _) = effect.laws(context())
    assert [law.constants["phase"] for law in middle.nearby(context(), 1.0)] == [-0.75, 0.75]
