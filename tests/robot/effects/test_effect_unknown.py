"""Data-driven terms: channels, variables, functions, and defaults where a variable is unknown."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions, term_from_json, term_to_json
from cellapp.robot.effects.data_driven import (
    FIELD,
    FIELD_LENGTH,
    POSITION,
    Quantity,
    acted_on,
    box_of,
    field_functions,
    form_named,
    position_in_base,
    variables,
)
from cellapp.robot.effects.law import AMPLITUDE
from cellapp.robot.effects.modulation import OWN_SIZE, TermInput, modulations, with_modulations
from cellapp.robot.kinematics.transforms import rotation_z
from tests.robot.effects.cell import EYE, by_name, chain, context_of, curve_laws, offsets, shifts, slope, under

CONTEXT = context_of(40)
UNKNOWN = EFFECTS["unknown"]
VECTORS = ("base shift", "tool")
ACTED_ON = tuple(acts_on.name for acts_on in acted_on(6))


def law_of(acts_on, variable, context=CONTEXT):
    *_, law = [
        law for law in curve_laws(context) if law.name == f"{acts_on}|{variable}" and "period_s" not in law.constants
    ]
    return law


def columns(law, context=CONTEXT):
    return by_name(UNKNOWN.columns(context, law))


def moved_of(acts_on, context, row):
    """SMR position of one stop as a function of the channel's amplitude."""
    kind, *rest = acts_on.split()
    axis = EYE["xyz".index(rest[-1])] if rest[-1] in ("x", "y", "z") else None
    if kind == "joint":
        return lambda h: chain(context, row, joints=h * np.eye(6)[int(rest[0]) - 1]).smr
    if kind == "base" and rest[0] == "shift":
        return lambda h: chain(context, row, shift={0: h * axis}).smr
    if kind == "base":
        return lambda h: chain(context, row, twist={0: h * axis}).smr
    if kind == "tool":
        return lambda h: chain(context, row, tool=h * axis).smr
    p = context.p_M[row]
    rho = np.linalg.norm(p)
    if rest == ["radial"]:
        return lambda h: p * (1.0 + h / rho)
    if rest == ["azimuth"]:
        return lambda h: rotation_z(h) @ p
    az, el = np.arctan2(p[1], p[0]), np.arcsin(p[2] / rho)
    return lambda h: rho * np.array([np.cos(el + h) * np.cos(az), np.cos(el + h) * np.sin(az), np.sin(el + h)])


@pytest.mark.parametrize("acts_on", [acts_on for acts_on in ACTED_ON if acts_on not in VECTORS])
def test_a_channel_moves_the_smr_as_declared(acts_on):
    law = law_of(acts_on, "q5")
    found = columns(law)
    prefix = acts_on.replace(" ", "_")
    assert list(found) == [f"{prefix}.{wave}{m}_q5" for m in range(1, 5) for wave in ("cos", "sin")]
    column = found[f"{prefix}.sin3_q5"]
    assert {one.block for one in found.values()} == {acts_on}
    assert column.unit == ("m" if acts_on.split()[0] == "tool" or "shift" in acts_on or "radial" in acts_on else "rad")
    wave = np.sin(3.0 * CONTEXT.q[:, 4])
    if acts_on.startswith("joint"):
        assert column.joint == int(acts_on[-1]) - 1
        np.testing.assert_allclose(offsets(column), wave)
        return
    for row in range(5):
        expected = wave[row] * slope(moved_of(acts_on, CONTEXT, row))
        np.testing.assert_allclose(shifts(column)[row], expected, atol=1e-8)


def test_beyond_its_range_a_variable_is_held_at_its_limit():
    law = law_of("joint 2", "temperature")
    hot = under(CONTEXT, MeasurementConditions(air_c=np.full(40, 80.0)))
    for column in columns(law, hot).values():
        np.testing.assert_allclose(offsets(column), 1.0)


def test_azimuth_has_no_jump_where_the_tracker_counts_from_half_a_turn():
    """The same cell seen by a tracker that is turned about its own axis gives the same columns."""
    law = law_of("joint 2", "azimuth")
    rotated = np.eye(4)
    middle = np.arctan2(CONTEXT.p_M[:, 1].mean(), CONTEXT.p_M[:, 0].mean())
    rotated[:3, :3] = rotation_z(np.pi - middle)
    geometry = CONTEXT.geometry.with_T_M_B(rotated @ CONTEXT.geometry.T_M_B())
    across = replace(CONTEXT, geometry=geometry)
    azimuth = np.arctan2(across.p_M[:, 1], across.p_M[:, 0])
    assert np.ptp(azimuth) > 6.0, "the readings lie on both sides of the jump"
    other = columns(law_of("joint 2", "azimuth", across), across)
    for name, column in columns(law).items():
        np.testing.assert_allclose(offsets(other[name]), offsets(column), atol=1e-6)


