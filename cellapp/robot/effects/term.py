"""Accepted effects as terms of an arm model: their displacement, and the one JSON form of a term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.robot.effects.context import EffectColumn, EffectContext
from cellapp.robot.effects.effect import Effect
from cellapp.robot.effects.law import Law
from cellapp.robot.effects.modulation import Modulation, modulation_from_json, modulation_to_json, with_modulations
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class EffectTerm:
    """An accepted effect in a model: its law, and name, value, standard error and unit of each parameter.

    The parameters are those of the law, then those of its free part ``modulations``; ``law_misfit`` is the rms
    displacement by the free part over that by the law. ``note`` describes a data-driven term.
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


def displacement(terms: Sequence[EffectTerm], effects: Mapping[str, Effect], context: EffectContext) -> Displacement:
    """Compute the sum of the displacements of all terms."""
    columns: list[EffectColumn] = []
    for term in terms:
        of_law = effects[term.slug].columns(context, term.law, frozenset(term.law_names))
        by_name = {column.name: column for column in with_modulations(of_law, term.modulations, context)}
        columns += [by_name[name] for name in term.names]
    values = [value for term in terms for value in term.values.tolist()]
    return displacement_by(columns, values, *context.q.shape)


def displacement_by(columns: Sequence[EffectColumn], values: Sequence[float], n: int, joints: int) -> Displacement:
    """Compute the sum of columns times values at ``n`` stops of an arm with ``joints`` joints."""
    moved, shift_M = np.zeros((n, joints)), np.zeros((n, 3))
    for column, value in zip(columns, values, strict=True):
        if column.joint is not None:
            assert column.offset is not None
            moved[:, column.joint] += value * column.offset
        else:
            assert column.shift_M is not None
            shift_M += value * column.shift_M
    return Displacement(moved, shift_M)


def term_to_json(term: EffectTerm) -> dict[str, Any]:
    """Convert a term to a JSON object: slug, law, constants, parameters, note, and its free part if any."""
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
            f"this version does not know the effect '{slug}'; if a plug-in has it, install that: 'cellapp doctor'"
            " lists plug-ins and says what keeps one from being used"
        )
    law = effects[slug].law(name, {key: float(value) for key, value in constants.items()})
    missing = law.form.missing(law.constants)
    if missing:
        raise ValueError(f"effect {slug}: law '{name}' lacks its constant '{missing[0]}'")
    return law
