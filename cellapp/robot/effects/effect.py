"""Base class of all effects: their declarations and columns.

An effect is one subclass of ``Effect`` in one file, and one line in ``registry``. It declares its words, the variables
it depends on, what it is confounded with and the forms of its law; it computes columns that are linear in its
parameters. Joint offsets enter the chain exactly; all other places move the SMR by less than a millimetre and enter
linearly.
"""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from cellapp.robot.effects.context import INDEXED, EffectColumn, EffectContext, place_name
from cellapp.robot.effects.law import InputVariable, Law, LawForm, SmoothLaw
from cellapp.robot.effects.modulation import (
    Modulation,
    TermInput,
    modulation_from_json,
    modulation_to_json,
    with_modulations,
)
from cellapp.robot.kinematics.transforms import Array

# -- What an effect means for whoever runs the cell -------------------------------------------------------------------


SizeSource = Literal["sourced", "computed", "estimate", "none"]

_FRAMES = {"base": "the base", "tool": "the target on the flange", "tracker": "the tracker's reading"}


@dataclass(frozen=True)
class Meaning:
    """Where an effect comes from, how large it usually is, what to check or mend, and what would settle it.

    Attributes
    ----------
    cause : str
        Where it comes from.
    size : str
        How large it usually is at the SMR of arms of this class.
    size_source : "sourced", "computed", "estimate" or "none"
        Read in a publication or catalogue; computed from such figures; an engineer's estimate; or there is no size.
    check : tuple of str
        What to check or mend on the machine, the most likely first.
    settle : tuple of str
        Further stops or observations that would settle whether it is there.
    """

    cause: str
    size: str
    size_source: SizeSource
    check: tuple[str, ...]
    settle: tuple[str, ...]

    @classmethod
    def of(cls, text: str) -> Meaning:
        """Read paragraphs ``cause: ...``, ``size (source): ...`` and any number of ``check: ...`` and ``settle: ...``.

        Their further lines are indented.
        """
        found: dict[str, list[str]] = {"check": [], "settle": []}
        for paragraph in re.split(r"\n(?=\S)", inspect.cleandoc(text)):
            label, words = " ".join(paragraph.split()).split(": ", 1)
            found.setdefault(label, []).append(words)
        source: SizeSource = next(one for one in get_args(SizeSource) if f"size ({one})" in found)
        (cause,), (size,) = found["cause"], found[f"size ({source})"]
        return cls(cause, size, source, tuple(found["check"]), tuple(found["settle"]))

    def at(self, place: str) -> Meaning:
        """The same with the place in words for ``{place}``, for example ``joints 2 and 3``: ``each of`` them, then."""
        one = f"each of {place}" if place.startswith(("joints ", "links ")) else place

        def fill(text: str) -> str:
            filled = text.replace("{place}", one)
            return filled[:1].upper() + filled[1:]

        return replace(
            self,
            cause=fill(self.cause),
            size=fill(self.size),
            check=tuple(map(fill, self.check)),
            settle=tuple(map(fill, self.settle)),
        )


