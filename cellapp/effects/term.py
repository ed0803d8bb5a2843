"""Accepted effects as terms of an arm model: their displacement, and the one JSON form of a term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cellapp.effects.context import EffectContext
from cellapp.effects.effect import Effect
from cellapp.effects.law import Law
from cellapp.kinematics.transforms import Array


@dataclass(frozen=True)
class EffectTerm:
    """An accepted effect in a model: its law, and name, value, standard error and unit of each parameter.

    ``note`` describes a data-driven term. ``spread`` is the standard deviation of a free curve [rad] of each joint
    (from 0) at equal steps of the joint angle from -pi to pi; empty where the standard errors are sufficient.
    """

    slug: str
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    units: tuple[str, ...]
    law: Law
    note: str = ""
    spread: Mapping[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Displacement:
    """Joint offsets (n, N) [rad] and SMR shifts (n, 3) [m, tracker frame] at n stops."""

    joints: Array
    shift_M: Array


def displacement(terms: Sequence[EffectTerm], effects: Mapping[str, Effect], context: EffectContext) -> Displacement:
    """Sum of the displacements of all terms."""
    joints, shift_M = np.zeros(context.q.shape), np.zeros((len(context), 3))
    for term in terms:
        columns = {c.name: c for c in effects[term.slug].columns(context, term.law, frozenset(term.names))}
        for name, value in zip(term.names, term.values.tolist(), strict=True):
            column = columns[name]
            if column.joint is not None:
                assert column.offset is not None
                joints[:, column.joint] += value * column.offset
            else:
                assert column.shift_M is not None
                shift_M += value * column.shift_M
    return Displacement(joints, shift_M)


def term_to_json(term: EffectTerm) -> dict[str, Any]:
    """A term for JSON: slug, law and its constants, parameters, note and spread; joints count from 1."""
    return {
        "effect": term.slug,
        "law": term.law.name,
        "constants": dict(term.law.constants),
        "note": term.note,
        "spread_rad": {str(joint + 1): values.tolist() for joint, values in term.spread.items()},
        "parameters": {
            name: {"value": value, "standard_error": error, "unit": unit}
            for name, value, error, unit in zip(
                term.names, term.values.tolist(), term.standard_errors.tolist(), term.units, strict=True
            )
        },
    }


def term_from_json(content: Mapping[str, Any], effects: Mapping[str, Effect]) -> EffectTerm:
    """Read what ``term_to_json`` wrote, or an entry of discovery's list of accepted effects.

    Raises
    ------
    ValueError
        If the effect, its law or a constant is unknown, or a constant is missing.
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
        spread={
            int(joint) - 1: np.array(values, dtype=np.float64)
            for joint, values in content.get("spread_rad", {}).items()
        },
    )


def _law_from_json(slug: str, name: str, constants: Mapping[str, Any], effects: Mapping[str, Effect]) -> Law:
    if slug not in effects:
        raise ValueError(f"this version does not know the effect '{slug}'")
    law = effects[slug].law(name, {key: float(value) for key, value in constants.items()})
    missing = law.form.missing(law.constants)
    if missing:
        raise ValueError(f"effect {slug}: law '{name}' lacks its constant '{missing[0]}'")
    return law
