"""A UR arm that also follows paths: its worker streams joint positions with ``servoj`` at the controller's rate."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.arms.path_checks import checked_path
from drivers.arms.protocol import LinkLost
from drivers.arms.recording import JointRecord
from drivers.arms.ur import UrArm
from drivers.arms.ur_answers import arm_error
from drivers.arms.ur_guarded_link import ANSWER_WITHIN_S
from drivers.arms.ur_motion import STILL_MOVING
from drivers.arms.ur_recorder import UrRecorder
from drivers.arms.ur_worker_process import WorkerGone, WorkerRefusal

_CB3_PERIOD_S, _PERIOD_S = 0.008, 0.002
"""Control cycles of the CB3 series (125 Hz) and of all later ones (500 Hz)."""


class UrPathArm(UrArm):
    """One UR arm, see ``UrArm``. The worker receives the whole path and sends it by its own clock."""

    _recorder: UrRecorder | None = None

    @property
    def path_period_s(self) -> float:
        """Control cycle of the connected controller [s]."""
        return _CB3_PERIOD_S if self._connected().series == "CB3" else _PERIOD_S

    def start_path(self, q: NDArray[np.float64], period_s: float) -> None:
        """Stream joint positions ``q`` (m, 6) [rad]. The arm must rest at the first one; the worker checks this again.

        Raises ``LimitExceeded`` before anything is sent, otherwise as ``start_move``.
        """
        controller_period_s = self.path_period_s
        state = self.state()
        if state.moving:  # before the checks of the path: the position of a moving arm means nothing
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

    def end_path(self) -> None:
        """Slow down along the path and rest on it; from any thread. Raises ``LinkLost``."""
        worker = self._worker
        if worker is None:
            return
        try:
            worker.call("end_path", ANSWER_WITHIN_S)
        except (WorkerGone, WorkerRefusal) as error:
            raise LinkLost(f"arm {self._name}: the path could not be ended: {error}") from error

    def reached(self) -> float:
        """Return the row at which ``end_path`` ended the last path; inf if it did not."""
        return float(self._call("reached", ANSWER_WITHIN_S).get("reached", math.inf))

    # -- recording -----------------------------------------------------------------------------------------------------

    def start_recording(self) -> None:
        """Record every state of the controller over a separate connection. Raises ``LinkLost``."""
        self._end_recorder()
        self._recorder = UrRecorder(self._name, self._host, self.path_period_s, self._settings.trigger_output)

    def pulse(self) -> bool:
        """Send a pulse at the controller's output; return False if there is none."""
        return self._recorder is not None and self._recorder.pulse()

    def recorded(self) -> tuple[int, int]:
        """Return the numbers of received and lost samples."""
        recorder = self._recorder
        return (0, 0) if recorder is None else recorder.so_far()

    def end_recording(self) -> JointRecord:
        """Return all samples. Raises ``LinkLost`` if the connection ended before."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            raise LinkLost(f"arm {self._name}: it is not being recorded")
        return recorder.end()

    def disconnect(self) -> None:
        """Stop the arm and close all connections."""
        self._end_recorder()
        super().disconnect()

    def _end_recorder(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()
