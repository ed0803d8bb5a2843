"""The reaction of the whole cell to a doubt: all arms brake at once and in parallel; diagnosis comes afterwards.

The first cause latches the reaction. Nothing moves until ``release``, which reconnects every arm.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, Protocol

from cellapp.errors import HardwareError
from drivers.arms.protocol import Arm, ArmError, EmergencyStop, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import TrackerError

CauseKind = Literal["fault", "safety stop", "link lost", "host stalled", "stop", "abort", "gate", "tracker", "engine"]

Together = Callable[[Sequence[Callable[[], None]]], None]
"""Calls functions, all at once where time is real."""


def in_threads(calls: Sequence[Callable[[], None]]) -> None:
    """Call every function in a thread of its own and return at once: one that hangs delays no other."""
    for call in calls:
        threading.Thread(target=call, name="brake", daemon=True).start()


def one_by_one(calls: Sequence[Callable[[], None]]) -> None:
    """Call every function in turn: simulated time does not pass meanwhile."""
    for call in calls:
        call()


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
        self._cause: StopCause | None = None
        self._lock = threading.RLock()
        for name, arm in arms.items():
            arm.watch(lambda error, name=name: self.trigger(cause_of(name, error)))  # type: ignore[misc]

    @property
    def cause(self) -> StopCause | None:
        """The first cause since the last ``release``; None if nothing happened."""
        return self._cause

    def trigger(self, cause: StopCause) -> None:
        """Brake all arms at once. The first cause is kept; a later one brakes again, which is harmless."""
        with self._lock:
            first = self._cause is None
            if first:
                self._cause = cause
        if first or cause.kind in ("stop", "abort"):
            self._together([*(self._braking(arm) for arm in self._arms.values()), self._halt_tracker])

    def check(self) -> None:
        """Raise ``CellStopped`` if the reaction was triggered."""
        if self._cause is not None:
            raise CellStopped(self._cause)

    def wait_at_rest(self) -> dict[str, str]:
        """Wait until every arm rests, all at once; return why an arm was not seen at rest, name -> reason."""
        unseen = {name: f"arm {name}: its driver gave no answer" for name in self._arms}
        waiting = [threading.Event() for _ in self._arms]

        def rest(name: str, done: threading.Event) -> None:
            try:
                self._arms[name].stop()
                del unseen[name]
            except ArmError as error:
                unseen[name] = str(error)
            finally:
                done.set()

        self._together(
            [lambda name=name, done=done: rest(name, done) for name, done in zip(self._arms, waiting, strict=True)]  # type: ignore[misc]
        )
        for done in waiting:
            done.wait()  # every call of a driver ends in bounded time
        return unseen

    def release(self) -> None:
        """Reconnect all arms, after a person allowed it or for a cause that is no danger. Nothing moves.

        The latch opens first: a doubt that comes meanwhile closes it again.

        Raises
        ------
        HardwareError
            If an arm is not ready, or a new doubt came; the cell is stopped then.
        """
        with self._lock:
            self._cause = None
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
        with suppress(
            TrackerError
        ):  # the arms matter now; a tracker that does not answer shows at the next measurement
            self._tracker.halt()
