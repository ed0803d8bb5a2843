"""What every effect declares: words for people, tunable constants, drivers; and the JSON form of its terms."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from typing import Any

import numpy as np
import pytest

from cellapp.robot.effects import (
    EFFECTS,
    FIXED,
    Constant,
    DriverVariable,
    Effect,
    EffectColumn,
    EffectContext,
    EffectTerm,
    Law,
    LawForm,
    NeighbouringPauses,
    Scaled,
    place_in_words,
    registered,
    term_from_json,
    term_to_json,
)
from cellapp.robot.effects.data_driven import Quantity, Variable, channels, form_of
from tests.robot.effects.cell import context_of

CONTEXT = context_of()
FORMS = [(slug, form) for slug, effect in EFFECTS.items() for form in effect.forms]


@pytest.mark.parametrize(("slug", "form"), FORMS, ids=lambda value: value if isinstance(value, str) else value.name)
def test_every_form_declares_words_drivers_and_constants(slug: str, form: LawForm) -> None:
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


def test_places_are_put_into_the_words() -> None:
    assert place_in_words(["joint 2"]) == "joint 2"
    assert place_in_words(["joint 1", "joint 2", "joint 4"]) == "joints 1, 2 and 4"
    assert place_in_words(["link 2", "link 3"]) == "links 2 and 3"
    assert place_in_words(["base", "tool"]) == "the base and the target on the flange"
    check = EFFECTS["backlash"].meaning.at(place_in_words(["joint 2"])).check
    assert "Check the bolts of the gearbox of joint 2, then have the gear inspected." in check


def test_a_term_without_a_name_has_checks_by_channel_and_stops_by_variable() -> None:
    unknown = EFFECTS["unknown"]
    meaning = unknown.meaning_of(unknown.law("base shift|other q3", {"order": 4.0})).at("the base")
    assert meaning.cause == (
        "Something moves the base with joint 3 of the other arm, by a law that the library does not have."
    )
    assert "base plate" in meaning.check[0]
    assert meaning.settle[0] == "Move joint 3 of the other arm at random between stops, then park it for 20 stops."
    every = [form_of(channel, (Variable(quantity, 1),)) for channel in channels(6) for quantity in Quantity]
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


def test_a_constant_without_a_declaration_is_refused() -> None:
    form = LawForm("some", "somehow", (Constant("width", "rad", Scaled(1.5), "width {} rad"),))
    with pytest.raises(ValueError, match="law 'some' declares no constant 'taper'"):
        form.law({"width": 1.0, "taper": 2.0})


def test_tuning_follows_the_declarations() -> None:
    width = Constant("width", "rad", Scaled(1.5), "width {} rad")
    knee = Constant("knee", "Nm", Scaled(2.0), "knee at {}", "{} Nm for joint {}", per_joint=True)
    form = LawForm("some", "somehow", (width, knee, Constant("mean", "degC", FIXED)))
    law = form.law({"width": 1.0, "mean": 20.0, "knee2": 8.0})
    found = [dict(one.constants) for one in law.nearby(CONTEXT, 1.0)]
    assert found == [
        {"width": pytest.approx(1.0 / 1.5), "mean": 20.0, "knee2": 8.0},
        {"width": pytest.approx(1.5), "mean": 20.0, "knee2": 8.0},
        {"width": 1.0, "mean": 20.0, "knee2": pytest.approx(4.0)},
        {"width": 1.0, "mean": 20.0, "knee2": pytest.approx(16.0)},
    ]
    closer = law.nearby(CONTEXT, 0.5)
    assert closer[1].constants["width"] == pytest.approx(math.sqrt(1.5))
    assert law.words([0, 1]) == "somehow, width 1 rad; knee at 8 Nm for joint 2"
    assert law.words([0]) == "somehow, width 1 rad"


def test_an_onset_moves_to_neighbouring_pauses() -> None:
    time_s = CONTEXT.conditions.time_s
    assert time_s is not None
    pauses = (time_s[1:] + time_s[:-1]) / 2.0
    tuning = NeighbouringPauses(reach=2, margin=7)
    assert tuning.nearby(float(pauses[20]), CONTEXT, 1.0) == pytest.approx(pauses[18:23].tolist())
    assert tuning.nearby(float(pauses[7]), CONTEXT, 1.0) == pytest.approx(pauses[7:10].tolist())


class Silent(Effect):
    """An effect whose law has no words."""

    slug = "silent"
    title = "silent"
    variables = frozenset({DriverVariable.TIME})
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
    return EffectTerm(
        slug="joint_compliance",
        names=("compliance2", "soft2"),
        values=np.array([1.1e-5, 3e-6]),
        standard_errors=np.array([1e-8, 2e-8]),
        units=("rad/Nm", "rad/Nm"),
        law=EFFECTS["joint_compliance"].law("two_slope", {"knee2": 31.0}, 4),
        note="noted",
    )


def test_a_term_survives_json() -> None:
    content = json.loads(json.dumps(term_to_json(compliance())))
    assert set(content) == {"effect", "law", "constants", "note", "parameters"}
    assert content["parameters"]["soft2"] == {"value": 3e-6, "standard_error": 2e-8, "unit": "rad/Nm"}
    again = term_from_json(content, EFFECTS)
    assert (again.slug, again.names, again.units, again.note) == ("joint_compliance", *_plain(compliance()))
    assert (again.law.form, again.law.constants) == (compliance().law.form, compliance().law.constants)
    np.testing.assert_array_equal(again.values, compliance().values)
    assert term_to_json(again) == content


def _plain(term: EffectTerm) -> tuple[Any, ...]:
    return term.names, term.units, term.note


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
