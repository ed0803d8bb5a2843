"""How the joints followed a stream of positions: late as a whole, which is no error, and beside the path."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel
from cellapp.paths.timing import Trajectory
from cellapp.results import PathLag
from drivers.arms.protocol import FollowedPath

_LONGEST_S = 0.5
"""No controller is later with a stream of positions."""
_FEWEST = 10


def path_lag(arm: ArmModel, sent: Trajectory, followed: FollowedPath) -> PathLag | None:
    """The delay that brings what the encoders read closest to what was sent, and what remains beside the path."""
    if len(followed.time_s) < _FEWEST:
        return None
    time_s, q = followed.time_s, followed.q

    def missed(delay_s: float) -> float:
        return float(np.mean((q - _sent(sent, time_s - delay_s)) ** 2))

    delay_s = float(minimize_scalar(missed, bounds=(0.0, _LONGEST_S), method="bounded", options={"xatol": 1e-5}).x)
    late = time_s - delay_s
    wanted = arm.predict(_sent(sent, late))
    beside = arm.predict(q) - wanted
    way = arm.predict(_sent(sent, late + sent.period_s)) - arm.predict(_sent(sent, late - sent.period_s))
    length = np.linalg.norm(way, axis=1)
    moving = length > 1e-9
    tangent = way[moving] / length[moving, None]
    across = beside[moving] - np.einsum("na,na->n", beside[moving], tangent)[:, None] * tangent
    fastest = float(np.max(np.abs(np.diff(sent.s)), initial=0.0)) / sent.period_s
    cut = float(np.linalg.norm(across, axis=1).max(initial=0.0))
    return PathLag(delay_ms=delay_s * 1e3, late_mm=delay_s * fastest * 1e3, cut_mm=cut * 1e3)


def _sent(sent: Trajectory, time_s: Array) -> Array:
    """Positions (n, N) [rad] that were to be reached at times (n,)."""
    return np.column_stack([np.interp(time_s, sent.time_s, column) for column in sent.q.T])
