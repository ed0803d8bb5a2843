"""Choose the joint positions with most information about the tracker's station, one by one as it becomes known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cellapp.cell.driving.smr_search import APART_M
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import CellBodies, clear_stops, refuse_motion, visible
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, twist_columns
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import relocated

_MOST_CANDIDATES = 300
"""Maximum number of candidates per arm; more are thinned out, because many of them are alike."""
_KNOWN_BEFORE = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05]) ** -2.0
"""Prior information [1/m^2, 1/rad^2]: it keeps the criterion finite; after three points it is negligible."""
_LEAST_SIGMA_M = 1e-5
"""Lower limit of a point's standard uncertainty [m]: the tracker's 10 um, whatever the model states."""


@dataclass(eq=False)
class LocatingStops:
    """Joint positions at which one arm at a time can be measured, the others at home.

    ``candidates``: arm -> (n, N) [rad], joint positions where the model is known: those of its readings.
    """

    profile: Profile
    model: CellModel
    bodies: CellBodies
    candidates: Mapping[str, Array]
    _tried: dict[str, set[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._homes = home_positions(self.profile)
        self.candidates = {name: _thinned(q) for name, q in self.candidates.items()}
        self._clear = {name: self._clear_ones(name, q) for name, q in self.candidates.items()}
        self._information = np.diag(_KNOWN_BEFORE)

    def best(self, name: str, T_new_old: Array) -> Array | None:
        """Return an arm's joint positions (N,) [rad] with most information, for a tracker at ``T_new_old`` (4, 4).

        They are not returned again. None if no others can be reached and seen.
        """
        model = relocated(self.model, T_new_old)
        tried = self._tried.setdefault(name, set())
        q = self.candidates[name]
        usable = self._clear[name] & self._seen(name, model)
        usable[list(tried)] = False
        gains = np.where(usable, -self._spread(model, name), -np.inf)
        for row in np.argsort(-gains, kind="stable").tolist():
            if not np.isfinite(gains[row]):
                return None
            tried.add(row)
            if not refuse_motion(self.bodies, self._homes, {**self._homes, name: q[row]}):
                return np.asarray(q[row])
        return None

    def measured(self, name: str, q: Array, T_new_old: Array) -> None:
        """Add the information of a point measured at ``q`` (N,) [rad]."""
        self._information = self._information + _information(relocated(self.model, T_new_old), name, q[None])[0]

    def _spread(self, model: CellModel, name: str) -> Array:
        """Return the mean variance [m^2] of all candidates due to the station if each one were measured, (n,)."""
        J = [twist_columns(model.predict(other, q)) for other, q in self.candidates.items()]
        mean = sum(np.einsum("nai,naj->ij", own, own) / len(own) for own in J) / len(J)
        covariances = np.linalg.inv(self._information + _information(model, name, self.candidates[name]))
        return np.asarray(np.einsum("nij,ji->n", covariances, mean))

    def _clear_ones(self, name: str, q: Array) -> np.ndarray:
        others = {other: np.tile(home, (len(q), 1)) for other, home in self._homes.items() if other != name}
        return clear_stops(self.bodies, {name: q, **others})

    def _seen(self, name: str, model: CellModel) -> np.ndarray:
        q = self.candidates[name]
        assert self.bodies.field is not None
        T_C_B = self.bodies.arms[name].geometry.T_M_B()
        T_C_M = T_C_B @ np.linalg.inv(model.arms[name].geometry.T_M_B())
        bodies = replace(self.bodies, field=replace(self.bodies.field, T_C_M=T_C_M))
        others = {other: np.tile(home, (len(q), 1)) for other, home in self._homes.items() if other != name}
        seen = visible(bodies, name, q, others)
        p_M = model.predict(name, q)
        for other, home in self._homes.items():
            if other != name:
                seen &= np.linalg.norm(p_M - model.predict(other, home[None]), axis=1) >= APART_M
        return seen


def _thinned(q: Array) -> Array:
    rows = np.unique(np.linspace(0, len(q) - 1, min(len(q), _MOST_CANDIDATES)).round().astype(np.intp))
    return np.asarray(q[rows])


def _information(model: CellModel, name: str, q: Array) -> Array:
    """Return the information (n, 6, 6) about a twist of the tracker frame from a point at each ``q`` (n, N) [rad]."""
    p_M = model.predict(name, q)
    J = twist_columns(p_M)
    variance = np.maximum(model.arms[name].measured_uncertainty(q), _LEAST_SIGMA_M) ** 2
    return np.asarray(J.transpose(0, 2, 1) @ J / variance[:, None, None])
