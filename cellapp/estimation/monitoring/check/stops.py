"""Choose stops that show every visible change.

Stops are chosen greedily. Each direction k has the information I_k = b_k^T R^-1 b_k of one step, minus the part that
the motion of a tracker that was set up anew explains; I_k is the non-centrality of its test. The stop that lowers
sum_k exp(-I_k / s) most is taken: a smooth form of the least I_k, in which well-shown directions weigh little. The
uncertainty of the calibration is neglected: it is a fifth of the noise if the calibration has twenty times the stops.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cellapp.estimation.monitoring.check.alternatives import Direction, directions_of
from cellapp.estimation.monitoring.check.belief import noise_covariance
from cellapp.estimation.monitoring.check.linear import calibration_motions, conditions_now, motions, visibility
from cellapp.estimation.monitoring.check.model import TRACKER, ArmBelief, CheckBelief, ChosenStops, Power
from cellapp.estimation.prior.linear_model import Measured
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, quaternions_of

NEEDED = 32.0
"""Non-centrality at which a change is found with 95 % at 1 % false alarms among some hundred correlated directions: the
square of 4.0 (the corrected quantile) and 1.65 standard errors."""
_SOFTNESS = 6.0
"""``s``: a direction with the needed information weighs 1/200 of one with none."""
_KNOWN = 1e-6
"""Prior information on a step of the tracker's motion: keeps it solvable while one stop does not determine it."""
_LEAST_INFORMATION = 1e-9
"""Lower bound of the information in divisions, for directions that the stops do not show at all."""


def choose_stops(
    belief: CheckBelief, candidates: Mapping[str, Array], count: int, *, start: Mapping[str, Array] | None = None
) -> ChosenStops:
    """Choose ``count`` stops of all arms, in order, that show the weakest visible change as well as possible.

    Parameters
    ----------
    belief : CheckBelief
    candidates : mapping
        Arm -> configurations (n, N) [rad]; row k of all arms is one stop. They must be reachable and visible: the
        configurations of the calibration's own readings are.
    count : int
        Number of stops; all n if there are no more.
    start : mapping, optional
        Arm -> configuration (N,) before the first stop [rad]: determines the approach signs of its joints.
    """
    directions = directions_of(belief)
    moved, visible = visibility(belief, directions, calibration_motions(belief, directions))
    weights = np.where(visible, 1.0, 0.0) if np.any(visible) else np.ones(len(directions))
    n = len(next(iter(candidates.values())))
    here = dict(start or {})
    tracker = [k for k, one in enumerate(directions) if one.arm == TRACKER]
    G = np.zeros((len(directions), len(directions)))
    free, order = np.ones(n, dtype=bool), []
    for _ in range(min(count, n)):
        white = _whitened(belief, candidates, here, directions)
        gained = _beside_station(G, white, tracker) if belief.station_free else _added(G, white)
        scores = np.where(free, -(weights[:, None] * np.exp(-gained / _SOFTNESS)).sum(axis=0), -np.inf)
        chosen = int(np.argmax(scores))
        G += white[:, :, chosen] @ white[:, :, chosen].T
        free[chosen] = False
        order.append(chosen)
        here = {name: q[chosen] for name, q in candidates.items()}
    final = np.diag(G) if not belief.station_free else _projected(G, tracker)
    power = tuple(
        power_of(one, float(final[k]), float(moved[k]), bool(visible[k]), NEEDED) for k, one in enumerate(directions)
    )
    return ChosenStops(np.array(order, dtype=np.intp), power, NEEDED)


def power_of(one: Direction, noncentrality: float, moved_m: float, visible: bool, needed: float) -> Power:
    """Compute the power of stops to show a change; ``needed`` is the non-centrality at which it is found."""
    return Power(
        arm=one.arm,
        what=one.what,
        kind=one.kind,
        noncentrality=noncentrality,
        moved_mm=moved_m * 1e3,
        visible=visible,
        unit=one.unit,
        detected=one.step * math.sqrt(needed / max(noncentrality, _LEAST_INFORMATION)),
    )


def _whitened(
    belief: CheckBelief, candidates: Mapping[str, Array], here: Mapping[str, Array], directions: Sequence[Direction]
) -> Array:
    """Compute motions (C, d, n) of all arms at each candidate in units of the noise, approached from ``here``."""
    readings = {name: _imagined(q, here.get(name)) for name, q in candidates.items()}
    conditions = conditions_now(belief, readings)
    found = []
    for name, its in readings.items():
        arm = belief.arms[name]
        measured = _as_measured(arm, its, conditions[name])
        rows, noise = motions(belief, name, measured, directions), noise_covariance(arm, arm.measured)
        kinds = ((measured.points, arm.measured.points), (~measured.points, ~arm.measured.points))
        found += [
            np.einsum("ac,knc->kan", _whitener(noise[known]), rows[:, asked]) for asked, known in kinds if asked.any()
        ]
    return np.concatenate(found, axis=1)


def _as_measured(arm: ArmBelief, imagined: Readings, conditions: MeasurementConditions) -> Measured:
    """Convert simulated readings to vectors, with the predicted orientation if the check measures it."""
    if arm.measured.turned is not None:
        turns = arm.model.orientation(imagined.q, conditions)
        imagined = replace(imagined, quaternion_M=quaternions_of(turns))
    return Measured.of(imagined, conditions)


def _whitener(covariances: Array) -> Array:
    """Compute the whitening matrix (3, 3) from the mean covariance (n, 3, 3) of the calibration's readings."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(np.mean(covariances, axis=0))))


def _imagined(q: Array, here: Array | None) -> Readings:
    """Build hypothetical readings at configurations ``q`` (n, N) [rad], each approached from ``here`` (N,)."""
    step = np.zeros_like(q) if here is None else q - here
    return Readings(
        configuration=np.arange(len(q)),
        time_s=np.full(len(q), np.nan),
        q=q,
        approach=np.sign(step).astype(np.int8),
        step=None if here is None else step,
        p_M=np.zeros((len(q), 3)),
    )


def _added(G: Array, white: Array) -> Array:
    """Compute the information (C, n) of each direction if one of n stops with motions ``white`` (C, d, n) is added."""
    return np.asarray(np.diag(G)[:, None] + np.einsum("kdn,kdn->kn", white, white))


def _projected(G: Array, tracker: Sequence[int]) -> Array:
    """Compute the information (C,) of each direction with an unknown tracker, from the joint information G (C, C)."""
    own = G[np.ix_(tracker, tracker)] + _KNOWN * np.eye(len(tracker))
    return np.asarray(np.diag(G) - np.einsum("tk,tk->k", G[tracker], np.linalg.solve(own, G[tracker])))


def _beside_station(G: Array, white: Array, tracker: Sequence[int]) -> Array:
    """Compute ``_projected`` (C, n) if one of n stops with motions ``white`` (C, d, n) is added."""
    rows = white[tracker]
    own = G[np.ix_(tracker, tracker)] + _KNOWN * np.eye(len(tracker))
    own = own + np.einsum("idn,jdn->nij", rows, rows)
    cross = G[tracker] + np.einsum("idn,kdn->nik", rows, white)
    lost = np.einsum("nik,nik->kn", cross, np.linalg.solve(own, cross))
    return np.asarray(_added(G, white) - lost)
