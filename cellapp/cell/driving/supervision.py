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
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.control import Aborted, JobControl, Stopped
from cellapp.ground.errors import CellappError, HardwareError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Suspension
from cellapp.ground.progress import ArmLive, Cancelled, CellLive, Detail, Halt, StateChange
from cellapp.robot.model import CellModel
from drivers.clock import slept_s

SuspensionKind = Literal["target", "air", "drift", "tracker_warm_up", "host_stall"]
Record = Callable[[str, str], None]
"""Callback that records an event in the run: kind ("pause", "stop", "suspend", "resume", ...) and reason."""

_POLL_S = 0.1
"""Polling period of a paused job [s]; a stop does not wait for it, it brakes in the person's thread."""
_FRESH_S = 0.3
"""Largest age [s] of data of an arm that still describe its current state."""
_BY_PERSON = {"stop": "a person stopped the arms", "abort": "a person aborted the job"}


@contextmanager
def attended_cell(profile: Profile, control: JobControl) -> Iterator[tuple[Cell, StopReaction]]:
    """Open the cell of a profile and connect it to its brakes. Raise as ``open_cell`` and ``reacting``."""
    with open_cell(profile, control=control) as cell, reacting(cell, control) as reaction:
        yield cell, reaction


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


def hold_while_paused(cell: Cell, control: JobControl, reaction: StopReaction) -> None:
    """Wait, with the arms at rest, while a person pauses. Raise ``CellStopped``, ``Stopped`` or ``Aborted``."""
    reaction.check()  # first, so that the cause of a halt is recorded
    control.check()
    while control.request in ("pause", "stop"):
        _attend(cell, control)
        control.check()
        reaction.check()


def _attend(cell: Cell, control: JobControl) -> None:
    """Wait one polling period for a person, in real time; the clock of a simulated cell advances too."""
    cell.pulse.beat()
    control.wait_while("pause", "stop", timeout_s=_POLL_S)
    cell.clock.wait(_POLL_S, lambda duration_s: None)


