"""Reaction of the whole cell to a fault: all arms brake at once and in parallel; diagnosis comes afterwards.

The first cause latches the reaction. Nothing moves until ``release``, which reconnects every arm. The call that latches
it withdraws every arm's permission to start a motion before it returns. Braking and watching until rest run in threads
of their own; they do not wait for the job.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal

from cellapp.cell.driving.cell import Together, answers_of_all, in_threads, one_by_one
from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import Halt
from drivers.arms.protocol import Arm, ArmError, EmergencyStop, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import Tracker, TrackerError

CauseKind = Literal["fault", "safety stop", "link lost", "host stalled", "stop", "abort", "gate", "tracker", "engine"]
HaltListener = Callable[[str, Halt], None]
"""Callback with the name of an arm and the state of its halt, from any thread; must return soon."""

_BRAKED = Halt("braking", "its stop was commanded")
_AT_REST = Halt("at rest", "it was seen at rest")


@dataclass(frozen=True)
class StopCause:
    """Why the cell stopped; ``arm`` is None if the cause is not one arm."""

    kind: CauseKind
    text: str
    arm: str | None = None
    error: ArmError | None = None


class CellStopped(HardwareError):
    """The cell was stopped; the message is the cause. Raised in the job's thread, while the arms brake already."""

    def __init__(self, cause: StopCause) -> None:
        super().__init__(f"{cause.text}; a stop was sent to all arms")
        self.cause = cause


def cause_of(name: str, error: ArmError) -> StopCause:
    """Return the stop cause for an arm's error."""
    kind: CauseKind = "fault"
    if isinstance(error, ProtectiveStop | EmergencyStop):
        kind = "safety stop"
    elif isinstance(error, LinkLost):
        kind = "link lost"
    elif isinstance(error, HostStalled):
        kind = "host stalled"
    return StopCause(kind, str(error), name, error)


class StopReaction:
    """Stop latch and brakes of one open cell. ``trigger`` may be called from any thread; others: from the job's thread.

    Parameters
    ----------
    arms : mapping
        Arm by name.
    tracker : Tracker
        Its ``halt`` ends a running measurement.
    together : callable
        Calls functions of all devices concurrently. If it returns at once (threads), the thread that brakes an arm also
        watches it until it rests; else, in simulated time, ``wait_at_rest`` does.
    listener : callable
        Called when an arm was seen at rest after a halt, or was not; it may take some time.
    """

    def __init__(
        self,
        arms: Mapping[str, Arm],
        tracker: Tracker,
        together: Together = in_threads,
        listener: HaltListener = lambda name, halt: None,
    ) -> None:
        self._arms, self._tracker, self._together, self._listener = arms, tracker, together, listener
        self._causes: tuple[StopCause, ...] = ()
        self._lock = threading.RLock()
        self._halts: dict[str, Halt] = {}
        self._watched: set[str] = set()  # arms that a thread is watching until they rest
        self._rested = threading.Condition(self._lock)
        for name, arm in arms.items():
            arm.watch(partial(self._fault, name))

    @property
    def cause(self) -> StopCause | None:
        """First cause since the last ``release``; None if there is none."""
        return self._causes[0] if self._causes else None

    @property
    def causes(self) -> tuple[StopCause, ...]:
        """All causes since the last ``release``, oldest first; one of each kind per device."""
        return self._causes

    @property
    def halts(self) -> Mapping[str, Halt]:
        """State of the halt of each halted arm."""
        return dict(self._halts)

    def trigger(self, cause: StopCause) -> None:
        """Brake all arms at once, even if they brake already, and store the cause.

        When this returns, no arm accepts a motion.
        """
        with self._lock:
            known = any((cause.kind, cause.arm) == (one.kind, one.arm) for one in self._causes)
            if not known or cause.kind in ("stop", "abort"):  # a person's second stop counts again
                self._causes = (*self._causes, cause)
            for name, arm in self._arms.items():
                arm.refuse_motion()
                if self._halts.get(name, _BRAKED).state != "not seen at rest":  # keep that state until seen at rest
                    self._halts[name] = Halt("asked", cause.text)
        self._together([*(partial(self._halt, name) for name in self._arms), self._halt_tracker])

    def _fault(self, name: str, error: ArmError) -> None:
        self.trigger(cause_of(name, error))

    def check(self) -> None:
        """Raise ``CellStopped`` if the reaction was triggered."""
        if self._causes:
            raise CellStopped(self._causes[0])

    def wait_at_rest(self) -> dict[str, str]:
        """Wait until every arm rests, in parallel; return arm -> reason for arms that were not seen at rest."""
        with self._rested:
            self._rested.wait_for(lambda: not self._watched)  # terminates: every call of a driver has a timeout
            waiting = [name for name in self._arms if self._halts.get(name, _BRAKED).state in ("asked", "braking")]
        _, errors = answers_of_all(self._together, {name: self._arms[name].stop for name in waiting})
        for name in waiting:
            self._conclude(name, _unseen(errors[name]) if name in errors else _AT_REST)
        return {name: halt.reason for name, halt in self._halts.items() if halt.state == "not seen at rest"}

    def release(self, known: Sequence[StopCause]) -> None:
        """Reconnect all arms, after a person allowed it or the cause was harmless. Nothing moves.

        ``known`` are the causes that the caller knows. The stop latch opens first, so that a new fault closes it again.

        Raises
        ------
        HardwareError
            If another cause came, or an arm is not ready; then the cell is stopped.
        """
        with self._rested:
            self._rested.wait_for(lambda: not self._watched)  # no old watch may end after the stop latch is open
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
        """Brake an arm and, in real time, watch it until it rests, unless another thread watches it already."""
        arm, reason = self._arms[name], ""
        try:
            arm.brake()
        except ArmError as error:  # the watch retries, and reports an arm that was not seen at rest
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
        """Record whether an arm was seen at rest; notify the listener without the lock, because it may write a file."""
        with self._lock:
            before, self._halts[name] = self._halts.get(name), seen
        if before is None or before.state != seen.state:
            self._listener(name, seen)

    def _halt_tracker(self) -> None:
        with suppress(TrackerError):  # a tracker that does not answer is detected at the next measurement
            self._tracker.halt()


def _unseen(error: ArmError) -> Halt:
    return Halt("not seen at rest", str(error))
