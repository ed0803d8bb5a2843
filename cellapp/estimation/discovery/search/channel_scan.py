"""Scores of data-driven laws: every family of functions in every channel, without their rows.

A law has the functions f (k, n) of its variables in a channel whose directions move the SMR by u_d (3, n) per unit,
whitened: its rows are f u_d. In the complement M = I - Q Q^T of a model's parameters its information and moments are

    B M B^T = f diag(u_d . u_e) f^T - (f C_d) (f C_e)^T,    C_d = sum_a diag(u_da) Q_a,    (n, p)
    B M y = f (u_d . M y)

for directions d, e, with Q_a and M y of coordinate a. C_d belongs to a direction alone, so that all families share it.
The score is that of ``search.scan`` for a law of one block.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.design.information import visible_root
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit
from cellapp.estimation.discovery.projected_residual import MOST_SHARE
from cellapp.estimation.discovery.search.scan import NO_DISPLACEMENT
from cellapp.robot.effects import Channel
from cellapp.robot.effects.data_driven import DataChannel, channels
from cellapp.robot.effects.data_functions import FunctionTable
from cellapp.robot.effects.unknown import FunctionFamily, channel_directions
from cellapp.robot.kinematics.transforms import Array

_FAMILIES_AT_ONCE = 128
"""Families of equal size that are scored together: bounds the memory (24 functions each, 800 parameters: 20 MB)."""
MOST_COLUMNS = 72
"""Columns of a law at most: a shift in three directions by 24 functions, an offset of a joint by all."""


@dataclass(frozen=True, eq=False)
class _Direction:
    """One direction of a channel: u (3, n), C (n, p), and u . M y (n,)."""

    unit: Array
    behind: Array
    moment: Array


@dataclass(frozen=True, eq=False)
class ChannelScan:
    """Directions of all channels in the complement of a fit's parameters.

    Attributes
    ----------
    directions : mapping
        Those of each channel.
    square : float
        y^T M y.
    coordinates : int
        3 n.
    """

    directions: Mapping[DataChannel, tuple[_Direction, ...]]
    square: float
    coordinates: int

    @classmethod
    def of(cls, data: ArmData, fit: JointFit) -> ChannelScan:
        """Of all channels of an arm; a shift in any direction shares those of its parts."""
        n = len(data)
        basis = fit.projector.basis.reshape(3, n, -1)
        left = fit.projected_residual.projected.reshape(3, n)

        def direction(unit: Array) -> _Direction:
            behind = sum(unit[a][:, None] * basis[a] for a in range(3))
            return _Direction(unit, np.asarray(behind), np.einsum("an,an->n", unit, left))

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
        return cls(found, fit.projected_residual.square, 3 * n)

    def scores(self, families: Families, chosen: Sequence[DataChannel]) -> Array:
        """Score (channels, families) of each law, without the price of choosing it; minus infinity where it is
        invisible or has too many columns."""
        values = np.full((len(chosen), len(families.sizes)), -np.inf)
        batches = families.batches()
        for row, channel in enumerate(chosen):
            directions = self.directions[channel]
            # of the distinct functions: families share many, and one large product is faster than many small ones
            explained = [families.distinct @ one.behind for one in directions]
            for numbers, places in batches:
                if len(directions) * places.shape[1] <= MOST_COLUMNS:
                    those = [one[places] for one in explained]
                    values[row, numbers] = self._scores(families.distinct[places], directions, those)
        return values

    def _scores(self, functions: Array, directions: Sequence[_Direction], explained: Sequence[Array]) -> Array:
        """Scores (b,) of the laws of b families of functions (b, k, n) in one channel; f C_d (b, k, p) is known."""
        size = functions.shape[1]
        gram = np.empty((len(functions), len(directions) * size, len(directions) * size))
        squares = np.empty((len(functions), len(directions) * size))
        for i, one in enumerate(directions):
            here = slice(i * size, (i + 1) * size)
            squares[:, here] = functions**2 @ np.einsum("an,an->n", one.unit, one.unit)
            for j, other in enumerate(directions[: i + 1]):
                there = slice(j * size, (j + 1) * size)
                weighed = functions * np.einsum("an,an->n", one.unit, other.unit)
                block = weighed @ functions.swapaxes(1, 2) - explained[i] @ explained[j].swapaxes(1, 2)
                gram[:, here, there] = block
                gram[:, there, here] = block.swapaxes(1, 2)
        moments = np.concatenate([functions @ one.moment for one in directions], axis=1)
        norms = np.sqrt(squares)
        root, rank = visible_root(gram, norms)
        u = np.einsum("bkl,bk->bl", root, moments)
        share = np.minimum(np.einsum("bl,bl->b", u, u) / self.square, MOST_SHARE)
        value = -self.coordinates * np.log1p(-share) - rank * math.log(self.coordinates)
        return np.where((rank > 0) & (norms.max(axis=1) > NO_DISPLACEMENT), value, -np.inf)


@dataclass(frozen=True, eq=False)
class Families:
    """The ``distinct`` functions (u, n) of some families, and the places of each family's among these."""

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
        """Number of functions of each."""
        return np.array([len(one) for one in self.places], dtype=np.intp)

    def batches(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Numbers of families of equal size, and the places of their functions (b, k)."""
        found = []
        for size in np.unique(self.sizes):
            numbers = np.flatnonzero(self.sizes == size)
            for begin in range(0, len(numbers), _FAMILIES_AT_ONCE):
                some = numbers[begin : begin + _FAMILIES_AT_ONCE]
                found.append((some, np.stack([self.places[k] for k in some])))
        return found
