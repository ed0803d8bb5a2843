"""A UR arm that also follows paths: its worker streams joint positions with ``servoj`` at the controller's rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.arms.path_checks import checked_path
from drivers.arms.protocol import FollowedPath
from drivers.arms.ur import UrArm
from drivers.arms.ur_answers import arm_error
from drivers.arms.ur_checks import JOINTS
from drivers.arms.ur_motion import STILL_MOVING

_CB3_PERIOD_S, _PERIOD_S = 0.008, 0.002
"""Control cycles of the CB3 series (125 Hz) and of all later ones (500 Hz)."""
_TRACE_WITHIN_S = 5.0


class UrPathArm(UrArm):
    """One UR arm, see ``UrArm``; the whole path is handed to the worker, which sends it by its own clock."""

    @property
    def path_period_s(self) -> float:
        """Control cycle of the connected controller [s]."""
        return _CB3_PERIOD_S if self._connected().series == "CB3" else _PERIOD_S

    def start_path(self, q: NDArray[np.float64], period_s: float) -> None:
        """Stream joint positions ``q`` (m, 6) [rad]; the arm must rest at the first one, which its worker checks again.

        Raises ``LimitExceeded`` before anything is sent, otherwise as ``start_move``.
        """
        controller_period_s = self.path_period_s
        state = self.state()
        if state.moving:  # first: where it is says nothing
            raise arm_error(self._name, "advised", STILL_MOVING)
        path = checked_path(self._name, q, period_s, controller_period_s, self._limits, state.q)
        self._program.started()
        self._call(
            "path",
            self._settings.startup_timeout,
            self._require_not_braked,
            q=path.tolist(),
            period_s=period_s,
            lookahead_s=self._settings.servo_lookahead,
            gain=self._settings.servo_gain,
        )

    def followed(self) -> FollowedPath:
        """Return what the controller reported of the joints while it followed the last path."""
        answer = self._call("followed", _TRACE_WITHIN_S)
        time_s = np.array(answer["time_s"], dtype=np.float64)
        return FollowedPath(time_s, np.array(answer["q"], dtype=np.float64).reshape(len(time_s), JOINTS))
