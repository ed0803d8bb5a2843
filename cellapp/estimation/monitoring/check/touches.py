"""A check without a tracker: touches of sockets whose places are unknown.

Each touch says where the ball is by the model; all touches of a socket agree while nothing has changed. The unknown
place falls out of the contrasts of Helmert: touch k of a socket less the mean of those before, times (k - 1 / k)^1/2.
They are uncorrelated where touches are, each needs earlier touches only, and they obey the same linear model as stops,

    y = C (V b + e),    e ~ N(0, K)    ->    rows C V, covariance C K C^T,

so that the sequential test, its promised error rates and the naming of changes are those of the check with a tracker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check.conclusion import concluded
from cellapp.estimation.monitoring.check.linear import StopRows, expected, stop_rows
from cellapp.estimation.monitoring.check.model import FALSE_ALARM, MISS, CheckBelief, Conclusion, SequentialState
from cellapp.estimation.monitoring.check.naming import Design
from cellapp.estimation.monitoring.check.sequential import design_of, judged
from cellapp.estimation.readings import Readings
from cellapp.estimation.sockets import placed
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

FEWEST_TOUCHES = 4
"""Touches of one socket below which nothing is named: three contrasts are nine numbers."""
_HIDDEN = 0.03
"""Share of the motion by a change below which touches of a socket do not show it: the base carries socket and arm
alike, as far as the socket's place is unknown."""


@dataclass(frozen=True, eq=False)
class TouchCheck:
    """The outcome: the conclusion, where the test stood after each touch but the first of a socket, and the errors.

    ``errors_m`` (n,) is how far each touch lies from the mean of its socket by the model [m]; ``hidden`` names what
    touches of these sockets cannot show.
    """

    conclusion: Conclusion
    standings: tuple[SequentialState, ...]
    readings: Mapping[str, Readings]
    errors_m: Mapping[str, Array]
    hidden: tuple[str, ...]


def check_touches(
    belief: CheckBelief, touches: Mapping[str, Readings], *, false_alarm: float = FALSE_ALARM, miss: float = MISS
) -> TouchCheck:
    """Judge a calibration by touches of sockets.

    ``touches`` are readings in sockets, arm -> touches in the order of measurement.

    Raises
    ------
    InputError
        If an arm is unknown, or there are too few touches of one socket.
    """
    for name, its in touches.items():
        if name not in belief.arms:
            raise InputError(f"check: the calibration has no arm '{name}'; it has {', '.join(belief.arms)}")
        if len(its) < FEWEST_TOUCHES:
            raise InputError(f"check: {len(its)} touches of arm '{name}'; at least {FEWEST_TOUCHES} are needed")
    computed = expected(belief, touches)
    at = {name: placed(its, computed[name]) for name, its in touches.items()}
    design = design_of(belief, false_alarm, miss)
    stops = contrasts(stop_rows(belief, at, design.directions), _points(belief, at))
    design, hidden = _as_touches_show(design, stops)
    planned = len(stops.stop_ends)
    standings = [judged(design, stops.first(count), planned) for count in range(1, planned + 1)]
    return TouchCheck(
        conclusion=concluded(design, stops, standings[-1]),
        standings=tuple(standings),
        readings=at,
        errors_m={name: np.linalg.norm(its.p_M - computed[name], axis=1) for name, its in at.items()},
        hidden=hidden,
    )


def contrasts(stops: StopRows, point: NDArray[np.intp]) -> StopRows:
    """Contrasts of touches, each a stop of its own, in which the unknown place of their ``point`` (m,) is not."""
    rows, arms = [], []
    for touch in range(len(point)):
        before = np.flatnonzero(point[:touch] == point[touch])
        if not len(before):
            continue
        row = np.zeros(len(point))
        row[touch], row[before] = 1.0, -1.0 / len(before)
        rows.append(row * np.sqrt(len(before) / (len(before) + 1.0)))
        arms.append(stops.arm_of[touch])
    C = np.kron(np.array(rows), np.eye(3))
    half = C @ stops.factor
    return replace(
        stops,
        measured=(C @ stops.left.ravel()).reshape(-1, 3),
        expected=np.zeros((len(rows), 3)),
        stop_ends=3 * np.arange(1, len(rows) + 1, dtype=np.intp),
        arm_of=np.array(arms, dtype=stops.arm_of.dtype),
        rows=stops.rows @ C.T,
        factor=scipy.linalg.cholesky(half @ half.T, lower=True),
    )


def _points(belief: CheckBelief, touches: Mapping[str, Readings]) -> NDArray[np.intp]:
    """Number of the point of each touch, arm by arm as ``stop_rows`` has them; arms share no point."""
    names = [(arm, point) for arm in belief.arms if arm in touches for point in touches[arm].point or ()]
    number = {name: place for place, name in enumerate(dict.fromkeys(names))}
    return np.array([number[name] for name in names], dtype=np.intp)


def _as_touches_show(design: Design, stops: StopRows) -> tuple[Design, tuple[str, ...]]:
    """The design without changes that leave touches as they are, and the names of those."""
    share = np.sqrt(np.sum(stops.rows**2, axis=1) / len(stops.measured))
    one_step = np.array([max(float(np.sqrt(np.mean(np.sum(m**2, axis=1)))), 1e-300) for m in _motions(design)])
    shown = share > _HIDDEN * one_step
    shown &= np.array([one.kind not in ("tracker", "base") for one in design.directions])
    alternatives = tuple(one for one in design.alternatives if all(shown[list(one.members)]))
    kept = {one.what for one in alternatives}
    hidden = [design.name_of(one) for one in design.alternatives if one.what not in kept]
    return replace(design, alternatives=alternatives, visible=design.visible & shown), tuple(dict.fromkeys(hidden))


def _motions(design: Design) -> list[Array]:
    """Motion (n, 3) [m] of the SMR by one step of each direction at the calibration's readings of its arm."""
    first = next(iter(design.motions))
    return [
        design.motions[one.arm if one.arm in design.motions else first][k] for k, one in enumerate(design.directions)
    ]
