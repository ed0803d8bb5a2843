"""Lines of many cycles that joints share, in noise: found where they are, not found where none is."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.joint_fit import ProjectedResidual
from cellapp.estimation.discovery.search.stepwise import ChosenLines, shared_lines
from cellapp.estimation.discovery.terms import CandidateLaw
from cellapp.robot.effects import EFFECTS, EffectContext
from cellapp.robot.effects.context import EffectColumn
from cellapp.robot.effects.law import CYCLES
from cellapp.robot.effects.periodic import CURVE, CURVE_AMPLITUDE, CURVE_LENGTH, LINE_AMPLITUDE, lines_beside
from cellapp.robot.kinematics.transforms import Array
from tests.robot.effects.cell import context_of

JOINTS, READINGS, SIGMA_M, LEVER_M = (0, 2, 3), 300, 3e-5, 0.8
LAW = CURVE.law({CYCLES.name: 80.0} | {one.key(j): 1e-4 for j in JOINTS for one in (CURVE_AMPLITUDE, CURVE_LENGTH)})
CONTEXT = context_of(READINGS)
COLUMNS = lines_beside(CONTEXT, LAW)
"""Lines from 81 to 420 cycles of three joints, which move the SMR along an axis each."""


def found(seed: int, *lines: tuple[int, int, float]) -> ChosenLines | None:
    """What is found in noise and lines (joint, cycles, amplitude [rad])."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((len(COLUMNS), 3, READINGS))
    for row, column in zip(rows, COLUMNS, strict=True):
        assert column.joint is not None
        row[JOINTS.index(column.joint)] = LEVER_M / SIGMA_M * offset(column)
    y = rng.standard_normal((3, READINGS))
    for joint, cycles, amplitude in lines:
        y[JOINTS.index(joint)] += LEVER_M / SIGMA_M * amplitude * np.sin(cycles * CONTEXT.q[:, joint] + 0.4)
    nuisance = rng.standard_normal((40, 3 * READINGS))
    residual = ProjectedResidual(NuisanceProjector.of(nuisance), y.ravel())
    by_joint = np.zeros((3, CONTEXT.q.shape[1], READINGS))
    for axis, joint in enumerate(JOINTS):
        by_joint[axis, joint] = LEVER_M / SIGMA_M
    candidate = CandidateLaw("transmission_error", LAW, tuple(COLUMNS), rows.reshape(len(rows), -1))
    return shared_lines(candidate, residual, by_joint)


def offset(column: EffectColumn) -> Array:
    assert column.offset is not None
    return column.offset


def names(chosen: ChosenLines | None) -> set[str]:
    return set() if chosen is None else {COLUMNS[place].block for place in chosen.columns}


def test_none_is_found_in_noise() -> None:
    values = [0.0 if one is None else one.value for one in (found(seed) for seed in range(12))]
    assert max(values) < 10.0, "the margin from which lines join a model"


def test_a_count_that_joints_share_is_found_where_it_is_too_small_for_each() -> None:
    """Three joints with 13 µrad at 333 cycles, plain together only."""
    alone, shared = found(3, (0, 333, 1.3e-5)), found(3, *((joint, 333, 1.3e-5) for joint in JOINTS))
    assert alone is None or alone.value < 10.0
    assert shared is not None
    assert shared.value > 10.0
    assert names(shared) == {f"joint {joint + 1} line 333" for joint in JOINTS}


def test_the_periods_of_an_encoder_are_expected() -> None:
    """A line is worth more at 256 cycles than elsewhere: half of the probability is with powers of two."""
    values = []
    for cycles in (256, 333):
        one = found(5, (2, cycles, 2.5e-5))
        assert one is not None
        assert names(one) == {f"joint 3 line {cycles}"}
        values.append(one.value)
    assert values[0] > values[1] + 6.0


def test_choosing_costs_what_was_tried() -> None:
    one = found(7, (2, 256, 3e-5))
    assert one is not None
    assert one.tried == 6 * (2 * 2) * (3 * 3)
    assert one.columns == tuple(k for k, column in enumerate(COLUMNS) if column.block == "joint 3 line 256")


def test_lines_beside_curves_have_a_prior_of_their_own() -> None:
    law = CURVE.law({**LAW.constants, LINE_AMPLITUDE.name: 2e-5})
    context: EffectContext = CONTEXT
    own = EFFECTS["transmission_error"].columns(context, law, ["cos256q3", "sin256q3", "cos3q3"])
    priors = {column.name: column.prior_sd for column in own}
    assert priors["cos256q3"] == pytest.approx(2e-5)
    assert priors["sin256q3"] == pytest.approx(2e-5)
    assert priors["cos3q3"] < 1e-4
