"""Normal matrix of an arm's geometry and effects over its readings, accumulated over chunks.

With W the whitening of a reading and J, A its derivatives by geometric parameters and by those of the effects, the rows
are W [J, A]. Values are deviations from a reference: geometric parameters from those of ``reference``, effects from 0.
Measured orientations are rows after the positions, see ``quantities``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.discovery.arm_data import whitening
from cellapp.estimation.discovery.joint_fit import LinearModel, NormalMatrix
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectTerm, MeasurementConditions
from cellapp.robot.effects.modulation import with_modulations
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

_CHUNK = 512
"""Readings in a chunk: 1500 columns of them take 18 MB."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured vectors of one arm, their conditions, and the uncertainty (n,) [m] or (n, 3, 3) [m^2] that weights them.

    ``stated`` is the uncertainty that the readings state, in the same shapes; None if they state none.
    """

    readings: Readings
    conditions: MeasurementConditions
    sigma: Array
    stated: Array | None = None

    @classmethod
    def of(cls, readings: Readings, conditions: MeasurementConditions) -> Measured:
        """Take all measurements of some readings, positions and then orientations, with equal weights."""
        its = measured_quantities(readings, conditions)
        return cls(its.readings, its.conditions, np.ones(len(its.readings)), its.stated)

    def __len__(self) -> int:
        return len(self.readings)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Measured:
        """Return some of the vectors."""
        stated = None if self.stated is None else self.stated[rows]
        return Measured(self.readings.take(rows), self.conditions.take(rows), self.sigma[rows], stated)

    @property
    def turned(self) -> NDArray[np.bool_] | None:
        """Mask (n,) of the vectors that are orientations; None if there are none."""
        return self.conditions.turned

    @property
    def points(self) -> NDArray[np.bool_]:
        """Mask (n,) of the vectors that are positions."""
        return np.ones(len(self), dtype=np.bool_) if self.turned is None else ~self.turned

    @property
    def positions(self) -> Measured:
        """The vectors that are positions."""
        if self.turned is None:
            return self
        its = self.take(self.points)
        return replace(its, conditions=replace(its.conditions, R_M_S=None))

    def chunks(self) -> Iterator[Measured]:
        """Yield the readings in chunks."""
        for first in range(0, len(self), _CHUNK):
            yield self.take(np.arange(first, min(first + _CHUNK, len(self)), dtype=np.intp))

    def left(self, model: ArmModel) -> Array:
        """Return measured less predicted positions (n, 3) [m], and rotations from computed to measured [rad]."""
        computed = model.predict(self.readings.q, conditions=self.conditions)
        return np.asarray(self.readings.p_M - computed)


def term_columns(model: ArmModel, measured: Measured) -> list[EffectColumn]:
    """Return the columns of all effects of a model, in the order of their values, at the true joint positions."""
    q, conditions = measured.readings.q, measured.conditions
    actual = model.true_joints(q, conditions=conditions) if model.effects else None
    context = replace(model.context(q, conditions=conditions), q_actual=actual)
    found: list[EffectColumn] = []
    for term in model.effects:
        of_law = EFFECTS[term.slug].columns(context, term.law, frozenset(term.law_names))
        by_name = {column.name: column for column in with_modulations(of_law, term.modulations, context)}
        found += [by_name[name] for name in term.names]
    return found


def design(model: ArmModel, measured: Measured, columns: tuple[int, ...]) -> Array:
    """Return whitened derivatives (p, 3 n) by the geometric parameters ``columns`` and by the values of all effects."""
    white, terms = whitening(measured.sigma), term_columns(model, measured)
    R_M_S = measured.conditions.R_M_S
    return LinearModel.of(model.geometry, measured.readings.q, white, columns, terms, R_M_S).rows


def normal_matrix(model: ArmModel, measured: Measured, columns: tuple[int, ...], reference: Geometry) -> NormalMatrix:
    """Accumulate the normal matrix over all readings, linearised at ``model``; y is measured less the reference."""
    deviation = values_of(model.geometry, model.effects, columns, reference)
    total = len(deviation)
    found = NormalMatrix(np.zeros((total, total)), np.zeros(total), 0.0)
    for chunk in measured.chunks():
        rows = design(model, chunk, columns)
        target = np.einsum("acn,nc->an", whitening(chunk.sigma), chunk.left(model)).ravel() + deviation @ rows
        found += NormalMatrix.of(rows, target)
    return found


def values_of(geometry: Geometry, terms: Sequence[EffectTerm], columns: tuple[int, ...], reference: Geometry) -> Array:
    """Return the deviations (p,) of geometric parameters from ``reference``, then the effects' values."""
    places = list(columns)
    of_geometry = geometry.vector()[places] - reference.vector()[places]
    return np.concatenate([of_geometry, *(term.values for term in terms)])


def with_values(model: ArmModel, columns: tuple[int, ...], reference: Geometry, values: Array) -> ArmModel:
    """Return the model at ``values`` (p,); the reverse of ``values_of``."""
    vector = model.geometry.vector()
    vector[list(columns)] = reference.vector()[list(columns)] + values[: len(columns)]
    first = len(columns)
    terms = []
    for term in model.effects:
        terms.append(replace(term, values=values[first : first + len(term.values)]))
        first += len(term.values)
    return replace(model, geometry=model.geometry.with_vector(vector), effects=tuple(terms))
