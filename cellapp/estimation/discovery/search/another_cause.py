"""Evidence for a law outside the library in place of a name, if the readings are too few to search for such laws.

If the readings determine all values of a data-driven term, it competes with every name. With fewer readings nothing
else takes a name's place, and whatever looks a little like the cause is named. There the same functions in the same
channels get normal priors: their evidence needs no value to be determined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import visible_squares
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.projected_residual import MOST_SHARE, ProjectedResidual
from cellapp.estimation.discovery.search.scan import NO_DISPLACEMENT
from cellapp.estimation.discovery.terms import ModelTerm
from cellapp.robot.effects import EFFECTS, Channel, DriverVariable, EffectColumn
from cellapp.robot.effects.data_driven import DataChannel, channels, form_of
from cellapp.robot.effects.unknown import (
    FunctionFamily,
    FunctionTable,
    channel_directions,
    curve_families,
    own_angles,
    pair_families,
)
from cellapp.robot.kinematics.transforms import Array

COORDINATES_EACH = 4
"""Measured coordinates needed for each parameter of a model with a data-driven term; with fewer it could fit noise."""


def fitted_parameters(fit: JointFit) -> int:
    """Count the parameters of a model beside a data-driven term: those without priors, and all of the geometry."""
    return int(np.count_nonzero(fit.precision == 0.0)) + fit.layout.geometric


def too_few_to_compete(data: ArmData, fit: JointFit) -> bool:
    """Return whether the readings are too few for some data-driven laws of one or two joint angles."""
    most = max(Families.of(data, pair_families(data.context, own_angles(data.context))).sizes, default=0)
    return COORDINATES_EACH * (int(most) + fitted_parameters(fit)) > 3 * len(data)


def gains_by_another_cause(data: ArmData, fit: JointFit, numbers: Sequence[int]) -> list[float]:
    """Return twice the log evidence of the best law outside the library in place of each term, less the price of
    choosing.

    Laws with the term's own cause do not count: functions of variables that the effect depends on, and functions of a
    moved joint's own angle in the same channel.
    """
    context, every = data.context, channels(data.context.joints)
    families = [*curve_families(context), *pair_families(context, own_angles(context))]
    evaluated, gains = Families.of(data, families), list[float]()
    for number in numbers:
        values = ChannelScan.of(data, fit, fit.residual_without(number)).evidence(evaluated, every)
        tried = int(np.count_nonzero(np.isfinite(values)))
        values[_of_same_cause(fit.terms[number], fit.term_columns(number), every, families)] = -math.inf
        gains.append(float(values.max(initial=-math.inf)) - 2.0 * math.log(max(tried, 1)))
    return gains


def _of_same_cause(
    term: ModelTerm,
    columns: tuple[EffectColumn, ...],
    every: tuple[DataChannel, ...],
    families: list[FunctionFamily],
) -> NDArray[np.bool_]:
    """Return a mask (channels, families) of the functions that are a named effect in another shape."""
    own = EFFECTS[term.slug].variables
    moved = {(column.channel, column.index) for column in columns}
    found = np.zeros((len(every), len(families)), dtype=bool)
    for row, channel in enumerate(every):
        moves_alike = (channel.channel, channel.joint) in moved
        for place, family in enumerate(families):
            form = form_of(channel, family.drivers)
            if form.variables <= own:
                of_angles = form.variables <= {DriverVariable.JOINT_ANGLE}
                of_its_joint = all(one.joint in (None, channel.joint) for one in family.drivers)
                found[row, place] = not of_angles or (moves_alike and of_its_joint)
    return found


# -- Scores of data-driven laws: every family of functions in every channel, without forming their rows ---------------
#
# A law has functions f (k, n) of its variables, in a channel whose directions move the SMR by u_d (3, n) per unit,
# whitened: its rows are f u_d. In the complement M = I - Q Q^T of a model's parameters its information and moments are
#
#     B M B^T = f K_de f^T,    K_de = sum_ab diag(u_da) M_ab diag(u_eb),    (n, n)
#     B M y = f (u_d . M y)
#
# for directions d, e, with M and M y of coordinates a, b. K depends on the directions alone, so all families share it.
# The score is that of ``search.scan`` for a law of one block.


_FAMILIES_AT_ONCE = 128
"""Batch size of families of equal size: bounds the memory (24 functions each, 800 parameters: 20 MB)."""
_SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Sizes of a law's functions relative to the noise (rms, of a coordinate), tried for its evidence."""
MOST_COLUMNS = 72
"""Most columns of a law: a shift in three directions by 24 functions, or an offset of a joint by all."""
_Judge = Callable[[Array, Array, Array], Array]
"""Function that judges b laws: information, norms and moments -> values (b,)."""


@dataclass(frozen=True, eq=False)
class _Direction:
    """One direction of a channel: u (3, n), and u . M y (n,)."""

    unit: Array
    moment: Array