@dataclass
class CellSupervisor:
    """Holds a job when a person or the cell asks for it. The cell's clock advances during all waits."""

    cell: Cell
    control: JobControl
    reaction: StopReaction
    profile: Profile
    record: Record
    emit: Callable[[Detail], None]
    after_resume: Callable[[], None]
    """Callback when a job resumes after a halt, a hold or a suspension."""
    _slept_s: float = field(default_factory=slept_s)
    _used: Counter[str] = field(default_factory=Counter)

    def checkpoint(self) -> None:
        """Wait while paused, with the arms at rest. Raise ``CellStopped``, ``Stopped`` or ``Aborted``."""
        paused = self.control.request == "pause"
        if paused:
            self._say("pause", StateChange("paused", "paused by a person"))
        hold_while_paused(self.cell, self.control, self.reaction)
        if paused:
            self._say("resume", StateChange("running", "resumed by a person"))

    def wait(self, duration_s: float) -> None:
        """Let time pass with the arms at rest. Raise ``CellStopped`` as soon as the cell is stopped."""
        with self.cell.pulse.waiting():
            self.cell.clock.wait(duration_s, self.control.wait)
        self.reaction.check()

    def recover(self, stopped: CellStopped) -> None:
        """After a halt of the cell, hold until the arms may move again, then release them; do not move them.

        Raises
        ------
        Stopped, Aborted
            If a person ended the job.
        HardwareError
            If the cause needs a person and nobody attends the job, or an arm was not seen at rest.
        """
        unseen = self.reaction.wait_at_rest()
        known = self.reaction.causes
        causes = known or (stopped.cause,)
        kinds = {cause.kind for cause in causes}
        text = "; ".join([*(cause.text for cause in causes), *_watch_out(unseen)])
        self._say(causes[0].kind, StateChange("aborted" if "abort" in kinds else "stopped", text))
        for cause in causes[1:]:
            if cause.kind in _BY_PERSON:  # recorded under its own kind, although another cause came first
                self.record(cause.kind, cause.text)
        if unseen and (self.control.cancelled or not self.control.holds):
            raise HardwareError(f"{text}; a stop was sent to all arms") from stopped
        self.control.check()
        if kinds == {"host stalled"} and not unseen and self._resumes_after_stall(causes, text):
            return
        if not self.control.holds:
            raise HardwareError(f"{text}; a stop was sent to all arms") from stopped
        if kinds != {"stop"}:  # a stop alone holds already; a person may have resumed it before another cause came
            self.control.hold()
        self._hold_for_person(text, known)

    def _resumes_after_stall(self, causes: Sequence[StopCause], text: str) -> bool:
        """Resume after a stall of this computer if the profile allows it and nothing else happened; return whether."""
        allowed = self.profile.collection.suspend.host_stall
        if self._asleep_s() > allowed.wait or not self._begin("host_stall", text):
            return False
        self.cell.clock.wait(allowed.retry, self.control.wait)
        self.control.check()
        if self.control.request != "none":
            return False
        try:
            self.reaction.release(causes)
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
        allowed: Suspension = getattr(self.profile.collection.suspend, kind)
        end_s = self.cell.clock.now_s() + allowed.wait
        while self.cell.clock.now_s() < end_s:
            self.wait(min(allowed.retry, max(end_s - self.cell.clock.now_s(), 1e-3)))
            if self.control.request == "pause":
                self.checkpoint()
            if ready():
                self._resumed(f"by itself: {reason}: no longer")
                return True
        self._say("give up", StateChange("running", f"{reason}: still, after {allowed.wait:g} s"))
        return False

    def hold(self, reason: str) -> bool:
        """Wait until a person resumes, if one attends the job; return whether one did."""
        if not self.control.holds:
            return False
        self.control.hold()
        self._hold_for_person(reason, self.reaction.causes)
        return True

    def _hold_for_person(self, reason: str, shown: Sequence[StopCause]) -> None:
        """Wait until the hold request is withdrawn and every arm is ready; only then release the stop latch.

        ``shown`` are the causes recorded so far. A cause that comes meanwhile is shown and needs another ``resume``.
        """
        shown = tuple(shown)
        while True:
            self.emit(StateChange("stopped", f"{reason}; resume when the cell is clear, or abort"))
            while self.control.request in ("stop", "pause") and self.reaction.causes == shown:
                _attend(self.cell, self.control)
            self.control.check()
            try:
                if self.reaction.causes == shown:
                    self._release(shown)
                    self._resumed("by a person")
                    return
                causes = self.reaction.causes
                reason = causes[-1].text
                for cause in causes[len(shown) :]:  # includes a person's stop that a fault followed
                    self.record(cause.kind, cause.text)
            except HardwareError as error:
                reason, causes = str(error), self.reaction.causes
                by_person = (cause.kind for cause in causes if all(cause is not one for one in shown))
                kind = next((kind for kind in by_person if kind in _BY_PERSON), "not released")
                self.record(kind, reason)
            shown = causes
            self.control.hold()

    def _release(self, known: Sequence[StopCause]) -> None:
        """Reconnect the tracker if it was a cause; release. Raise ``HardwareError`` if not ready, or on a new cause."""
        if any(cause.kind == "tracker" for cause in known):
            self.cell.tracker.disconnect()
            self.tracker_ready()
        self.reaction.release(known)

    def tracker_ready(self) -> bool:
        """Connect and prepare the tracker again; return whether it is ready to measure."""
        return not start_tracker(self.cell.tracker, self.profile.tracker.driver)

    def _begin(self, kind: SuspensionKind, reason: str) -> bool:
        """Return whether another suspension for this cause is allowed; if so, count and announce it."""
        allowed: Suspension = getattr(self.profile.collection.suspend, kind)
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
        self.emit(change)


@dataclass(frozen=True, eq=False)
class MovingCell:
    """Open cell with all arms at home; ``hold`` waits while a person pauses."""

    cell: Cell
    reaction: StopReaction
    bodies: CellBodies
    mover: Mover
    hold: Callable[[], None]
    began_s: float
    """Start of the first motion on the cell's clock [s]."""


@contextmanager
def moving_cell(
    profile: Profile,
    model: CellModel,
    control: JobControl,
    *,
    confirm: Confirm | None = None,
    opened: Callable[[Cell], object] = lambda cell: None,
    slow_visits: int | None = 0,
) -> Iterator[MovingCell]:
    """Open the cell of a profile and move all arms home.

    ``opened`` is called with the open cell before anything moves; an exception from it ends the job. ``confirm`` is
    called before the first motion. The tracker must be ready. ``slow_visits``
    is as in ``Mover.slow_start``. Raise as ``attended_cell`` and ``Mover``; ``InputError`` if the first motion is not
    confirmed.
    """
    bodies, homes = cell_bodies(profile, model), home_positions(profile)
    with attended_cell(profile, control) as (cell, reaction):
        opened(cell)
        cell.require_tracker()
        mover = Mover(profile, cell, bodies, reaction)
        mover.confirm_first(homes, confirm)
        mover.slow_start(slow_visits)
        began_s = cell.clock.now_s()
        mover.go_home()
        yield MovingCell(cell, reaction, bodies, mover, lambda: hold_while_paused(cell, control, reaction), began_s)
