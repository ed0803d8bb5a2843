"""Measure a few SMR points from the tracker's new station, one arm after the other, each better predicted than before.

The station is known only roughly: ``measuring`` searches for the first SMR, and finds the next ones at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cellapp.cell.driving.measuring import APART_M, MOST_MISSED, FoundPoint, SmrSearch, points_of
from cellapp.cell.driving.motion import MotionRefused, Mover, Vector
from cellapp.cell.driving.target_visit import drive_to
from cellapp.cell.safety.cell_bodies import clear_with_others, visible_with_others
from cellapp.cell.safety.gate import refuse_motion
from cellapp.estimation.calibration.station_location import StationFit, fit_station
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError
from cellapp.robot.kinematics.transforms import Array, twist_columns
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import relocated
from drivers.arms.protocol import ArmState

# -- Choose the joint positions with most information about the tracker's station, one by one as it becomes known -----


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

    mover: Mover
    model: CellModel
    candidates: Mapping[str, Array]
    _tried: dict[str, set[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._homes, self._bodies = self.mover.homes, self.mover.bodies
        self.candidates = {name: _thinned(q) for name, q in self.candidates.items()}
        self._clear = {
            name: clear_with_others(self._bodies, self._homes, {name: q}) for name, q in self.candidates.items()
        }
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
            if not refuse_motion(self._bodies, self._homes, {**self._homes, name: q[row]}):
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

    def _seen(self, name: str, model: CellModel) -> np.ndarray:
        q = self.candidates[name]
        assert self._bodies.field is not None
        T_C_B = self._bodies.arms[name].geometry.T_M_B()
        T_C_M = T_C_B @ np.linalg.inv(model.arms[name].geometry.T_M_B())
        bodies = replace(self._bodies, field=replace(self._bodies.field, T_C_M=T_C_M))
        seen = visible_with_others(bodies, self._homes, name, {name: q})
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


_REPEATS = 5
"""Measurements of each point: their mean has less than half the scatter of one."""


@dataclass(frozen=True, eq=False)
class LocatedStation:
    """Points and the best fitting station."""

    found: tuple[FoundPoint, ...]
    points: Mapping[str, Readings]
    fit: StationFit
    notes: tuple[str, ...]


def locate_station(
    mover: Mover,
    model: CellModel,
    rough_T: Array,
    candidates: Mapping[str, Array],
    excess_m: Mapping[str, float],
    total: int,
) -> LocatedStation:
    """Measure ``total`` points, one arm at a time with the others at home, fit the station, and go home.

    ``model`` is in the tracker frame of its calibration; ``rough_T`` (4, 4) maps that frame into a guess of the present
    one. ``candidates`` are as in ``LocatingStops``, ``excess_m`` as in ``fit_station``. Raise as ``moving_cell``,
    ``HardwareError`` if too few SMRs are found, and ``InputError`` if they are too close together or on one line.
    """
    search = SmrSearch(model, mover, rough_T, excess_m, _REPEATS)
    measuring = _Measuring(mover, LocatingStops(mover, model, candidates), search)
    count, remainder = divmod(total, len(candidates))  # the first arms take the remainder
    measuring.measure({name: count + (k < remainder) for k, name in enumerate(candidates)})
    points = points_of(search.found)
    fit = fit_station(model, points, search.T_new_old, excess_m=excess_m, seed=(mover.profile.seed,))
    mover.go_home()
    return LocatedStation(tuple(measuring.found), points, fit, tuple(measuring.notes))


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Measuring:
    mover: Mover
    stops: LocatingStops
    search: SmrSearch
    notes: list[str] = field(default_factory=list)
    _missed: int = 0

    @property
    def found(self) -> list[FoundPoint]:
        """Points found so far."""
        return self.search.found

    def measure(self, wanted: Mapping[str, int]) -> None:
        """Measure until each arm has its number of points, or no more candidates; other arms then measure more."""
        total = max(sum(wanted.values()), len(self.found))
        for name, count in wanted.items():
            self._measure_arm(name, count - sum(one.arm == name for one in self.found), total)
        for name in wanted:
            self._measure_arm(name, total - len(self.found), total)
        if len(self.found) < total:
            self.notes.append(f"{len(self.found)} of {counted(total, 'point')} could be measured")

    def _measure_arm(self, name: str, count: int, total: int) -> None:
        """Measure ``count`` points of one arm, as long as there are candidates that the tracker should see."""
        while count > 0:
            self.mover.hold()
            q = self.stops.best(name, self.search.T_new_old)
            if q is None:
                self.notes.append(f"arm {name}: no further joint positions are in the tracker's sight and within reach")
                return
            self.mover.control.tell("locate", len(self.found), total, f"arm {name}")
            if self._visit(name, q):
                count -= 1

    def _visit(self, name: str, q: Vector) -> bool:
        """Move to joint positions and measure; note a refused motion or an SMR that is not found."""
        try:
            state = self._go(name, q)
        except MotionRefused as error:
            self.notes.append(f"arm {name}: {error}")
            return False
        found = self.search.measure(name, state)
        if isinstance(found, str):
            self.notes.append(found)
            self._missed += 1
            if self._missed >= MOST_MISSED[bool(self.found)]:
                raise HardwareError(self._lost_words(name))
            return False
        self._missed = 0
        self.stops.measured(name, state.q, self.search.T_new_old)
        return True

    def _go(self, name: str, q: Vector) -> ArmState:
        """Move one arm, the others at home, with a short last motion: effects that depend on it are known for those."""
        here = self.mover.positions()[name]
        return drive_to(self.mover, {name: q}, {name: np.sign(q - here)})[name]

    def _lost_words(self, name: str) -> str:
        tried = f"{self._missed} SMRs in a row were not found, the last one of arm {name}"
        if self.found:
            return f"{tried}, although {len(self.found)} were: look for a covered or missing SMR; {self.notes[-1]}"
        return (
            f"{tried}: the tracker stands or looks elsewhere than assumed; give its pose in the cell to about 50 mm and"
            f" 1 deg with --tracker-pose. {self.notes[-1]}"
        )
