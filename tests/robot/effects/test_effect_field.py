"""A smooth field over the workspace: its functions, its prior, and its law by name."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS, EffectTerm, term_from_json, term_to_json
from cellapp.robot.effects.data_driven import (
    FIELD,
    FIELD_LENGTH,
    POSITION,
    box_of,
    field_frequencies,
    field_functions,
    field_variances,
    form_named,
    position_in_base,
    variables,
)
from cellapp.robot.effects.law import AMPLITUDE
from tests.robot.effects.cell import context_of

CONTEXT = context_of(60)
UNKNOWN = EFFECTS["unknown"]


def law_of(amplitude=1e-4, length=0.6):
    box = box_of(position_in_base(CONTEXT))
    return FIELD.law({**box, AMPLITUDE.name: amplitude, FIELD_LENGTH.name: length})


def test_positions_are_those_of_the_smr_in_the_base_frame():
    rotations, origins = CONTEXT.frames
    x, y, z = (variable.values(CONTEXT) for variable in POSITION)
    again = origins[0] + np.einsum("nab,nb->na", rotations[0], np.stack([x, y, z], axis=1))
    np.testing.assert_allclose(again, CONTEXT.p_M, atol=1e-12)
    assert not set(POSITION) & set(variables(CONTEXT)), "no curve over one coordinate"


def test_the_prior_has_more_short_waves_at_a_shorter_length():
    frequencies = field_frequencies(law_of().constants)
    short, long = field_variances(0.3, frequencies), field_variances(1.2, frequencies)
    assert short.sum() == pytest.approx(1.0)
    assert long.sum() == pytest.approx(1.0)
    assert short @ frequencies > 1.3 * (long @ frequencies)


def test_functions_are_of_unit_mean_square_and_orthogonal_over_their_box():
    position = np.random.default_rng(2).uniform(-1.0, 1.0, (40_000, 3))
    # the box is wider than the readings by 15 % of each side at either end
    constants = box_of(np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]) / 1.3)
    phi = np.array(list(field_functions(position, constants).values()))[:20]
    np.testing.assert_allclose(phi @ phi.T / 40_000, np.eye(20), atol=0.04)


def test_columns_shift_along_the_axes_of_the_base_with_the_priors_of_the_law():
    law = law_of(amplitude=2e-4)
    columns = UNKNOWN.columns(CONTEXT, law)
    values = list(field_functions(position_in_base(CONTEXT), law.constants).values())
    assert len(columns) == 3 * len(values)
    sd = 2e-4 * np.sqrt(field_variances(0.6, field_frequencies(law.constants)))
    for direction in range(3):
        column = columns[direction * len(values) + 5]
        assert column.shift_M is not None
        np.testing.assert_allclose(column.shift_M, values[5][:, None] * CONTEXT.base_twists[direction])
        assert column.prior_sd == pytest.approx(sd[5])


def test_readings_in_a_plane_have_no_function_across_it():
    position = np.random.default_rng(3).uniform(-1.0, 1.0, (50, 3))
    position[:, 2] = 0.4
    assert all(name.endswith(",0)") for name in field_functions(position, box_of(position)))


def test_the_law_is_found_again_by_its_name():
    assert form_named("base shift|x|y|z") is FIELD
    for name in ("joint 1|x|y|z", "base shift|x|y", "base shift|x", "tool|z"):
        assert form_named(name) is None
    law = law_of()
    columns = UNKNOWN.columns(CONTEXT, law)[:7]
    names = tuple(column.name for column in columns)
    ones = np.arange(7.0)
    term = EffectTerm("unknown", names, ones, ones, ("m",) * 7, law)
    again = term_from_json(json.loads(json.dumps(term_to_json(term))), EFFECTS)
    assert again.law == law
    meaning = UNKNOWN.meaning_of(law).at("the base")
    assert "tracker station" in meaning.settle[0]
