"""Compare the findings in one run of a blind trial with what was hidden in it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from cellapp.commands.trials.judge_records import (
    ArmFindings,
    DescribedTerm,
    HiddenEffect,
    Likeness,
    Outcome,
    ScoredRun,
    SecondName,
)
from cellapp.commands.trials.sealed import GroundTruth
from cellapp.commands.trials.sealed_cases import FLIP, HARD, POSITION
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.data_driven import form_named
from cellapp.robot.effects.law import DriverVariable

_POSITIONS: tuple[frozenset[str], ...] = (
    frozenset({POSITION}),
    frozenset({"x", "y", "z"}),
    frozenset({"range", "azimuth", "elevation"}),
)
"""Sets of variables that together state where the SMR is."""
_OF_SPACE = ("tracker", "base", "workspace", "field", "position")
"""First words of channels that may describe a field over the workspace."""
_CONVENTION = re.compile(r"opposite|wrong sign|reversed|flipped|convention", re.IGNORECASE)
"""Words which say that approach signs follow the other convention."""

_ALIKE: tuple[frozenset[DriverVariable], ...] = (
    frozenset({DriverVariable.APPROACH, DriverVariable.STEP, DriverVariable.DWELL}),
    frozenset({DriverVariable.TIME, DriverVariable.AIR_TEMPERATURE, DriverVariable.JOINT_TEMPERATURE}),
    frozenset({DriverVariable.TORQUE, DriverVariable.PAYLOAD}),
    frozenset({DriverVariable.BEAM, DriverVariable.INCIDENCE}),
)
"""Quantities that can stand for one another: the last motion, the course of the run, the load, the line of sight."""


def score_run(truth: GroundTruth, arms: Mapping[str, ArmFindings]) -> ScoredRun:
    """Compare the findings in one run with what was hidden in it."""
    noise_um = truth.noise_um.get(truth.arm, 0.0)
    hidden = tuple(HiddenEffect.like(one, visible=one.visible_um > noise_um) for one in truth.effects)
    called = [_library_name(truth, effect.effect) for effect in hidden]
    names = frozenset(called)
    expected = None if truth.expected is None else DescribedTerm.model_validate(truth.expected.model_dump())
    here = arms.get(truth.arm)
    return ScoredRun.like(
        truth,
        hidden=hidden,
        expected=expected,
        visible=None if here is None else all(effect.visible for effect in hidden),
        outcome=None if here is None else _outcome(names, frozenset(here.accepted)),
        in_answer_set=None if here is None else names <= {slug for answers in here.answer_sets for slug in answers},
        description="" if here is None or expected is None else _description(expected, here.described),
        second_names=() if here is None else _second_names(called, hidden, expected, here),
        says_convention=None if here is None or truth.kind != FLIP else _says_convention(here),
        arms=arms,
    )


def _library_name(truth: GroundTruth, effect: str) -> str:
    """Return the name that a hidden effect should get: hard cases may also hide effects that the library lacks."""
    return UNKNOWN if truth.kind == HARD and effect not in EFFECTS else effect


def _outcome(hidden: frozenset[str], accepted: frozenset[str]) -> Outcome:
    if accepted == hidden:
        return "named"
    if not accepted:
        return "none"
    if accepted > hidden:
        return "extra"
    if accepted < hidden:
        return "part"
    return "unknown" if accepted == {UNKNOWN} else "wrong"


def _description(expected: DescribedTerm, described: Sequence[DescribedTerm]) -> Likeness:
    """Rate the best match of a data-driven term; a channel in one direction counts as that channel."""
    if expected.variables == (POSITION,):
        return _field_description(described)
    best: Likeness = ""
    for term in described:
        if term.channel != expected.channel and not term.channel.startswith(f"{expected.channel} "):
            continue
        if set(term.variables) == set(expected.variables):
            return "right"
        if set(term.variables) & set(expected.variables):
            best = "part"
    return best


def _field_description(described: Sequence[DescribedTerm]) -> Likeness:
    """Rate the description of a field over the workspace: at least two variables of position, or the word itself."""
    best: Likeness = ""
    for term in described:
        of_space = term.channel.split(" ")[0] in _OF_SPACE
        variables = set(term.variables)
        if of_space and any(variables and variables <= names for names in _POSITIONS):
            if len(variables) > 1 or POSITION in variables:
                return "right"
            best = "part"
        if of_space and POSITION in term.sentence:
            return "right"
    return best


def _says_convention(found: ArmFindings) -> bool:
    """Return whether the verdict or a description says that a sign is the opposite of what it should be."""
    return any(_CONVENTION.search(text) for text in (found.sentence, *(term.sentence for term in found.described)))


# -- second names -----------------------------------------------------------------------------------------------------


def _second_names(
    called: Sequence[str], hidden: Sequence[HiddenEffect], expected: DescribedTerm | None, found: ArmFindings
) -> tuple[SecondName, ...]:
    """Return the names accepted beyond the number of hidden effects; a name that replaces a missing one is only wrong.

    ``called`` are the names that the hidden effects should get.
    """
    wanted = Counter([UNKNOWN] if expected is not None else called)
    terms = iter(found.described)
    beyond: list[tuple[str, frozenset[DriverVariable]]] = []
    for slug in found.accepted:
        term = next(terms, None) if slug == UNKNOWN else None
        if wanted[slug] > 0:
            wanted[slug] -= 1
        elif slug == UNKNOWN:
            beyond.append((_term_name(term), _term_drivers(term)))
        else:
            beyond.append((slug, EFFECTS[slug].variables if slug in EFFECTS else frozenset()))
    missing = sum(wanted.values())
    causes = _drivers(hidden, expected)
    alike = {name for effect in hidden if effect.effect in EFFECTS for name in EFFECTS[effect.effect].look_alikes}
    return tuple(
        SecondName(name=name, same_cause=name in alike or bool(_widened(drivers) & causes))
        for name, drivers in beyond[missing:]
    )


def _widened(drivers: frozenset[DriverVariable]) -> frozenset[DriverVariable]:
    """Add to quantities those that can stand for them."""
    return drivers.union(*(group for group in _ALIKE if group & drivers))


def _term_name(term: DescribedTerm | None) -> str:
    return UNKNOWN if term is None else f"{term.channel}: {', '.join(term.variables)}"


def _term_drivers(term: DescribedTerm | None) -> frozenset[DriverVariable]:
    form = None if term is None else form_named("|".join([term.channel, *term.variables]))
    return frozenset() if form is None else form.variables


def _drivers(hidden: Sequence[HiddenEffect], expected: DescribedTerm | None) -> frozenset[DriverVariable]:
    """Return the quantities on which the hidden effects depend."""
    if expected is not None and expected.variables == (POSITION,):
        return frozenset({DriverVariable.BEAM, DriverVariable.JOINT_ANGLE})
    if expected is not None:
        return _term_drivers(expected)
    each = [EFFECTS[effect.effect].variables for effect in hidden if effect.effect in EFFECTS]
    return frozenset().union(*each)
