"""A person's requests and halts of the cell while a job runs: pause, hold after a halt, suspend, resume.

Open a cell whose arms a job moves: attended, confirmed by a person before the first motion, slow at first.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from cellapp.cell.driving.cell import Cell, open_cell, start_tracker
from cellapp.cell.driving.motion import Confirm, Mover
from cellapp.cell.driving.reaction import CellStopped, StopCause, StopReaction
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.errors import CellappError, HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Suspension
from cellapp.ground.progress import ArmLive, Cancelled, CellLive, Halt, StateChange
from cellapp.robot.model import CellModel
from drivers.clock import slept_s

SuspensionKind = Literal["target", "air", "drift", "tracker_warm_up", "host_stall"]
Record = Callable[[str, str], None]
"""Callback that records an event in the run: kind ("pause", "stop", "suspend", "resume", ...) and reason."""

_FRESH_S = 0.3
"""Largest age [s] of data of an arm that still describe its current state."""
_BY_PERSON = {"stop": "a person stopped the arms", "abort": "a person aborted the job"}


@contextmanager
def reacting(cell: Cell, control: JobControl) -> Iterator[StopReaction]:
    """While this context is open, let faults of all arms and a person's stop brake all arms.

    Meanwhile ``control.live`` returns the state of the cell, whatever the job is doing.

    Any exception that ends the context also stops the arms, which are then watched until they rest.

    Raises
    ------
    HardwareError
        If a fault of a device stopped the cell; the message states the cause and the arms not seen at rest.
    Stopped, Aborted
        If a person stopped or aborted the job.
    """
    reaction = StopReaction(cell.arms, cell.tracker, cell.together, control.note_halt)
    brakes = control.brakes(lambda verb: reaction.trigger(_personal(verb, control)))
    with control.watching(lambda: _live(cell, reaction)), brakes:
        _settle_earlier_faults(cell, control)
        try:
            yield reaction
        except BaseException as error:
            if not isinstance(error, CellStopped):
                reaction.trigger(StopCause("engine", f"the job ended: {error}"))
            end = _end_of(error, reaction, control)
            if end is error:
                raise
            raise end from error


def _settle_earlier_faults(cell: Cell, control: JobControl) -> None:
    """Record which arms that an earlier job did not see at rest are at rest now."""
    for name, arm in cell.arms.items():
        live = arm.live()
        if not live.moving and live.age_s < _FRESH_S:
            control.note_halt(name, Halt("at rest", "its controller reports that it rests"))


def _live(cell: Cell, reaction: StopReaction) -> CellLive:
    """Return the current state of an open cell."""
    halts, arms = reaction.halts, {name: arm.live() for name, arm in cell.arms.items()}
    return CellLive(
        {name: ArmLive(_known(live.age_s), live.moving, halts.get(name)) for name, live in arms.items()},
        _known(cell.tracker.data_age_s()),
        cell.pulse.age_s(),
        tuple(dict.fromkeys(cause.text for cause in reaction.causes)),
    )


def _known(age_s: float) -> float | None:
    return age_s if math.isfinite(age_s) else None


def _end_of(error: BaseException, reaction: StopReaction, control: JobControl) -> BaseException:
    """Return the exception that ends a job after ``error``; first wait until the arms rest or the watch times out."""
    unseen = reaction.wait_at_rest()
    kinds = {cause.kind for cause in reaction.causes}
    if unseen and isinstance(error, CellappError | Cancelled):
        return HardwareError("; ".join([str(error), *_watch_out(unseen)]))
    if isinstance(error, HardwareError) and "abort" in kinds:
        return Aborted(_BY_PERSON["abort"])
    if isinstance(error, HardwareError) and "stop" in kinds:
        return Stopped(_personal("stop", control).text)
    return HardwareError(str(error)) if isinstance(error, CellStopped) else error


def _personal(verb: str, control: JobControl) -> StopCause:
    """Return the stop cause of a person, who makes a request or leaves."""
    if verb == "abort":
        return StopCause("abort", _BY_PERSON[verb])
    return StopCause("stop", control.departure or _BY_PERSON["stop"])


def _watch_out(unseen: dict[str, str]) -> list[str]:
    return [f"NOT SEEN AT REST: {'; '.join(unseen.values())}"] if unseen else []


@dataclass
class CellSupervisor:
    """Holds a job when a person or the cell asks for it. The cell's clock advances during all waits."""

    mover: Mover
    record: Record
    after_resume: Callable[[], None]
    """Callback when a job resumes after a halt, a hold or a suspension."""
    _slept_s: float = field(default_factory=slept_s)
    _used: Counter[str] = field(default_factory=Counter)

    def checkpoint(self) -> None:
        """Wait while paused, with the arms at rest. Raise ``CellStopped``, ``Stopped`` or ``Aborted``."""
        paused = self.mover.control.request == "pause"
        if paused:
            self._say("pause", StateChange("paused", "paused by a person"))
        self.mover.hold()
        if paused:
            self._say("resume", StateChange("running", "resumed by a person"))

    def recover(self, stopped: CellStopped) -> None:
        """After a halt of the cell, hold until the arms may move again, then release them; do not move them.

        Raises
        ------
        Stopped, Aborted
            If a person ended the job.
        HardwareError
            If the cause needs a person and nobody attends the job, or an arm was not seen at rest.
        """
        unseen = self.mover.reaction.wait_at_rest()
        known = self.mover.reaction.causes
        causes = known or (stopped.cause,)
        kinds = {cause.kind for cause in causes}
        text = "; ".join([*(cause.text for cause in causes), *_watch_out(unseen)])
        self._say(causes[0].kind, StateChange("aborted" if "abort" in kinds else "stopped", text))
        for cause in causes[1:]:
            if cause.kind in _BY_PERSON:  # recorded under its own kind, although another cause came first
                self.record(cause.kind, cause.text)
        if unseen and (self.mover.control.cancelled or not self.mover.control.holds):
            raise HardwareError(f"{text}; a stop was sent to all arms") from stopped
        self.mover.control.check()
        if kinds == {"host stalled"} and not unseen and self._resumes_after_stall(causes, text):
            return
        if not self.mover.control.holds:
            raise HardwareError(f"{text}; a stop was sent to all arms") from stopped
        if kinds != {"stop"}:  # a stop alone holds already; a person may have resumed it before another cause came
            self.mover.control.hold()
        self._hold_for_person(text, known)

    def _resumes_after_stall(self, causes: Sequence[StopCause], text: str) -> bool:
        """Resume after a stall of this computer if the profile allows it and nothing else happened; return whether."""
        allowed = self.mover.profile.collection.suspend.host_stall
        if self._asleep_s() > allowed.wait or not self._begin("host_stall", text):
            return False
        self.mover.cell.clock.wait(allowed.retry, self.mover.control.wait)
        self.mover.control.check()
        if self.mover.control.request != "none":
            return False
        try:
            self.mover.reaction.release(causes)
        except HardwareError as error:
            self.record("not released", str(error))
            return False
        self._resumed("by itself, as the profile allows: this computer had been silent")
        return True

    def _asleep_s(self) -> float:
        """Return how long this computer slept since the last call [s]: a suspended laptop is not a stall."""
        before, self._slept_s = self._slept_s, slept_s()
        return self._slept_s - before

    def suspended(self, kind: SuspensionKind, reason: str, ready: Callable[[], bool]) -> bool:
        """Wait with the arms at rest until ``ready``, as long as the profile allows; return whether it became ready.

        ``ready`` is called every ``retry`` seconds. Raise ``CellStopped`` as soon as the cell is stopped.
        """
        if not self._begin(kind, reason):
            return False
        allowed: Suspension = getattr(self.mover.profile.collection.suspend, kind)
        end_s = self.mover.cell.clock.now_s() + allowed.wait
        while self.mover.cell.clock.now_s() < end_s:
            self.mover.wait(min(allowed.retry, max(end_s - self.mover.cell.clock.now_s(), 1e-3)))
            if self.mover.control.request == "pause":
                self.checkpoint()
            if ready():
                self._resumed(f"by itself: {reason}: no longer")
                return True
        self._say("give up", StateChange("running", f"{reason}: still, after {allowed.wait:g} s"))
        return False

    def hold(self, reason: str) -> bool:
        """Wait until a person resumes, if one attends the job; return whether one did."""
        if not self.mover.control.holds:
            return False
        self.mover.control.hold()
        self._hold_for_person(reason, self.mover.reaction.causes)
        return True

    def _hold_for_person(self, reason: str, shown: Sequence[StopCause]) -> None:
        """Wait until the hold request is withdrawn and every arm is ready; only then release the stop latch.

        ``shown`` are the causes recorded so far. A cause that comes meanwhile is shown and needs another ``resume``.
        """
        shown = tuple(shown)
        while True:
            self.mover.emit(StateChange("stopped", f"{reason}; resume when the cell is clear, or abort"))
            while self.mover.control.request in ("stop", "pause") and self.mover.reaction.causes == shown:
                self.mover.attend()
            self.mover.control.check()
            try:
                if self.mover.reaction.causes == shown:
                    self._release(shown)
                    self._resumed("by a person")
                    return
                causes = self.mover.reaction.causes
                reason = causes[-1].text
                for cause in causes[len(shown) :]:  # includes a person's stop that a fault followed
                    self.record(cause.kind, cause.text)
            except HardwareError as error:
                reason, causes = str(error), self.mover.reaction.causes
                by_person = (cause.kind for cause in causes if all(cause is not one for one in shown))
                kind = next((kind for kind in by_person if kind in _BY_PERSON), "not released")
                self.record(kind, reason)
            shown = causes
            self.mover.control.hold()

    def _release(self, known: Sequence[StopCause]) -> None:
        """Reconnect the tracker if it was a cause; release. Raise ``HardwareError`` if not ready, or on a new cause."""
        if any(cause.kind == "tracker" for cause in known):
            self.mover.cell.tracker.disconnect()
            self.tracker_ready()
        self.mover.reaction.release(known)

    def tracker_ready(self) -> bool:
        """Connect and prepare the tracker again; return whether it is ready to measure."""
        return not start_tracker(self.mover.cell.tracker, self.mover.profile.tracker.driver)

    def _begin(self, kind: SuspensionKind, reason: str) -> bool:
        """Return whether another suspension for this cause is allowed; if so, count and announce it."""
        allowed: Suspension = getattr(self.mover.profile.collection.suspend, kind)
        if self._used[kind] >= allowed.times:
            return False
        self._used[kind] += 1
        self._say("suspend", StateChange("suspended", f"{reason}; waiting at most {allowed.wait:g} s"))
        return True

    def _resumed(self, how: str) -> None:
        self.after_resume()
        self._say("resume", StateChange("running", f"resumed {how}"))

    def _say(self, kind: str, change: StateChange) -> None:
        self.record(kind, change.reason)
        self.mover.emit(change)


@contextmanager
def moving_cell(
    profile: Profile,
    model: CellModel,
    control: JobControl,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    slow_visits: int | None = 0,
    full_speed: float = 1.0,
) -> Iterator[Mover]:
    """Open the cell of a profile and move all arms home; return what moves them.

    ``opened`` is called with the open cell before anything moves; an exception from it ends the job. ``confirm`` is
    called before the first motion. The tracker must be ready. ``slow_visits`` is as in ``Mover.slow_start``;
    ``full_speed`` is the fraction of the profile's speed for other motions. Raise as ``open_cell``, ``reacting`` and
    ``Mover``; ``InputError`` if the first motion is not confirmed.
    """
    bodies = cell_bodies(profile, model)
    with open_cell(profile, control=control) as cell, reacting(cell, control) as reaction:
        opened(cell)
        cell.require_tracker()
        mover = Mover(profile, cell, bodies, reaction, control)
        mover.confirm_first(mover.homes, confirm)
        mover.full_speed = full_speed
        mover.slow_start(slow_visits)
        mover.go_home()
        yield mover
