"""What every effect declares: words for people, tunable constants, inputs; and the JSON form of its terms."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.robot.effects import (
    EFFECTS,
    FIXED,
    ActsOn,
    Effect,
    EffectColumn,
    EffectContext,
    EffectTerm,
    InputVariable,
    Law,
    LawForm,
    Linear,
    MeasurementConditions,
    Tuned,
    own_law,
    registered,
    term_from_json,
    term_to_json,
)
from cellapp.robot.effects.data_driven import Quantity, Variable, acted_on, form_of
from tests.arms import effect_term
from tests.interfaces.plugins.installed import add_example, installed
from tests.robot.effects.cell import context_of
from tests.sure import sure

CONTEXT = context_of()
FORMS = [(slug, form) for slug, effect in EFFECTS.items() for form in effect.forms]


@pytest.mark.parametrize(("slug", "form"), FORMS, ids=lambda value: value if isinstance(value, str) else value.name)
def test_every_form_declares_words_inputs_and_constants(slug: str, form: LawForm) -> None:
    assert form.words
    assert "_" not in form.words
    assert form.words != form.name.replace("_", " ")
    assert form.variables <= EFFECTS[slug].variables
    for constant in form.constants:
        if constant.tuning != FIXED:
            assert "{}" in constant.words, "what is tuned is reported"
        assert not constant.per_joint or not constant.words or "{}" in constant.each


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.slug)
def test_every_effect_says_what_it_means_and_what_to_do(effect: Effect) -> None:
    meaning = effect.meaning.at("joints 2 and 3")
    assert any(letter.isdigit() for letter in meaning.size) == (meaning.size_source != "none")
    assert meaning.check
    assert meaning.settle
    for text in (meaning.cause, *meaning.check, *meaning.settle):
        assert text.endswith("."), text
        assert text[0].isupper(), text
        assert not {"{", "_"} & set(text), text
    assert len(set(meaning.check)) == len(meaning.check)


def test_a_term_without_a_name_has_checks_by_channel_and_stops_by_variable() -> None:
    unknown = EFFECTS["unknown"]
    meaning = unknown.meaning_of(unknown.law("base shift|other q3", {"order": 4.0})).at("the base")
    assert meaning.cause == (
        "Something moves the base with joint 3 of the other arm, by a law that the library does not have."
    )
    assert "base plate" in meaning.check[0]
    assert meaning.settle[0] == "Move joint 3 of the other arm at random between stops, then park it for 20 stops."
    every = [form_of(acts_on, (Variable(quantity, 1),)) for acts_on in acted_on(6) for quantity in Quantity]
    for form in every:
        words = unknown.meaning_of(form.law({"order": 1.0})).at("it")
        assert not any("{" in text for text in (words.cause, *words.check, *words.settle))


def test_every_constant_of_every_law_is_declared() -> None:
    """Laws cannot be made otherwise; those that the data suggest are of forms that their effect declares."""
    for slug, effect in EFFECTS.items():
        for law in effect.laws(CONTEXT):
            assert law.form in effect.forms, slug
            assert law.form.undeclared(law.constants) == []
            assert law.form.missing(law.constants) == []
            assert law.words(range(6))


class Silent(Effect):
    """An effect whose law has no words."""

    slug = "silent"
    title = "silent"
    variables = frozenset({InputVariable.TIME})
    forms = (LawForm("quiet", ""),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        return []


def test_an_incomplete_effect_is_not_registered() -> None:
    with pytest.raises(ValueError, match="effect silent: no words for people for law quiet"):
        registered((Silent(),))
    with pytest.raises(ValueError, match="two effects are called backlash"):
        registered((EFFECTS["backlash"], EFFECTS["backlash"]))


# -- JSON ------------------------------------------------------------------------------------------------------------


def compliance() -> EffectTerm:
    law = EFFECTS["joint_compliance"].law("two_slope", {"knee2": 31.0}, 4)
    return effect_term("joint_compliance", {"compliance2": 1.1e-5, "soft2": 3e-6}, "rad/Nm", law=law)


def test_discoverys_layout_of_a_law_is_read_as_well() -> None:
    content = term_to_json(compliance())
    law = {"name": content.pop("law"), "constants": content.pop("constants")}
    again = term_from_json({**content, "law": law, "title": "ignored"}, EFFECTS)
    assert again.law.name == "two_slope"
    assert again.law.constants == {"knee2": 31.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"effect": "sorcery"}, "does not know the effect 'sorcery'"),
        ({"law": "of tomorrow"}, "effect joint_compliance has no law 'of tomorrow'"),
        ({"constants": {"taper": 1.0}}, "declares no constant 'taper'"),
        ({"effect": "base_step", "law": "onset", "constants": {}}, "law 'onset' lacks its constant 'onset_s'"),
    ],
)
def test_a_damaged_term_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        term_from_json({**term_to_json(compliance()), **change}, EFFECTS)


# -- The effect of a plug-in: discovery names it, tunes its constant, and reports it in its words ----------------------

HOSE = "hose_pull"


def a_term() -> EffectTerm:
    """A pull of joint 2."""
    law = EFFECTS[HOSE].law("own", {"slack": 1.0})
    return effect_term(HOSE, {"pull2": 3e-4}, "rad/rad", law=law)


def test_a_term_of_a_plugin_that_was_removed_is_refused(tmp_path: Path) -> None:
    with installed(add_example(tmp_path)):
        content = term_to_json(a_term())
    assert HOSE not in EFFECTS
    with pytest.raises(ValueError, match="does not know the effect 'hose_pull'; if a plug-in has it, install that"):
        term_from_json(content, EFFECTS)


# -- Laws of a user, written as plain functions: what they move, where, and which are refused --------------------------

N_OF_OWN_LAW = 7


def context(**conditions: Any) -> EffectContext:
    """Seven readings of an arm of the twin."""
    return context_of(N_OF_OWN_LAW, conditions=MeasurementConditions(**conditions))


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
        assert column.acts_on is ActsOn.JOINT
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
    axis = np.broadcast_to([1.0, 0.0, 0.0], (N_OF_OWN_LAW, 3)) if frame is None else here.frames[0][frame][:, :, 0]
    assert column.shift_M == pytest.approx(np.sin(here.q[:, 1])[:, None] * axis)


def test_what_a_reading_lacks_stands_at_the_mean_of_the_run() -> None:
    @own_law("sun", acts_on="base", growth=Linear("m/K", 1e-3))
    def sun(air_c: Any, growth: Any) -> Any:
        return growth * (air_c - 20.0)[:, None] * np.array([0.0, 0.0, 1.0])

    effect = sun()
    air = np.linspace(18.0, 24.0, N_OF_OWN_LAW)
    (law,) = effect.laws(context(air_c=air))
    (column,) = effect.columns(context(), law)
    assert np.linalg.norm(sure(column.shift_M), axis=1) == pytest.approx(np.full(N_OF_OWN_LAW, air.mean() - 20.0))
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
