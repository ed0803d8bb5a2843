"""Library laws that are borrowed for other causes: what the readings show is reported and not dropped.

A law that fits only with physically impossible values has another cause, such as a wrong sign convention of the
readings or a wrong mass. A law may also describe a part of an unknown effect. Such terms belong to the unknown effects;
in JSON their laws are named ``contradiction|effect|law`` and ``imitation|effect|law``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from cellapp.robot.effects.context import INDEXED_CHANNELS, EffectColumn, place_name
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import Law, LawForm

_CONTRADICTION, _IMITATION = "contradiction", "imitation"


@dataclass(frozen=True)
class BorrowedForm(LawForm):
    """The form ``lent`` of an effect's law, without physical bounds, for something that is not that effect."""

    effect: Effect = field(kw_only=True)
    lent: LawForm = field(kw_only=True)


@dataclass(frozen=True)
class ContradictionForm(BorrowedForm):
    """A borrowed form that fits only with physically impossible values."""


_Form = TypeVar("_Form", bound=BorrowedForm)


def form_without_bounds(effect: Effect, form: LawForm) -> ContradictionForm:
    """Return a form of an effect as a contradiction."""
    return _borrowed(ContradictionForm, _CONTRADICTION, effect, form, ", but with impossible values")


def imitation(effect: Effect, form: LawForm) -> BorrowedForm:
    """Return a form of an effect as a part of an unknown effect."""
    return _borrowed(BorrowedForm, _IMITATION, effect, form)


def _borrowed(kind: type[_Form], prefix: str, effect: Effect, form: LawForm, but: str = "") -> _Form:
    return kind(
        name="|".join((prefix, effect.slug, form.name)),
        words=f"as {effect.title}, {form.words}{but}",
        constants=form.constants,
        variables=form.variables or effect.variables,
        effect=effect,
        lent=form,
    )


def borrowed_form_named(name: str, library: Mapping[str, Effect]) -> BorrowedForm | None:
    """Return the borrowed form named so in JSON, else None; raise ``ValueError`` if the effect lacks the law."""
    prefix, _, rest = name.partition("|")
    slug, _, law = rest.partition("|")
    make = {_CONTRADICTION: form_without_bounds, _IMITATION: imitation}.get(prefix)
    if make is None or slug not in library:
        return None
    return make(library[slug], library[slug].form(law))


def lent_law(law: Law) -> Law:
    """Return the library law behind a borrowed one."""
    assert isinstance(law.form, BorrowedForm)
    return law.form.lent.law(law.constants, law.tried)


def contradicted_effect(law: Law) -> Effect:
    """Return the library effect that a contradiction behaves like."""
    assert isinstance(law.form, ContradictionForm)
    return law.form.effect


def is_contradiction(law: Law) -> bool:
    """Return whether a law is a library law with impossible values."""
    return isinstance(law.form, ContradictionForm)


def is_borrowed(law: Law) -> bool:
    """Return whether a law is a library law borrowed for another cause."""
    return isinstance(law.form, BorrowedForm)


def contradiction_meaning(effect: Effect) -> Meaning:
    """Build the meaning of an effect that the readings show with impossible values."""
    words = effect.impossible
    checks = dict.fromkeys((words.sign_check, words.size_check))
    return Meaning(
        cause=(
            f"Something behaves like {effect.title}, but with values that cannot be. The first suspects are signs,"
            " units and conventions of the readings and of the profile."
        ),
        size="A value that cannot be has no usual size",
        size_source="none",
        check=tuple(f"{check[0].upper()}{check[1:]}." for check in checks),
        settle=effect.meaning.settle,
    )


def sentence(effect: Effect, columns: Sequence[EffectColumn], values: Sequence[float]) -> str:
    """Say what an effect with impossible values looks like, where, and what to check.

    ``columns``, with their bounds, and ``values`` are those outside the bounds only.
    """
    words = effect.impossible
    places = _places(columns)
    negative = [value < 0.0 and column.lower == 0.0 for column, value in zip(columns, values, strict=True)]
    if sum(negative) * 2 >= len(negative):
        return f"behaves like {words.sign or f'{effect.title} of the opposite sign'} at {places}: {words.sign_check}"
    sizes = [
        abs(value) / (words.limit_size or max(abs(column.lower), abs(column.upper)))
        for column, value in zip(columns, values, strict=True)
    ]
    return f"behaves like {effect.title} of {np.max(sizes):.2g} times {words.limit} at {places}: {words.size_check}"


def _places(columns: Sequence[EffectColumn]) -> str:
    """``joint 2``, ``joints 1, 2, 3``, ``base``."""
    indices = sorted({column.index for column in columns if column.index is not None})
    channel = columns[0].channel
    if channel not in INDEXED_CHANNELS or not indices:
        return place_name(channel, None)
    if len(indices) == 1:
        return place_name(channel, indices[0])
    return f"{place_name(channel, None).removeprefix('all ')} {', '.join(str(index + 1) for index in indices)}"
