"""A long job: the events that it tells, and the token by which it is followed and cancelled."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Literal

from cellapp.ground.counting import counted

JobState = Literal["running", "pausing", "paused", "suspended", "stopped", "aborted"]


@dataclass(frozen=True)
class StateChange:
    """A job that moves arms changed its state; ``reason`` says why, in a sentence."""

    state: JobState
    reason: str


HaltState = Literal["asked", "braking", "at rest", "not seen at rest"]


@dataclass(frozen=True)
class Halt:
    """How far the halt of an arm is.

    Attributes
    ----------
    state : str
        ``asked``: its brake was called. ``braking``: the halt was commanded. ``at rest``: it was seen at rest since.
        ``not seen at rest``: nobody knows whether it moves.
    reason : str
        Why, in a sentence.
    """

    state: HaltState
    reason: str


@dataclass(frozen=True)
class ArmLive:
    """What is known of an arm now.

    Attributes
    ----------
    age_s : float or None
        Age of the newest state from its controller [s]; None without one.
    moving : bool
        Whether it moved then.
    halt : Halt or None
        How far its halt is; None where it was not halted.
    """

    age_s: float | None
    moving: bool
    halt: Halt | None = None


@dataclass(frozen=True)
class CellLive:
    """What is known of an open cell now, whatever its job is doing.

    Attributes
    ----------
    arms : mapping
        Arm -> what is known of it.
    tracker_age_s : float or None
        Age of the newest sign of life from the tracker [s]; None without one.
    job_age_s : float
        Age of the newest sign of life from the job itself [s].
    causes : tuple of str
        Why the arms were stopped, oldest first; empty while they may move.
    """

    arms: Mapping[str, ArmLive]
    tracker_age_s: float | None
    job_age_s: float
    causes: tuple[str, ...] = ()


@dataclass(frozen=True)
class StopReport:
    """One arm at one stop, after the model was refitted with it.

    Attributes
    ----------
    stop : int
        Number of the stop, from 0.
    residual_mm : float
        Distance of the measured SMR from the refitted model's.
    standard_error_mm : float
        Standard uncertainty of a predicted SMR position from the parameters alone, rms over the planned stops.
    """

    stop: int
    arm: str
    residual_mm: float
    standard_error_mm: float


@dataclass(frozen=True)
class Suspicion:
    """Something that the measurements suggest, to be looked at: a wrong SMR, a loose SMR, a bumped tracker."""

    kind: Literal["wrong SMR", "loose SMR", "tracker moved", "drift"]
    text: str
    arm: str | None = None


@dataclass(frozen=True)
class Notice:
    """What a person should know before the work goes on, in a sentence."""

    text: str


@dataclass(frozen=True)
class ReferenceReport:
    """A reference measurement: distance of each reference from its first measurement, name -> [mm], and the limit."""

    drift_mm: Mapping[str, float]
    limit_mm: float


@dataclass(frozen=True)
class MotionBegun:
    """Arms begin to move; the gate has accepted the motion.

    Attributes
    ----------
    stop : int or None
        Number of the stop to which they move; None on other ways: home, to the reference stop, while warming up.
    q_start, q_target : mapping
        Arm -> joint positions (N) [rad]; only of the arms that move.
    expected_s : float
        Duration if no controller slows the motion down [s].
    """

    stop: int | None
    q_start: Mapping[str, tuple[float, ...]]
    q_target: Mapping[str, tuple[float, ...]]
    expected_s: float


@dataclass(frozen=True)
class MotionEnded:
    """The arms of a motion are at rest.

    Attributes
    ----------
    stop : int or None
        As in ``MotionBegun``.
    q : mapping
        Arm -> joint positions (N) from its controller [rad].
    joint_temperature_c : mapping
        Arm -> joint temperatures (N) [degC]; without the arms that do not report them.
    """

    stop: int | None
    q: Mapping[str, tuple[float, ...]]
    joint_temperature_c: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class MeasurementBegun:
    """The tracker points at the SMR of an arm at a stop and begins to measure it."""

    stop: int
    arm: str


@dataclass(frozen=True)
class PointMeasured:
    """The SMR of an arm was measured at a stop.

    Attributes
    ----------
    stop : int
    arm : str
    q : tuple
        Joint positions (N) from the controller [rad].
    p_M : tuple
        Centre of the SMR (3) in the tracker frame [m].
    sigma_mm : float or None
        Standard uncertainty of the point: root of the trace of its covariance [mm]; None if not stated.
    temperature_c : float or None
        Air temperature [degC].
    joint_temperature_c : tuple or None
        Joint temperatures (N) [degC].
    """

    stop: int
    arm: str
    q: tuple[float, ...]
    p_M: tuple[float, float, float]
    sigma_mm: float | None = None
    temperature_c: float | None = None
    joint_temperature_c: tuple[float, ...] | None = None


@dataclass(frozen=True)
class PointMissed:
    """The SMR of an arm could not be measured at a stop; ``reason`` says why, in a sentence."""

    stop: int
    arm: str
    reason: str


@dataclass(frozen=True)
class AirReport:
    """The weather station was read: temperature [degC], pressure [hPa], relative humidity [%]."""

    temperature_c: float
    pressure_hpa: float | None = None
    humidity_percent: float | None = None


@dataclass(frozen=True)
class SweepLive:
    """How far a sweep is that is driven and recorded now; told a few times a second at most.

    Attributes
    ----------
    stop : int
        Number of the stop, from 0, about which the arm swings.
    arm, name : str
        The arm, and the name of its sweep.
    duration_s, done_s : float
        Time of the whole motion, and up to now [s].
    state : str
        ``searching``: the beam broke; the arm rests, and the tracker is led to its SMR again. ``unrecorded``: it was
        not found; the arm finishes its way off the record.
    lost_beams : int
        How often the beam broke.
    """

    stop: int
    arm: str
    name: str
    duration_s: float
    state: Literal["moving", "searching", "unrecorded", "done"] = "moving"
    done_s: float = 0.0
    lost_beams: int = 0

    def words(self) -> list[str]:
        """Return share and time, and lost beams."""
        share = self.done_s / self.duration_s if self.duration_s else 1.0
        words = [f"{share:.0%}, {self.done_s:.0f} of {self.duration_s:.0f} s"]
        if self.lost_beams:
            since = {"searching": ", the SMR is searched", "unrecorded": ", the rest is not recorded"}
            words.append(counted(self.lost_beams, "lost beam") + since.get(self.state, ""))
        return words


@dataclass(frozen=True)
class LogReport:
    """A line of the run's log; ``level`` is info, warning, error or note."""

    level: str
    text: str


