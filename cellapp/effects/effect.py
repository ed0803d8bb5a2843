"""What an effect is: columns that are linear in its parameters, and what a person must know of it.

All effects of this version act as joint offsets: the joint really stands at ``q + sum_m beta_m D_m(q, history, load)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellapp.kinematics.transforms import Array


@dataclass(frozen=True)
class EffectContext:
    """All that an effect may depend on, for n configurations of one arm.

    Attributes
    ----------
    q : array, shape (n, N)
        Joint positions from the controller [rad].
    torques : array, shape (n, N)
        Gravity torques of the nominal arm with its payload [Nm].
    approach : array, shape (n, N)
        Sign of each joint's last motion, 0 where unknown.
    """

    q: Array
    torques: Array
    approach: Array


@dataclass(frozen=True)
class EffectColumn:
    """One parameter of an effect and what it does.

    Attributes
    ----------
    name : str
        For example ``compliance2``.
    unit : str
    joint : int
        The joint it acts on, from 0; columns of one joint are judged together.
    offset : array, shape (n,)
        Offset of that joint per unit [rad].
    lower, upper : float
        Physical bounds of the parameter; a value outside is an alias of something else, not a finding.
    """

    name: str
    unit: str
    joint: int
    offset: Array
    lower: float
    upper: float


class Effect(Protocol):
    """A physical effect by its name in the field."""

    slug: str
    """Its name in reports and JSON."""
    title: str
    """The field's words for it."""
    look_alikes: tuple[str, ...]
    """Slugs of effects that data may not tell apart from it."""

    def columns(self, context: EffectContext) -> list[EffectColumn]:
        """Its columns, always the same ones; all zero where the data lack what one needs (no approach signs)."""


@dataclass(frozen=True)
class EffectTerm:
    """An effect that was found and became part of a model: parameter names, values, standard errors and units."""

    slug: str
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    units: tuple[str, ...]


def joint_offsets(columns: Sequence[EffectColumn], joints: int) -> Array:
    """Columns as joint offsets (m, N, n) [rad per unit]."""
    n = len(columns[0].offset) if columns else 0
    offsets = np.zeros((len(columns), joints, n))
    for place, column in enumerate(columns):
        offsets[place, column.joint] = column.offset
    return offsets


def term_offsets(terms: Sequence[EffectTerm], effects: Mapping[str, Effect], context: EffectContext) -> Array:
    """Joint offsets (n, N) [rad] of the terms of a model."""
    total = np.zeros_like(context.q)
    for term in terms:
        columns = {column.name: column for column in effects[term.slug].columns(context)}
        for name, value in zip(term.names, term.values, strict=True):
            total[:, columns[name].joint] += value * columns[name].offset
    return total
