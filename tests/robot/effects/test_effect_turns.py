"""What effects turn: the change of an orientation that every column states, against what it moves at a long lever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS, Effect, EffectContext, Law
from cellapp.robot.effects.law import AMPLITUDE, LENGTH
from tests.robot.effects.cell import EYE, by_name, context_of

CONTEXT = context_of(10)
TURNED = replace(CONTEXT, conditions=replace(CONTEXT.conditions, R_M_S=np.tile(EYE, (10, 1, 1))))
R_M_F = CONTEXT.frames[0][-1]


def every_law(effect: Effect, context: EffectContext) -> list[Law]:
    smooth = []
    for law in effect.smooth_laws(context):
        lengths = {} if law.lengths is None else {LENGTH.name: law.lengths.start}
        smooth.append(effect.form(law.form).law({**law.constants, AMPLITUDE.name: 1.0, **lengths}))
    return [*effect.laws(context), *smooth]


def further_out(lever: np.ndarray) -> EffectContext:
    """The same stops with the SMR (3,) [m] further from the flange."""
    return replace(CONTEXT, geometry=replace(CONTEXT.geometry, tool=CONTEXT.geometry.tool + lever))


@pytest.mark.parametrize("slug", [slug for slug in EFFECTS if slug != "unknown"])
def test_every_column_turns_the_probe_as_it_moves_points_of_it(slug):
    effect = EFFECTS[slug]
    for law in every_law(effect, CONTEXT):
        here, turned = (by_name(effect.columns(context, law)) for context in (CONTEXT, TURNED))
        assert list(here) == list(turned)
        levers = [by_name(effect.columns(further_out(lever), law)) for lever in EYE]
        for name, column in turned.items():
            if column.joint is not None:
                np.testing.assert_array_equal(column.offset, here[name].offset)
                continue
            own = here[name].shift_M
            assert own is not None
            assert column.shift_M is not None
            if effect.of_reading:  # of the reading of a point: the probe itself does not turn
                assert not column.shift_M.any()
                continue
            size = np.abs(own).max()
            for axis, further in enumerate(levers):
                other = further[name].shift_M
                assert other is not None
                moved = other - own
                np.testing.assert_allclose(moved, np.cross(column.shift_M, R_M_F[:, :, axis]), atol=1e-9 * size)


def test_readings_of_both_kinds_stand_side_by_side():
    """In one context the rows of positions are as they are alone, those of orientations too."""
    R_M_S = np.tile(EYE, (10, 1, 1))
    R_M_S[::2] = np.nan
    both = replace(CONTEXT, conditions=replace(CONTEXT.conditions, R_M_S=R_M_S))
    law = EFFECTS["pedestal_compliance"].law("general")
    mixed, alone, turned = (
        np.array([one.shift_M for one in EFFECTS["pedestal_compliance"].columns(context, law)])
        for context in (both, CONTEXT, TURNED)
    )
    np.testing.assert_array_equal(mixed[:, ::2], alone[:, ::2])
    np.testing.assert_array_equal(mixed[:, 1::2], turned[:, 1::2])
