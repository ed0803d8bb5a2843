"""Replay the collection of a run as events, at its own pace or faster; nothing moves, no device is opened."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from cellapp.cell.driving.live_model import LiveModel
from cellapp.cell.driving.recording import Recording, ReferenceGroup, Visit, What, read_recording
from cellapp.cell.driving.records import ReplayResult
from cellapp.cell.driving.references import ReferenceWatch
from cellapp.cell.run import RunFile
from cellapp.ground.control import JobControl, Stopped
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import (
    Detail,
    JobState,
    Listener,
    LogReport,
    Progress,
    ReferenceReport,
    StateChange,
    ignore,
)

JOB = "replay"
SLOWEST, FASTEST = 1.0, 100.0
"""Limits of the pace relative to the recorded one. Beyond 100, a stop would take less than a tenth of a second."""

_DUE_S = 1e-3
"""An event is due if less than this [s] is left: waiting is no more exact."""

Clock = Callable[[], float]
"""Function that returns the time since an arbitrary origin [s]; never decreases."""


@dataclass(frozen=True)
class TimedEvent:
    """Event of a recording, ``time_s`` after its beginning [s]; its ``eta_s`` is the recorded time left."""

    time_s: float
    event: Progress


def replay_run(
    run: RunFile,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    speed: float = SLOWEST,
    clock: Clock = time.monotonic,
) -> ReplayResult:
    """Replay what a run recorded, ``speed`` times as fast as it was collected; only read the run.

    A person may pause and resume, and end it with ``stop`` or ``abort``.

    Raises
    ------
    InputError
        If the speed is not between 1 and 100, or the run has no readings.
    Stopped, Aborted
        On request.
    """
    if not SLOWEST <= speed <= FASTEST:
        raise InputError(
            f"replay: the speed {speed:g} is not possible; give one from {SLOWEST:g} to {FASTEST:g} times the recorded"
            " pace"
        )
    control = control or JobControl()
    recording = read_recording(run)
    pacer = _Pacer(listener, control, clock, clock())
    for timed in replay_events(run.profile, recording):
        left_s = None if timed.event.eta_s is None else timed.event.eta_s / speed
        pacer.emit(replace(timed.event, eta_s=left_s), timed.time_s / speed)
    return ReplayResult(
        run=str(run.folder),
        stops=recording.visits,
        readings=dict(recording.readings),
        duration_s=recording.duration_s,
        speed=speed,
        timed=recording.timed,
    )


def replay_events(profile: Profile, recording: Recording) -> Iterator[TimedEvent]:
    """Yield the events of a recording with their times; refit the running model as during collecting.

    A resumed session is replayed as one with the sessions before it.
    """
    player = _Player(profile, recording)
    start_s = recording.moments[0].time_s
    for moment in recording.moments:
        for note, detail in player.play(moment.what):
            event = Progress(JOB, player.done, recording.visits, note, recording.duration_s, detail)
            played_s = moment.time_s - start_s
            yield TimedEvent(played_s, replace(event, eta_s=recording.duration_s - played_s))
    end = Progress(JOB, recording.visits, recording.visits, "end of the recording", 0.0)
    yield TimedEvent(recording.duration_s, end)


class _Player:
    """Converts recorded events into notes and details, with the running model and reference watch of a session."""

    def __init__(self, profile: Profile, recording: Recording) -> None:
        self.done = 0
        """Number of visited stops."""
        self._stored = {moment.what.text for moment in recording.moments if isinstance(moment.what, LogReport)}
        self._notes: list[LogReport] = []
        self._model = LiveModel(profile, recording.planned, {}, self._note)
        self._limit_m = profile.collection.reference.drift
        self._arms = [f"arm {name}" for name in profile.arms]
        self._watch: tuple[int, ReferenceWatch] | None = None
        self._state: JobState = "running"

    def play(self, what: What) -> Iterator[tuple[str, Detail | None]]:
        """Yield the notes and details of one recorded event."""
        match what:
            case str():
                yield what, None
            case Visit():
                self.done += 1
                for found in self._model.add(what.stop, what.readings):
                    yield "", found
            case ReferenceGroup():
                yield from (("", detail) for detail in self._reference(what))
            case StateChange(state):
                if state == "running" and self._state in ("stopped", "suspended"):
                    self._model.forget_suspicions()  # as after a resume: a person may have changed something
                self._state = state
                yield "", what
            case _:
                yield "", what
        while self._notes:
            yield "", self._notes.pop(0)

    def _reference(self, group: ReferenceGroup) -> Iterator[Detail]:
        """Yield suspicions and report of reference measurements; each session has its own watch."""
        session = group.rows[0].session
        if self._watch is None or self._watch[0] != session:
            self._watch = session, ReferenceWatch(self._limit_m)
        yield from self._watch[1].at_reference({row.name: row.p_M for row in group.rows}, self._arms)
        yield ReferenceReport(group.drift_mm, self._limit_m * 1e3)

    def _note(self, level: str, text: str) -> None:
        """Queue a note of the model, unless the run's log contains it already."""
        if text not in self._stored:
            self._notes.append(LogReport(level, text))


class _Pacer:
    """Passes events on when they are due; the clock stops during a pause."""

    def __init__(self, listener: Listener, control: JobControl, clock: Clock, began_s: float) -> None:
        self._listener, self._control, self._clock, self._began_s = listener, control, clock, began_s

    def emit(self, event: Progress, due_s: float) -> None:
        """Pass an event on, ``due_s`` after the beginning [s]. Raise ``Stopped`` or ``Aborted`` on request."""
        while True:
            left_s = self._began_s + due_s - self._clock()
            request = self._control.wait_while("none", timeout_s=max(left_s, 0.0))
            self._control.check()
            if request == "stop":
                raise Stopped("stopped on request")
            if request == "pause":
                self._pause(event)
            elif self._began_s + due_s - self._clock() < _DUE_S:
                self._listener(event)
                return

    def _pause(self, coming: Progress) -> None:
        paused_s = self._clock()
        shown = replace(coming, note="")
        self._listener(replace(shown, detail=StateChange("paused", "the replay is paused by a person")))
        self._control.wait_while("pause")
        self._control.check()
        self._began_s += self._clock() - paused_s
        self._listener(replace(shown, detail=StateChange("running", "the replay is resumed by a person")))