Detail = (
    StateChange
    | StopReport
    | Suspicion
    | Notice
    | ReferenceReport
    | MotionBegun
    | MotionEnded
    | MeasurementBegun
    | PointMeasured
    | PointMissed
    | AirReport
    | SweepLive
    | LogReport
)


@dataclass(frozen=True)
class Progress:
    """One step of a long job.

    Attributes
    ----------
    job : str
        What is being done, in a word or two; the same text for all events of one job.
    done, total : int
        Steps finished, and steps in all; ``done == total`` is the job's last event.
    note : str
        What a person would like to know of this step; may be empty.
    eta_s : float or None
        Estimated time to the job's end [s]; None while it is not known.
    detail : Detail or None
        What happened, for those who draw or log it.
    """

    job: str
    done: int
    total: int
    note: str = ""
    eta_s: float | None = None
    detail: Detail | None = None


Listener = Callable[[Progress], None]


Told = Callable[[str], None]
"""Takes what a part of a job is doing, in a few words, often enough to be where a request to cancel is raised."""


def ignore(event: Progress) -> None:
    """A listener for those who do not look."""


def ignore_words(words: str) -> None:
    """Words that nobody reads."""


class SharedProgress:
    """Progress of one job whose parts run at the same time: the steps of all parts are added."""

    def __init__(self, job: JobToken, name: str, done: int, total: int) -> None:
        """``done`` of ``total`` steps are done before the parts begin."""
        self._job, self._name, self._begun, self._total = job, name, done, total
        self._done: dict[str, int] = {}
        self._lock = threading.Lock()

    def part(self, name: str) -> JobSteps:
        """Return the steps of one part."""

        def report(done: int, words: str) -> None:
            with self._lock:
                self._done[name] = done
                self._job.tell(self._name, self._begun + sum(self._done.values()), self._total, f"{name}: {words}")

        return JobSteps(report, self._job)


class Cancelled(Exception):
    """The job was cancelled by a person; what it had committed stays."""