def enumeration(words: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def place_in_words(acts_on: Sequence[str]) -> str:
    """``joints 2 and 3``, ``link 2``, ``the base`` for the names of what columns act on."""
    for kind in ("joint", "link"):
        if acts_on and all(name.startswith(f"{kind} ") for name in acts_on):
            numbers = [name.removeprefix(f"{kind} ") for name in acts_on]
            return f"{kind}{'s' if len(numbers) > 1 else ''} {enumeration(numbers)}"
    return enumeration([_FRAMES.get(name, name) for name in acts_on])


@dataclass(frozen=True)
class ImpossibleValues:
    """Texts for values of an effect outside their physical bounds, and what to check then.

    Attributes
    ----------
    sign : str
        What the opposite sign looks like; if empty, the effect's title "of the opposite sign".
    sign_check, size_check : str
        What to check.
    limit : str
        Name of the limit of which values beyond the bound are stated as multiples.
    limit_size : float
        That limit in the parameter's unit; 0 for the bound itself.
    """

    sign: str = ""
    sign_check: str = "check signs and units of the readings and of the profile"
    limit: str = "what is physically possible"
    limit_size: float = 0.0
    size_check: str = "check units of the readings and of the profile"


class Effect(ABC):
    """A physical effect."""

    slug: ClassVar[str]
    """Identifier in JSON and results."""
    title: ClassVar[str]
    """Name in reports."""
    meaning: ClassVar[Meaning]
    """Cause, usual size, what to check and what would settle it."""
    confounded: ClassVar[tuple[str, ...]] = ()
    """Slugs of effects that data may not distinguish from it."""
    variables: ClassVar[frozenset[InputVariable]]
    """What it depends on."""
    forms: ClassVar[tuple[LawForm, ...]]
    """All forms of its law, the simplest first."""
    discrepancy_inputs: ClassVar[tuple[TermInput, ...]] = ()
    """Inputs on which it may depend in ways that the law does not describe; if empty, the law is taken as exact."""

    arm_bound: ClassVar[bool] = False
    """Whether it belongs to the arm itself: its parameters then remain valid with another base or tool."""

    of_reading: ClassVar[bool] = False
    """Whether it moves the reading or the reflector instead of the flange."""
    wears: ClassVar[bool] = False
    """Whether it is caused by wear: a check looks for it at every joint, even if the calibration did not find it."""
    lengthens: ClassVar[bool] = False
    """Whether it lengthens links."""
    shifts_zero: ClassVar[bool] = False
    """Whether it shifts the zero positions of joints."""

    impossible: ClassVar[ImpossibleValues] = ImpossibleValues()
    """Words for values outside the bounds of its columns."""

    def missing_data(self, context: EffectContext) -> str:
        """Return why the data cannot show the effect at all ("no approach signs"); empty if they can."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """Return the laws to try on these data, the simplest first."""
        return [form.law() for form in self.forms]

    def refinements(self, context: EffectContext, law: Law, names: Collection[str]) -> list[Law]:
        """Return further laws to try if ``law`` with the columns ``names`` was found."""
        return []

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Return the smooth laws that the structured process adds for the residuals of the other laws."""
        return []

    @abstractmethod
    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Compute the columns of a law, the same set for any data; ``names`` requests columns made only on request."""

    def meaning_of(self, law: Law) -> Meaning:
        """Return the meaning of this law; the same for all laws unless an effect overrides it."""
        return self.meaning

    def form(self, name: str) -> LawForm:
        """Return the form ``name``, the simplest one if empty; raise ``ValueError`` if there is none."""
        for form in self.forms:
            if name in ("", form.name):
                return form
        raise ValueError(f"effect {self.slug} has no law '{name}' in this version of the program")

    def law(self, name: str = "", constants: Mapping[str, float] | None = None, tried: int = 1) -> Law:
        """Return a law by the name of its form."""
        return self.form(name).law(constants, tried)


# -- Library laws that are borrowed for other causes: what the readings show is reported and not dropped --------------
#
# A law that fits only with physically impossible values has another cause, such as a wrong sign convention of the
# readings or a wrong mass. A law may also describe a part of an unknown effect. Such terms belong to the unknown
# effects; in JSON their laws are named ``contradiction|effect|law`` and ``imitation|effect|law``. The unnamed term is
# made of smooth laws, ``unnamed|effect|law``: each moves what its effect moves, without a claim that it is there.

BorrowedFor = Literal["contradiction", "imitation", "unnamed"]


@dataclass(frozen=True)
class BorrowedForm(LawForm):
    """The form ``lent`` of an effect's law, without physical bounds, for something that is not that effect."""

    purpose: BorrowedFor = field(kw_only=True)
    effect: Effect = field(kw_only=True)
    lent: LawForm = field(kw_only=True)


def borrowed(purpose: BorrowedFor, effect: Effect, form: LawForm) -> BorrowedForm:
    """Return a form of an effect for another purpose."""
    return BorrowedForm(
        name="|".join((purpose, effect.slug, form.name)),
        words=f"as {effect.title}, {form.words}{', but with impossible values' * (purpose == 'contradiction')}",
        constants=form.constants,
        variables=form.variables or effect.variables,
        purpose=purpose,
        effect=effect,
        lent=form,
    )


def borrowed_form_named(name: str, library: Mapping[str, Effect]) -> BorrowedForm | None:
    """Return the borrowed form named so in JSON, else None; raise ``ValueError`` if the effect lacks the law."""
    prefix, _, rest = name.partition("|")
    slug, _, law = rest.partition("|")
    purpose = next((one for one in get_args(BorrowedFor) if one == prefix), None)
    if purpose is None or slug not in library:
        return None
    return borrowed(purpose, library[slug], library[slug].form(law))


def lent_law(law: Law) -> Law:
    """Return the library law behind a borrowed one."""
    assert isinstance(law.form, BorrowedForm)
    return law.form.lent.law(law.constants, law.tried)


def lent_effect(law: Law) -> Effect:
    """Return the library effect whose law a borrowed one is."""
    assert isinstance(law.form, BorrowedForm)
    return law.form.effect


def is_contradiction(law: Law) -> bool:
    """Return whether a law is a library law with impossible values."""
    return isinstance(law.form, BorrowedForm) and law.form.purpose == "contradiction"


def is_unnamed(law: Law) -> bool:
    """Return whether a law is a part of the unnamed term."""
    return isinstance(law.form, BorrowedForm) and law.form.purpose == "unnamed"


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
    acts_on = columns[0].acts_on
    if acts_on not in INDEXED or not indices:
        return place_name(acts_on, None)
    if len(indices) == 1:
        return place_name(acts_on, indices[0])
    return f"{place_name(acts_on, None).removeprefix('all ')} {', '.join(str(index + 1) for index in indices)}"


# -- Accepted effects as terms of an arm model: their displacement, and the one JSON form of a term -------------------


@dataclass(frozen=True)
class EffectTerm:
    """An accepted effect in a model: its law, and name, value, standard error and unit of each parameter.

    The parameters are those of the law, then those of its discrepancy term ``modulations``; ``law_misfit`` is the rms
    displacement by the discrepancy term over that by the law. ``note`` describes a data-driven term.
    """

    slug: str
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    units: tuple[str, ...]
    law: Law
    note: str = ""
    modulations: tuple[Modulation, ...] = ()
    law_misfit: float = 0.0

    @property
    def law_names(self) -> tuple[str, ...]:
        """Names of the law's parameters."""
        return self.names[: len(self.names) - len(self.modulations)]


@dataclass(frozen=True)
class Displacement:
    """Joint offsets (n, N) [rad] and SMR shifts (n, 3) [m, tracker frame] at n stops."""

    joints: Array
    shift_M: Array

    @classmethod
    def total(cls, parts: Sequence[Displacement], n: int, joints: int) -> Displacement:
        """Sum of displacements at ``n`` stops of an arm with ``joints`` joints."""
        return cls(
            joints=sum((one.joints for one in parts), start=np.zeros((n, joints))),
            shift_M=sum((one.shift_M for one in parts), start=np.zeros((n, 3))),
        )


def ordered_columns(term: EffectTerm, effects: Mapping[str, Effect], context: EffectContext) -> list[EffectColumn]:
    """Return the columns of a term in the order of its parameters."""
    of_law = effects[term.slug].columns(context, term.law, frozenset(term.law_names))
    by_name = {column.name: column for column in with_modulations(of_law, term.modulations, context)}
    return [by_name[name] for name in term.names]


def displacement(terms: Sequence[EffectTerm], effects: Mapping[str, Effect], context: EffectContext) -> Displacement:
    """Compute the sum of the displacements of all terms."""
    columns = [column for term in terms for column in ordered_columns(term, effects, context)]
    values = [value for term in terms for value in term.values.tolist()]
    moved, shift_M = np.zeros(context.q.shape), np.zeros((len(context.q), 3))
    for column, value in zip(columns, values, strict=True):
        if column.joint is not None:
            assert column.offset is not None
            moved[:, column.joint] += value * column.offset
        else:
            assert column.shift_M is not None
            shift_M += value * column.shift_M
    return Displacement(moved, shift_M)


def term_to_json(term: EffectTerm) -> dict[str, Any]:
    """Convert a term to a JSON object: slug, law, constants, parameters, note, and its discrepancy term if any."""
    free = {"modulations": [modulation_to_json(one) for one in term.modulations], "law_misfit": term.law_misfit}
    return {
        "effect": term.slug,
        "law": term.law.name,
        "constants": dict(term.law.constants),
        "note": term.note,
        "parameters": {
            name: {"value": value, "standard_error": error, "unit": unit}
            for name, value, error, unit in zip(
                term.names, term.values.tolist(), term.standard_errors.tolist(), term.units, strict=True
            )
        },
        **(free if term.modulations else {}),
    }


def term_from_json(content: Mapping[str, Any], effects: Mapping[str, Effect]) -> EffectTerm:
    """Parse an object from ``term_to_json``, or an entry of discovery's list of accepted effects.

    Raises
    ------
    ValueError
        If the effect, its law, a constant or a variable is unknown, or a constant is missing.
    """
    law = content.get("law", "")
    if isinstance(law, Mapping):  # discovery's layout: {"name": ..., "constants": {...}}
        name, constants = law["name"], law["constants"]
    else:
        name, constants = law, content.get("constants", {})
    parameters = content["parameters"]
    return EffectTerm(
        slug=content["effect"],
        names=tuple(parameters),
        values=np.array([p["value"] for p in parameters.values()], dtype=np.float64),
        standard_errors=np.array([p["standard_error"] for p in parameters.values()], dtype=np.float64),
        units=tuple(p["unit"] for p in parameters.values()),
        law=_law_from_json(content["effect"], name, constants, effects),
        note=content.get("note", ""),
        modulations=tuple(modulation_from_json(one) for one in content.get("modulations", ())),
        law_misfit=float(content.get("law_misfit", 0.0)),
    )


def _law_from_json(slug: str, name: str, constants: Mapping[str, Any], effects: Mapping[str, Effect]) -> Law:
    if slug not in effects:
        raise ValueError(
            f"this version does not know the effect '{slug}'; if a plug-in has it, install that:"
            " 'cellapp doctor PROFILE' lists plug-ins and says what keeps one from being used"
        )
    law = effects[slug].law(name, {key: float(value) for key, value in constants.items()})
    missing = law.form.missing(law.constants)
    if missing:
        raise ValueError(f"effect {slug}: law '{name}' lacks its constant '{missing[0]}'")
    return law