@dataclass(frozen=True, eq=False)
class ChannelScan:
    """Directions of all channels in the complement of a fit's parameters.

    Attributes
    ----------
    directions : mapping
        Directions of each channel.
    residual : ProjectedResidual
    """

    directions: Mapping[DataChannel, tuple[_Direction, ...]]
    residual: ProjectedResidual

    @classmethod
    def of(cls, data: ArmData, fit: JointFit, residual: ProjectedResidual | None = None) -> ChannelScan:
        """Compute the directions of all channels of an arm; a shift in any direction shares those of its parts.

        ``residual`` is that of the fit if None, else for instance that without a term.
        """
        n, residual = len(data), fit.projected_residual if residual is None else residual
        left = residual.projected.reshape(3, n)

        def direction(unit: Array) -> _Direction:
            return _Direction(unit, np.einsum("an,an->n", unit, left))

        found: dict[DataChannel, tuple[_Direction, ...]] = {}
        several = []
        for channel in channels(data.context.joints):
            if channel.channel is Channel.JOINT:
                found[channel] = (direction(fit.by_joint[:, channel.joint]),)
            elif len(channel.parts) > 1:
                several.append(channel)
            else:
                (moved,) = channel_directions(data.context, channel)
                found[channel] = (direction(np.einsum("acn,nc->an", fit.white, moved)),)
        for channel in several:
            found[channel] = tuple(found[part][0] for part in channel.parts)
        return cls(found, residual)

    def scores(self, families: Families, chosen: Sequence[DataChannel]) -> Array:
        """Return the score (channels, families) of each law, without the price of choosing it; minus infinity if it is
        invisible or has too many columns."""
        return self._over(families, chosen, self._gain)

    def evidence(self, families: Families, chosen: Sequence[DataChannel]) -> Array:
        """Return twice the gain of log evidence (channels, families) by each law; otherwise as ``scores``.

        The values of a law have normal priors of a common size, scaled so that each function moves the SMR alike; the
        best of several sizes is taken. So few readings can show a law even if they do not determine all its values.
        """
        return self._over(families, chosen, self._log_evidence)

    def _over(self, families: Families, chosen: Sequence[DataChannel], judge: _Judge) -> Array:
        values = np.full((len(chosen), len(families.sizes)), -np.inf)
        batches = families.batches()
        kernel = self.residual.projector.kernel
        for row, channel in enumerate(chosen):
            directions = self.directions[channel]
            # project the distinct functions only: families share many, and one large product is faster than many small
            # ones
            projected = [
                [families.distinct @ kernel(one.unit, other.unit) for other in directions[: k + 1]]
                for k, one in enumerate(directions)
            ]
            for numbers, places in batches:
                if len(directions) * places.shape[1] <= MOST_COLUMNS:
                    those = [[one[places] for one in row_of] for row_of in projected]
                    values[row, numbers] = judge(*_information(families.distinct[places], directions, those))
        return values

    def _gain(self, gram: Array, norms: Array, moments: Array) -> Array:
        """Return the gain of the BIC (b,)."""
        explained, rank = visible_squares(gram, norms, moments)
        share = np.minimum(explained / self.residual.square, MOST_SHARE)
        freedom = self.residual.freedom
        value = -freedom * np.log1p(-share) - rank * math.log(freedom)
        return np.where((rank > 0) & (norms.max(axis=1) > NO_DISPLACEMENT), value, -np.inf)

    def _log_evidence(self, gram: Array, norms: Array, moments: Array) -> Array:
        """Return twice the log evidence (b,) at the best of ``_SIZES`` and of noise, less the price of that choice."""
        scale = math.sqrt(len(self.residual)) / np.maximum(norms, NO_DISPLACEMENT)
        values, vectors = np.linalg.eigh(gram * scale[:, :, None] * scale[:, None, :])
        values = np.maximum(values, 0.0)[None]
        along = np.einsum("bkr,bk->br", vectors, scale * moments)[None] ** 2
        size = np.array(_SIZES)[:, None, None] ** 2
        share = np.minimum(np.sum(along * size / (1.0 + size * values), axis=2) / self.residual.square, MOST_SHARE)
        found = -self.residual.freedom * np.log1p(-share) - np.sum(np.log1p(size * values), axis=2)
        return np.asarray(found.max(axis=0) - 2.0 * math.log(len(_SIZES)))


def _information(
    functions: Array, directions: Sequence[_Direction], projected: Sequence[Sequence[Array]]
) -> tuple[Array, Array, Array]:
    """Compute information (b, m, m), norms and moments (b, m) of b families of functions f (b, k, n) in one channel.

    ``projected`` holds f K_de (b, k, n).
    """
    size = functions.shape[1]
    gram = np.empty((len(functions), len(directions) * size, len(directions) * size))
    squares = np.empty((len(functions), len(directions) * size))
    for i, one in enumerate(directions):
        here = slice(i * size, (i + 1) * size)
        squares[:, here] = functions**2 @ np.einsum("an,an->n", one.unit, one.unit)
        for j, of_pair in enumerate(projected[i]):
            there = slice(j * size, (j + 1) * size)
            block = of_pair @ functions.swapaxes(1, 2)
            gram[:, here, there] = block
            gram[:, there, here] = block.swapaxes(1, 2)
    moments = np.concatenate([functions @ one.moment for one in directions], axis=1)
    return gram, np.sqrt(squares), moments


@dataclass(frozen=True, eq=False)
class Families:
    """The ``distinct`` functions (u, n) of some families, and the indices of each family's functions among them."""

    distinct: Array
    places: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, data: ArmData, members: Sequence[FunctionFamily]) -> Families:
        """Evaluate the functions at the readings."""
        table = FunctionTable(data.context)
        found: dict[bytes, tuple[int, Array]] = {}
        places = [
            np.array([found.setdefault(f.tobytes(), (len(found), f))[0] for f in of_one.values()], dtype=np.intp)
            for of_one in (table.functions(one.drivers, one.constants) for one in members)
        ]
        return cls(np.array([f for _, f in found.values()]), tuple(places))

    @property
    def sizes(self) -> NDArray[np.intp]:
        """Number of functions of each family."""
        return np.array([len(one) for one in self.places], dtype=np.intp)

    def batches(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return batches of families of equal size: their indices, and those of their functions (b, k)."""
        found = []
        for size in np.unique(self.sizes):
            numbers = np.flatnonzero(self.sizes == size)
            for begin in range(0, len(numbers), _FAMILIES_AT_ONCE):
                some = numbers[begin : begin + _FAMILIES_AT_ONCE]
                found.append((some, np.stack([self.places[k] for k in some])))
        return found
