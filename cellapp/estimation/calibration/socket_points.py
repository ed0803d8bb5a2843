"""Unknown points as parameters of a fit, with known distances as their priors.

Let c be the points, and c0 a guess that meets all known distances along the present directions u = (c_a - c_b) / |..|.
To first order, the distances d contribute

    sum_d ((u (c_a - c0_a) - u (c_b - c0_b)) / sigma_d)^2  =  (c - c0)^T L (c - c0).

In the eigenvectors V of L, c = c0 + V z, each z has an independent prior: standard deviation lambda^-1/2, none if
lambda is zero. Points are then further columns like those of effects, and nothing else changes: c0 counts as measured,
and the ball is shifted by -V z from where the arm says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellapp.estimation.calibration.normal_equations import EffectColumns
from cellapp.estimation.sockets.contacts import Contacts
from cellapp.robot.kinematics.transforms import Array

_NO_DISTANCE = 1e-9
"""Share of the largest eigenvalue below which distances do not fix a direction."""


@dataclass(frozen=True, eq=False)
class PointColumns:
    """The points of n readings as 3 P parameters.

    Attributes
    ----------
    contacts : Contacts
    at : array, shape (P, 3)
        Guess c0 of the points [m].
    basis : array, shape (3 P, 3 P)
        Directions of the parameters.
    prior_sd : array, shape (3 P,)
        Standard deviation of each [m], infinite without a distance.
    """

    contacts: Contacts
    at: Array
    basis: Array
    prior_sd: Array

    @classmethod
    def near(cls, contacts: Contacts, centres: Array) -> PointColumns:
        """Linearise at points (P, 3) [m], moved as little as needed to meet the known distances."""
        size = 3 * len(contacts.names)
        rows, short_by = np.zeros((len(contacts.pairs), len(contacts.names), 3)), np.zeros(len(contacts.pairs))
        for number, (a, b) in enumerate(contacts.pairs.tolist()):
            between = centres[a] - centres[b]
            length = max(float(np.linalg.norm(between)), 1e-9)
            rows[number, a], rows[number, b] = between / length, -between / length
            short_by[number] = contacts.distance_m[number] - length
        flat = rows.reshape(-1, size)
        at = centres + (np.linalg.pinv(flat) @ short_by).reshape(-1, 3) if len(flat) else centres
        information, basis = np.linalg.eigh(flat.T @ (flat / contacts.sigma_m[:, None] ** 2))
        fixed = information > _NO_DISTANCE * max(float(information[-1]), 1.0)
        prior_sd = np.full(size, np.inf)
        prior_sd[fixed] = information[fixed] ** -0.5
        return cls(contacts, at, basis, prior_sd)

    def __len__(self) -> int:
        return len(self.prior_sd)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, which are combinations of coordinates of all points."""
        return tuple(f"points {number}" for number in range(1, len(self) + 1))

    @property
    def measured(self) -> Array:
        """Guess c0 of each reading's point (n, 3) [m]."""
        return self.at[self.contacts.index]

    @property
    def shifts(self) -> Array:
        """Shift of the ball per unit of each parameter (3 P, 3, n): opposite to that of its point."""
        return -self.basis.reshape(-1, 3, len(self))[self.contacts.index].transpose(2, 1, 0)

    def after(self, effects: EffectColumns | None) -> EffectColumns:
        """Append these columns to those of effects."""
        count, n = len(self), len(self.contacts.index)
        if effects is None:
            return EffectColumns(
                names=self.names,
                units=("m",) * count,
                joints=np.zeros(0, dtype=np.intp),
                offsets=np.zeros((0, n)),
                shifts_M=self.shifts,
                prior_sd=self.prior_sd,
            )
        without = np.full(len(effects.names), np.inf)
        start = np.zeros(len(effects.names)) if effects.start is None else effects.start
        return replace(
            effects,
            names=(*effects.names, *self.names),
            units=(*effects.units, *("m",) * count),
            shifts_M=np.concatenate([effects.shifts_M, self.shifts]),
            prior_sd=np.concatenate([without if effects.prior_sd is None else effects.prior_sd, self.prior_sd]),
            start=np.concatenate([start, np.zeros(count)]),
        )