@pytest.mark.parametrize("name", ["joint 9|q1", "nonsense|q1", "joint 1", "joint 1|q1|q2|q3", "base turn z|q1"])
def test_a_name_that_is_no_term_is_refused(name):
    with pytest.raises(ValueError, match="effect unknown has no law"):
        UNKNOWN.columns(CONTEXT, UNKNOWN.law(name, {"order": 4.0}))


# -- The discrepancy term of a law: its columns against their definition, unknown inputs, and JSON of its terms --------

CONTEXT_OF_MODULATION = context_of()
COMPLIANCE = EFFECTS["joint_compliance"]
STIFF = [column for column in COMPLIANCE.columns(CONTEXT_OF_MODULATION, COMPLIANCE.law()) if not column.refines][1:3]


def term() -> EffectTerm:
    own, load = (
        modulations(one, STIFF[:1], CONTEXT_OF_MODULATION)[0] for one in (OWN_SIZE, TermInput(Quantity.PAYLOAD))
    )
    return EffectTerm(
        slug="joint_compliance",
        names=("compliance2", own.name, load.name),
        values=np.array([1e-5, 2e-6, -1e-6]),
        standard_errors=np.full(3, 1e-8),
        units=("rad/Nm",) * 3,
        law=COMPLIANCE.law(),
        modulations=(own, load),
        law_misfit=0.2,
    )


def test_a_free_part_survives_json():
    content = json.loads(json.dumps(term_to_json(term())))
    again = term_from_json(content, EFFECTS)
    assert again.modulations == term().modulations
    assert again.law_misfit == pytest.approx(0.2)
    assert term_to_json(again) == content
    content["modulations"][1]["driver"] = "moon"
    with pytest.raises(ValueError, match="does not know the variable 'moon' of a discrepancy term"):
        term_from_json(content, EFFECTS)


def test_a_free_part_needs_its_base_column():
    free = replace(term().modulations[0], base="compliance9")
    with pytest.raises(ValueError, match="needs the column 'compliance9'"):
        with_modulations(STIFF, [free], CONTEXT_OF_MODULATION)


# -- A field over the workspace ----------------------------------------------------------------------------------------


CONTEXT_OF_FIELD = context_of(60)


def law_of_of_field(amplitude=1e-4, length=0.6):
    box = box_of(position_in_base(CONTEXT_OF_FIELD))
    return FIELD.law({**box, AMPLITUDE.name: amplitude, FIELD_LENGTH.name: length})


def test_positions_are_those_of_the_smr_in_the_base_frame():
    rotations, origins = CONTEXT_OF_FIELD.frames
    x, y, z = (variable.values(CONTEXT_OF_FIELD) for variable in POSITION)
    again = origins[0] + np.einsum("nab,nb->na", rotations[0], np.stack([x, y, z], axis=1))
    np.testing.assert_allclose(again, CONTEXT_OF_FIELD.p_M, atol=1e-12)
    assert not set(POSITION) & set(variables(CONTEXT_OF_FIELD)), "no curve over one coordinate"


def test_functions_are_of_unit_mean_square_and_orthogonal_over_their_box():
    position = np.random.default_rng(2).uniform(-1.0, 1.0, (40_000, 3))
    # the box is wider than the readings by 15 % of each side at either end
    constants = box_of(np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]) / 1.3)
    phi = np.array(list(field_functions(position, constants).values()))[:20]
    np.testing.assert_allclose(phi @ phi.T / 40_000, np.eye(20), atol=0.04)


def test_the_law_is_found_again_by_its_name():
    assert form_named("base shift|x|y|z") is FIELD
    for name in ("joint 1|x|y|z", "base shift|x|y", "base shift|x", "tool|z"):
        assert form_named(name) is None
    law = law_of_of_field()
    columns = UNKNOWN.columns(CONTEXT_OF_FIELD, law)[:7]
    names = tuple(column.name for column in columns)
    ones = np.arange(7.0)
    term = EffectTerm("unknown", names, ones, ones, ("m",) * 7, law)
    again = term_from_json(json.loads(json.dumps(term_to_json(term))), EFFECTS)
    assert again.law == law
    meaning = UNKNOWN.meaning_of(law).at("the base")
    assert "tracker station" in meaning.settle[0]
