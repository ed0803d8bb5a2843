"""The free part of a law: its columns against their definition, unknown drivers, and the JSON form of its terms."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellapp.robot.effects import EFFECTS, EffectTerm, MeasurementConditions, displacement, term_from_json, term_to_json
from cellapp.robot.effects.data_driven import Quantity, Variable
from cellapp.robot.effects.modulation import OWN_SIZE, FreeDriver, modulations, with_modulations
from tests.robot.effects.cell import context_of, offsets, shifts, under

CONTEXT = context_of()
COMPLIANCE = EFFECTS["joint_compliance"]
STIFF = [column for column in COMPLIANCE.columns(CONTEXT, COMPLIANCE.law()) if not column.refines][1:3]


def test_a_driver_is_that_of_the_columns_own_joint():
    found = modulations(FreeDriver(Quantity.JOINT_ANGLE), STIFF, CONTEXT)
    assert [one.name for one in found[:4]] == [
        "compliance2*cos1(q2)",
        "compliance2*sin1(q2)",
        "compliance2*cos2(q2)",
        "compliance2*sin2(q2)",
    ]
    assert {one.driver for one in found} == {Variable(Quantity.JOINT_ANGLE, 1), Variable(Quantity.JOINT_ANGLE, 2)}
    column = found[3].column(STIFF[0], CONTEXT)
    assert (column.block, column.joint, column.cycles, column.refines) == (STIFF[0].block, 1, None, True)
    np.testing.assert_allclose(offsets(column), np.sin(2.0 * CONTEXT.q[:, 1]) * offsets(STIFF[0]))


def test_a_response_out_of_proportion_depends_on_the_columns_own_size():
    found = modulations(OWN_SIZE, STIFF[:1], CONTEXT)
    size = np.abs(offsets(STIFF[0]))
    u = (size - size.min()) / np.ptp(size)
    assert [one.order for one in found] == list(range(1, 9))
    np.testing.assert_allclose(offsets(found[2].column(STIFF[0], CONTEXT)), np.cos(3.0 * np.pi * u) * offsets(STIFF[0]))
    assert found[2].name == "compliance2*cos3(own size)"


def test_shifts_are_modulated_as_well():
    drift = EFFECTS["base_drift"]
    base = drift.columns(CONTEXT, drift.laws(CONTEXT)[0])[:1]
    first = modulations(FreeDriver(Quantity.TIME), base, CONTEXT)[0]
    time_s = CONTEXT.conditions.time_s
    assert time_s is not None
    u = (time_s - time_s.min()) / np.ptp(time_s)
    expected = np.cos(np.pi * u)[:, None] * shifts(base[0])
    np.testing.assert_allclose(shifts(first.column(base[0], CONTEXT)), expected, atol=1e-12)


def test_short_steps_are_resolved_more_finely():
    play = EFFECTS["backlash"].columns(CONTEXT, EFFECTS["backlash"].law())[:1]
    first = modulations(FreeDriver(Quantity.STEP, absolute=True), play, CONTEXT)[0]
    sizes = np.abs(CONTEXT.step[:, 0])
    assert first.scale == pytest.approx(np.median(sizes))
    along = np.arccos(first.values(play[0], CONTEXT)) / np.pi
    order = np.argsort(sizes)
    assert (np.diff(along[order]) >= 0.0).all()
    assert np.interp(np.median(sizes), sizes[order], along[order]) > 0.55, "half of the range below more than half of u"


def test_an_unknown_driver_modulates_nothing():
    drift = EFFECTS["base_drift"]
    base = drift.columns(CONTEXT, drift.laws(CONTEXT)[0])[:1]
    first = modulations(FreeDriver(Quantity.TIME), base, CONTEXT)[0]
    nowhere = under(CONTEXT, MeasurementConditions())
    assert not first.values(base[0], nowhere).any()
    assert modulations(FreeDriver(Quantity.TIME), base, nowhere) == ()


def term() -> EffectTerm:
    own, load = (modulations(driver, STIFF[:1], CONTEXT)[0] for driver in (OWN_SIZE, FreeDriver(Quantity.PAYLOAD)))
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


def test_a_term_with_a_free_part_moves_by_the_law_times_one_and_a_function():
    one = term()
    assert one.law_names == ("compliance2",)
    (base, own, load) = with_modulations(STIFF[:1], one.modulations, CONTEXT)
    moved = displacement([one], EFFECTS, CONTEXT).joints[:, 1]
    np.testing.assert_allclose(moved, 1e-5 * offsets(base) + 2e-6 * offsets(own) - 1e-6 * offsets(load), atol=1e-15)


def test_a_free_part_survives_json():
    content = json.loads(json.dumps(term_to_json(term())))
    again = term_from_json(content, EFFECTS)
    assert again.modulations == term().modulations
    assert again.law_misfit == pytest.approx(0.2)
    assert term_to_json(again) == content
    content["modulations"][1]["driver"] = "moon"
    with pytest.raises(ValueError, match="does not know the variable 'moon' of a free part"):
        term_from_json(content, EFFECTS)


def test_a_free_part_needs_its_base_column():
    free = replace(term().modulations[0], base="compliance9")
    with pytest.raises(ValueError, match="needs the column 'compliance9'"):
        with_modulations(STIFF, [free], CONTEXT)


def test_every_effect_has_drivers_that_its_columns_can_have():
    for slug, effect in EFFECTS.items():
        for law in effect.laws(CONTEXT)[:1]:
            columns = effect.columns(CONTEXT, law)
            for driver in effect.free_drivers:
                assert modulations(driver, columns[:1], CONTEXT), (slug, driver)
