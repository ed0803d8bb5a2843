"""The reaction of the whole cell to a doubt: all arms brake at once and in parallel; diagnosis comes afterwards.

The first cause latches the reaction. Nothing moves until ``release``, which reconnects every arm.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

from cellapp.collection.together import Together, answers_of_all, in_threads
from cellapp.errors import HardwareError
from drivers.arms.protocol import Arm, ArmError, EmergencyStop, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import TrackerError

CauseKind = Literal["fault", "safety stop", "link lost", "host stalled", "stop", "abort", "gate", "tracker", "engine"]


@dataclass(frozen=True)
class StopCause:
    """Why the cell stopped; ``arm`` is None if no single arm is the cause."""

    kind: CauseKind
    text: str
    arm: str | None = None
    error: ArmError | None = None


class CellStopped(HardwareError):
    """The cell was stopped; the message is the cause. Raised in the job; the arms brake already."""

    def __init__(self, cause: StopCause) -> None:
        super().__init__(f"{cause.text}; a stop was sent to all arms")
        self.cause = cause


class Halting(Protocol):
    """What must end its work when the cell stops: the tracker."""

    def halt(self) -> None:
        """End the running measurement; from any thread."""


def cause_of(name: str, error: ArmError) -> StopCause:
    """Return the cause that an arm's error is."""
    kind: CauseKind = "fault"
    if isinstance(error, ProtectiveStop | EmergencyStop):
        kind = "safety stop"
    elif isinstance(error, LinkLost):
        kind = "link lost"
    elif isinstance(error, HostStalled):
        kind = "host stalled"
    return StopCause(kind, str(error), name, error)


class StopReaction:
    """The latch and the brakes of one open cell. ``trigger`` may be called from any thread, the rest from the job's."""

    def __init__(self, arms: Mapping[str, Arm], tracker: Halting, together: Together = in_threads) -> None:
        self._arms, self._tracker, self._together = arms, tracker, together
        self._causes: tuple[StopCause, ...] = ()
        self._lock = threading.RLock()
        for name, arm in arms.items():
            arm.watch(partial(self._doubt, name))

    @property
    def cause(self) -> StopCause | None:
        """The first cause since the last ``release``; None if nothing happened."""
        return self._causes[0] if self._causes else None

    @property
    def causes(self) -> tuple[StopCause, ...]:
        """All causes since the last ``release``, oldest first; of a device one of each kind."""
        return self._causes

    def trigger(self, cause: StopCause) -> None:
        """Brake all arms at once, again if they brake already, and keep the cause."""
        with self._lock:
            known = any((cause.kind, cause.arm) == (one.kind, one.arm) for one in self._causes)
            if not known or cause.kind in ("stop", "abort"):  # a person's second stop is another one
                self._causes = (*self._causes, cause)
        self._together([*(self._braking(arm) for arm in self._arms.values()), self._halt_tracker])

    def _doubt(self, name: str, error: ArmError) -> None:
        self.trigger(cause_of(name, error))

    def check(self) -> None:
        """Raise ``CellStopped`` if the reaction was triggered."""
        if self._causes:
            raise CellStopped(self._causes[0])

    def wait_at_rest(self) -> dict[str, str]:
        """Wait until every arm rests, all at once; return why an arm was not seen at rest, name -> reason."""
        _, errors = answers_of_all(self._together, {name: arm.stop for name, arm in self._arms.items()})
        return {name: str(error) for name, error in errors.items()}

    def release(self, known: Sequence[StopCause]) -> None:
        """Reconnect all arms, after a person allowed it or for a cause that is no danger. Nothing moves.

        ``known`` are the causes that were considered. The latch opens first: a doubt that comes meanwhile closes it.

        Raises
        ------
        HardwareError
            If another cause came, or an arm is not ready; the cell is stopped then.
        """
        with self._lock:
            if self._causes != tuple(known):
                raise CellStopped(self._causes[-1])
            self._causes = ()
        for name, arm in self._arms.items():
            try:
                arm.connect()
                state = arm.state()
            except ArmError as error:
                self.trigger(cause_of(name, error))
                raise HardwareError(str(error)) from error
            if not state.ready or state.moving:
                text = f"arm {name}: not ready: {state.reason or 'it is moving'}"
                self.trigger(StopCause("fault", text, name))
                raise HardwareError(text)
        self.check()

    @staticmethod
    def _braking(arm: Arm) -> Callable[[], None]:
        def brake() -> None:
            with suppress(ArmError):  # ``wait_at_rest`` asks again and reports an arm that was not seen at rest
                arm.brake()

        return brake

    def _halt_tracker(self) -> None:
        with suppress(TrackerError):  # a tracker that does not answer shows at the next measurement
            self._tracker.halt()