class JobToken:
    """Who follows a long job, and whether somebody asked to end it. All methods may be called from any thread.

    Parameters
    ----------
    listener : callable
        Takes the events, one at a time.
    clock : callable
        Returns the time [s], for estimates.
    """

    def __init__(self, listener: Listener = ignore, clock: Callable[[], float] = time.monotonic) -> None:
        self._event, self._telling = threading.Event(), threading.RLock()
        self._listener, self._clock = listener, clock
        self._paces: dict[str, _Pace] = {}

    def tell(self, job: str, done: int, total: int, note: str = "", detail: Detail | None = None) -> None:
        """Tell those who follow an event of the job, as in ``Progress``, with the estimated time to its end.

        The estimate is the rate of its own recent steps; steps that were done before the first event do not count.
        """
        event = Progress(job, done, total, note, detail=detail)
        with self._telling:
            eta_s = self._paces.setdefault(job, _Pace()).eta_s(event, self._clock())
            self._listener(replace(event, eta_s=eta_s))

    @contextmanager
    def heard_by(self, hear: Callable[[Progress, Listener], None]) -> Iterator[None]:
        """Let ``hear`` take the events in this context, with the listener that took them before."""
        before, self._listener = self._listener, lambda event: hear(event, before)
        try:
            yield
        finally:
            self._listener = before

    def cancel(self) -> None:
        """Ask the job to stop at its next step."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether somebody asked to stop."""
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Rest for at most ``timeout_s``, less if somebody asks to stop; whether somebody did."""
        return self._event.wait(timeout_s)

    def check(self) -> None:
        """Raise ``Cancelled`` if somebody asked to stop."""
        if self.cancelled:
            raise Cancelled("stopped on request")


class UnattendedJob(JobToken):
    """A job that nobody follows or ends; the same for all calls without a job, so that none may end it for others."""

    def tell(self, job: str, done: int, total: int, note: str = "", detail: Detail | None = None) -> None:
        """Tell nobody."""

    def cancel(self) -> None:
        """Refuse: it would end every call without a job of its own."""
        raise RuntimeError("an unattended job cannot be cancelled: give the call a JobToken of its own")


UNATTENDED = UnattendedJob()


@dataclass(frozen=True)
class JobSteps:
    """The steps of a part of a job: told as they are done, each with a few words, and ended by a request to cancel."""

    report: Callable[[int, str], object] = lambda done, words: None
    job: JobToken = UNATTENDED

    def __call__(self, done: int, words: str) -> None:
        """Tell how many steps are done, and what is under way."""
        self.report(done, words)

    def check(self) -> None:
        """Raise ``Cancelled`` if somebody asked to stop."""
        self.job.check()

    def after(self, first: int, what: str) -> JobSteps:
        """Return the steps of ``what``, which begin when ``first`` steps are done."""
        return JobSteps(lambda done, words: self(first + done, f"{what}: {words}"), self.job)


UNTOLD = JobSteps()
"""Steps that nobody follows or cancels."""


# -- How fast a job goes on: the estimated time to its end, and lines that tell it where there is no terminal ---------

_RECENT_STEPS = 20
"""Steps of which the rate is taken: enough to smooth single long ones, few enough to follow a change of pace."""


_SILENCE_S = 60.0
"""How long a job without a terminal is silent at most, while it has something to tell."""


def in_lines(say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> Listener:
    """Return a listener that says in a line how far a long job is, at most once a minute; nothing of a shorter one."""
    said_s = clock()
    lock = threading.Lock()

    def listen(event: Progress) -> None:
        nonlocal said_s
        with lock:
            now_s = clock()
            if now_s - said_s < _SILENCE_S:
                return
            said_s = now_s
        words = (f"{event.done} of {event.total}", event.note, eta_words(event.eta_s))
        say(f"{event.job}: {', '.join(filter(None, words))}")

    return listen


@dataclass
class _Pace:
    """When the recent steps of a job were done: (steps done, time [s])."""

    steps: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=_RECENT_STEPS + 1))

    def eta_s(self, event: Progress, now_s: float) -> float | None:
        """Return the estimated time to the job's end [s]; None before a step was done under our eyes."""
        if event.done >= event.total:
            self.steps.clear()
            return 0.0
        again = bool(self.steps) and event.done < self.steps[-1][0]
        if again or isinstance(event.detail, StateChange):  # a pause is no part of the pace
            self.steps.clear()
        if not self.steps or event.done > self.steps[-1][0]:
            self.steps.append((event.done, now_s))
        (first, began_s), (last, latest_s) = self.steps[0], self.steps[-1]
        if last == first:
            return None
        step_s = (latest_s - began_s) / (last - first)
        if now_s - latest_s > step_s:  # the present step is longer than those before
            step_s = (now_s - began_s) / (last - first + 1)
        return max((event.total - last) * step_s - (now_s - latest_s), 0.0)


def eta_words(eta_s: float | None) -> str:
    """Return an estimated time as "3 min left"; empty while it is not known."""
    if eta_s is None:
        return ""
    return f"{duration_words(eta_s)} left"


def duration_words(seconds: float) -> str:
    """Return a duration as "1 h 05 min", "12 min" or "40 s"."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
