"""The reaction of the whole cell to a doubt: all arms brake at once and in parallel; diagnosis comes afterwards.

The first cause latches the reaction. Nothing moves until ``release``, which reconnects every arm. The act that latches
it withdraws every arm's permission to begin a motion before it returns; brakes and the watch for rest follow in threads
of their own, so that neither waits for the job.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

from cellapp.cell.driving.together import Together, answers_of_all, in_threads, one_by_one
from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import Halt
from drivers.arms.protocol import Arm, ArmError, EmergencyStop, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import TrackerError

CauseKind = Literal["fault", "safety stop", "link lost", "host stalled", "stop", "abort", "gate", "tracker", "engine"]
HaltListener = Callable[[str, Halt], None]
"""Receives the name of an arm and how far its halt is, from any thread; returns soon."""

_BRAKED = Halt("braking", "its stop was commanded")
_AT_REST = Halt("at rest", "it was seen at rest")


def ignore_halt(name: str, halt: Halt) -> None:
    """A listener for those who do not look."""


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
    """The latch and the brakes of one open cell. ``trigger`` may be called from any thread, the rest from the job's.

    Parameters
    ----------
    arms : mapping
        Arm by name.
    tracker : Halting
    together : callable
        Calls functions of all devices at once. Where it returns at once, each arm is watched until it rests by the
        thread that brakes it; else, in simulated time, by ``wait_at_rest``.
    listener : callable
        Is told when an arm was seen at rest after a halt, or was not; it may take its time.
    """

    def __init__(
        self,
        arms: Mapping[str, Arm],
        tracker: Halting,
        together: Together = in_threads,
        listener: HaltListener = ignore_halt,
    ) -> None:
        self._arms, self._tracker, self._together, self._listener = arms, tracker, together, listener
        self._causes: tuple[StopCause, ...] = ()
        self._lock = threading.RLock()
        self._halts: dict[str, Halt] = {}
        self._watched: set[str] = set()  # arms that a thread watches until they rest
        self._rested = threading.Condition(self._lock)
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

    @property
    def halts(self) -> Mapping[str, Halt]:
        """How far the halt of each arm is; without the arms that were not halted."""
        return dict(self._halts)

    def trigger(self, cause: StopCause) -> None:
        """Brake all arms at once, again if they brake already, and keep the cause.

        No arm accepts a motion any more when this returns.
        """
        with self._lock:
            known = any((cause.kind, cause.arm) == (one.kind, one.arm) for one in self._causes)
            if not known or cause.kind in ("stop", "abort"):  # a person's second stop is another one
                self._causes = (*self._causes, cause)
            for name, arm in self._arms.items():
                arm.refuse_motion()
                if self._halts.get(name, _BRAKED).state != "not seen at rest":  # it stays so until it is seen
                    self._halts[name] = Halt("asked", cause.text)
        self._together([*(partial(self._halt, name) for name in self._arms), self._halt_tracker])

    def _doubt(self, name: str, error: ArmError) -> None:
        self.trigger(cause_of(name, error))

    def check(self) -> None:
        """Raise ``CellStopped`` if the reaction was triggered."""
        if self._causes:
            raise CellStopped(self._causes[0])

    def wait_at_rest(self) -> dict[str, str]:
        """Wait until every arm rests, all at once; return why an arm was not seen at rest, name -> reason."""
        with self._rested:
            self._rested.wait_for(lambda: not self._watched)  # every call of a driver ends in bounded time
            waiting = [name for name in self._arms if self._halts.get(name, _BRAKED).state in ("asked", "braking")]
        _, errors = answers_of_all(self._together, {name: self._arms[name].stop for name in waiting})
        for name in waiting:
            self._conclude(name, _unseen(errors[name]) if name in errors else _AT_REST)
        return {name: halt.reason for name, halt in self._halts.items() if halt.state == "not seen at rest"}

    def release(self, known: Sequence[StopCause]) -> None:
        """Reconnect all arms, after a person allowed it or for a cause that is no danger. Nothing moves.

        ``known`` are the causes that were considered. The latch opens first: a doubt that comes meanwhile closes it.

        Raises
        ------
        HardwareError
            If another cause came, or an arm is not ready; the cell is stopped then.
        """
        with self._rested:
            self._rested.wait_for(lambda: not self._watched)  # else an old watch ends after the latch is open
            if self._causes != tuple(known):
                raise CellStopped(self._causes[-1])
            self._causes = ()
        for name, arm in self._arms.items():
            self.check()
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
            self._conclude(name, _AT_REST)
        with self._lock:
            self.check()
            self._halts.clear()

    # -- the stop of one arm -------------------------------------------------------------------------------------------

    def _halt(self, name: str) -> None:
        """Brake an arm and, where time is real, watch it until it rests; one thread watches."""
        arm, reason = self._arms[name], ""
        try:
            arm.brake()
        except ArmError as error:  # the watch asks again and reports an arm that was not seen at rest
            reason = str(error)
        with self._lock:
            if self._halts.get(name, _BRAKED).state == "asked":
                self._halts[name] = Halt("braking", reason) if reason else _BRAKED
            if self._together is one_by_one or name in self._watched:
                return
            self._watched.add(name)
        seen = Halt("not seen at rest", f"arm {name}: its driver gave no answer")
        try:
            arm.stop()
            seen = _AT_REST
        except ArmError as error:
            seen = _unseen(error)
        finally:
            self._conclude(name, seen)
            with self._rested:
                self._watched.discard(name)
                self._rested.notify_all()

    def _conclude(self, name: str, seen: Halt) -> None:
        """Note whether an arm was seen at rest, and tell the listener; without the lock, as that may write a file."""
        with self._lock:
            before, self._halts[name] = self._halts.get(name), seen
        if before is None or before.state != seen.state:
            self._listener(name, seen)

    def _halt_tracker(self) -> None:
        with suppress(TrackerError):  # a tracker that does not answer shows at the next measurement
            self._tracker.halt()


def _unseen(error: ArmError) -> Halt:
    return Halt("not seen at rest", str(error))
