"""Tracking of whether a program of this driver may run on a UR controller; stop of its arm over plain connections."""

from __future__ import annotations

from collections.abc import Callable

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_links import cause, stop_program
from drivers.arms.ur_rtde_reader import wait_at_rest

_STOP_WITHIN_S = 1.0
_QUICK_STOP_S, _QUICK_REST_S = 0.2, 0.25
"""Time limits after an interrupted ``connect``, whose program has begun no motion."""


class OwnProgram:
    """Programs that this driver has started on one controller, which may run motions."""

    def __init__(self, host: str, rest_s: float) -> None:
        """``rest_s`` [s] is the longest time to wait for rest."""
        self._host, self._rest_s = host, rest_s
        self._started = self._ended = 0
        """Counters, so that a program that starts while the previous one is brought to rest is not forgotten."""

    @property
    def may_run(self) -> bool:
        """Whether a program, and with it a motion, may run."""
        return self._started > self._ended

    def started(self) -> None:
        """Note that a program may run from now on."""
        self._started += 1

    def wait_at_rest(self) -> None:
        """Monitor the arm until it rests. Raises ``LinkLost``."""
        wait_at_rest(self._host, self._rest_s)

    def bring_to_rest(self, *, quickly: bool = False, look: Callable[[], None] | None = None) -> None:
        """Stop the controller's program and monitor the arm until it rests; ``look`` is called meanwhile and may raise.

        Raises
        ------
        LinkLost
            If it was not stopped, or not seen at rest.
        """
        started = self._started
        not_stopped: LinkLost | None = None
        try:
            stop_program(self._host, _QUICK_STOP_S if quickly else _STOP_WITHIN_S, look=look)
        except LinkLost as error:
            not_stopped = error
        try:
            sample = wait_at_rest(self._host, _QUICK_REST_S if quickly else self._rest_s, look=look)
        except LinkLost as error:
            raise LinkLost(" and ".join(cause(one) for one in (not_stopped, error) if one is not None)) from error
        if not_stopped is not None and sample.program == "PLAYING":
            raise not_stopped
        self._ended = max(self._ended, started)
