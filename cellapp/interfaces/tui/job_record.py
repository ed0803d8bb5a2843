"""State of the current job for the screens, reduced from the events of its thread.

Words for the current state of the cell: the age of all data, the progress of each arm's stop. Draws nothing.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import islice
from typing import Literal, get_args

from cellapp.ground.progress import (
    AirReport,
    ArmLive,
    CellLive,
    Detail,
    HaltState,
    JobState,
    LogReport,
    MeasurementBegun,
    MotionBegun,
    MotionEnded,
    Notice,
    PointMeasured,
    PointMissed,
    Progress,
    ReferenceReport,
    StateChange,
    StopReport,
    Suspicion,
    SweepLive,
)

LATE_S, LOST_S = 0.3, 1.0
"""Ages from which data are late, and lost: lost data say nothing about now."""
Freshness = Literal["fresh", "late", "lost"]

HALT_WORDS: Mapping[HaltState, str] = {
    "asked": "STOP ASKED",
    "braking": "BRAKING",
    "at rest": "AT REST",
    "not seen at rest": "NOT SEEN AT REST",
}
_WORST_FIRST: tuple[HaltState, ...] = ("not seen at rest", "asked", "braking", "at rest")
_TREAT_AS_MOVING = "treat it as moving: emergency stop, then look"


def freshness_of(age_s: float | None) -> Freshness:
    """Return how data of an age are displayed; None means no data."""
    if age_s is None or age_s > LOST_S:
        return "lost"
    return "late" if age_s > LATE_S else "fresh"


def age_words(age_s: float | None) -> str:
    """Format an age as "0.2 s", in steps that an eye can follow."""
    if age_s is None:
        return "no data"
    return f"{age_s:.1f} s" if age_s < 10.0 else f"{age_s:.0f} s"


def halt_of(arm: ArmLive) -> HaltState | None:
    """Return the progress of an arm's halt; without current data it is not seen at rest, whatever was commanded."""
    if arm.halt is None:
        return None
    unknown = arm.halt.state in ("asked", "braking") and freshness_of(arm.age_s) == "lost"
    return "not seen at rest" if unknown else arm.halt.state


def strip_of(live: CellLive) -> list[tuple[str, Freshness]]:
    """Return each arm, the tracker and the job in words with the age of their data, and how these are displayed."""
    parts: list[tuple[str, Freshness]] = []
    for name, arm in live.arms.items():
        halt, look = halt_of(arm), freshness_of(arm.age_s)
        doing = HALT_WORDS[halt] if halt else "no state" if look == "lost" else "moves" if arm.moving else "rests"
        parts.append((f"{name} {doing} {age_words(arm.age_s)}", "lost" if halt == "not seen at rest" else look))
    ages = (("tracker", live.tracker_age_s), ("job", live.job_age_s))
    return [*parts, *((f"{name} {age_words(age_s)}", freshness_of(age_s)) for name, age_s in ages)]


def banner_of(live: CellLive | None, unseen: Mapping[str, str]) -> tuple[str, Sequence[str], bool] | None:
    """Return the banner of a halt or of missing data; None if there is neither.

    The banner is words that begin with the state, its causes, and whether an arm counts as moving. ``unseen`` are the
    arms that the open run counts as moving, arm -> why.
    """
    halts = {} if live is None else {name: halt_of(arm) for name, arm in live.arms.items()}
    state = next((state for state in _WORST_FIRST if state in halts.values()), None)
    names = [name for name, halt in halts.items() if halt == "not seen at rest"]
    names += [name for name in unseen if name not in halts]
    causes = () if live is None else live.causes
    if names:
        arms = f"arm{'s' if len(names) > 1 else ''} {', '.join(names)}"
        return f"NOT SEEN AT REST: {arms}; {_TREAT_AS_MOVING}", causes or [*unseen.values()], True
    if state is not None:
        words = {"asked": "STOP ASKED", "braking": "ARMS BRAKE", "at rest": "AT REST: all arms were seen at rest"}
        return words[state], causes, False
    lost = [] if live is None else without_data(live)
    if lost:
        return f"NO DATA from {', '.join(lost)}: what is shown of it is old", (), True
    return None


def without_data(live: CellLive) -> list[str]:
    """Return the names of the devices that send no data."""
    arms = [f"arm {name}" for name, arm in live.arms.items() if freshness_of(arm.age_s) == "lost"]
    return [*arms, *(["tracker"] if freshness_of(live.tracker_age_s) == "lost" else [])]


Level = Literal["info", "warning", "error"]
LEVELS: tuple[Level, ...] = get_args(Level)
MOST_LINES = 5000
"""Number of log lines that the screen keeps; the run file keeps all."""

Activity = (
    Literal["unknown", "moving", "settling", "measuring", "measured", "not measured", "resting", "stopped"] | HaltState
)


def level_of(word: str) -> Level:
    """Return the level of a word in a run's log; ``note`` and unknown words count as info."""
    return next((level for level in LEVELS if level == word), "info")


@dataclass(frozen=True)
class LogRow:
    """One line of the log: its time, its level, its text."""

    at: datetime
    level: Level
    text: str


@dataclass(frozen=True)
class ArmRecord:
    """Newest known state of one arm.

    Attributes
    ----------
    activity : str
        What it does; ``settling``: at rest at a stop and not measured yet.
    stop : int or None
        Index of the stop, from 0, to which it moves or at which it is; None on other motions.
    reason : str
        Why its SMR was not measured; empty otherwise.
    q : tuple or None
        Joint positions (N) from the controller, at its last rest [rad].
    joint_temperature_c : tuple or None
        Joint temperatures (N) [degC]; None if not reported.
    expected_s : float or None
        Expected duration of the current motion [s].
    report : StopReport or None
        Error of the newest stop and standard error so far.
    """

    activity: Activity = "unknown"
    stop: int | None = None
    reason: str = ""
    q: tuple[float, ...] | None = None
    joint_temperature_c: tuple[float, ...] | None = None
    expected_s: float | None = None
    report: StopReport | None = None


@dataclass(frozen=True)
class TrackerRecord:
    """Newest known state of the tracker and of the air.

    Attributes
    ----------
    arm : str or None
        Arm whose SMR it measures or has measured.
    measuring : bool
        Whether it measures now.
    point : PointMeasured or None
        The newest point.
    air : AirReport or None
        The newest state of the air, from the weather station or else from the tracker.
    sweep : SweepLive or None
        Progress of the sweep that it follows; None if it follows none.
    """

    arm: str | None = None
    measuring: bool = False
    point: PointMeasured | None = None
    air: AirReport | None = None
    sweep: SweepLive | None = None


@dataclass
class JobRecord:
    """State of one job, reduced from its events. Only the thread of the screens writes and reads it.

    Records of arms and tracker are replaced, never changed, so that a screen can detect changes with ``is``.

    Attributes
    ----------
    name : str
        What was started, in a word or two; empty before the first job.
    part : str
        Name in its events for what people call ``name``: a push that measures is a verification.
    state : JobState or None
        None while no job runs.
    reason : str
        Why the job is in its state, in a sentence; may be empty.
    since : datetime
        When it entered its state.
    heard_s : dict
        Part -> time of its newest event [s, monotonic].
    progress : dict
        Part -> its newest event; the part that reported last is the last one.
    arms : dict
        Arm -> its newest known state.
    tracker : TrackerRecord
    stops : list
        Reports of the stops of all arms, oldest first.
    references : list
        Reports of reference measurements, oldest first.
    suspicions : list
        Suspicions that the measurements raised.
    log : deque
        Lines, oldest first.
    log_written : int
        Number of lines that were ever written.
    causes : tuple of str
        Why the arms were stopped, according to the open cell, even before the job's thread has noticed.
    lost : tuple of str
        Devices of the open cell that send no data.
    changes : int
        Counter that every event increments, so that a screen knows whether to redraw.
    """

    name: str = ""
    state: JobState | None = None
    reason: str = ""
    part: str = ""
    since: datetime = field(default_factory=datetime.now)
    heard_s: dict[str, float] = field(default_factory=dict)
    progress: dict[str, Progress] = field(default_factory=dict)
    arms: dict[str, ArmRecord] = field(default_factory=dict)
    tracker: TrackerRecord = field(default_factory=TrackerRecord)
    stops: list[StopReport] = field(default_factory=list)
    references: list[ReferenceReport] = field(default_factory=list)
    suspicions: list[Suspicion] = field(default_factory=list)
    log: deque[LogRow] = field(default_factory=lambda: deque(maxlen=MOST_LINES))
    log_written: int = 0
    causes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    changes: int = 0

    @property
    def latest(self) -> Progress | None:
        """The newest event; None before the first."""
        return next(reversed(self.progress.values()), None)

    def newest_lines(self, written: int) -> list[LogRow]:
        """Return the kept lines written since ``log_written`` had the value ``written``; oldest first."""
        count = min(self.log_written - written, len(self.log))
        return list(islice(reversed(self.log), count))[::-1]

    def begin(self, name: str, part: str = "") -> None:
        """Reset for a new job, but keep the log. Events of ``part`` are stored under the job's own name."""
        self.name, self.part, self.state, self.reason, self.tracker = name, part, "running", "", TrackerRecord()
        self.since = datetime.now()
        for kept in (self.progress, self.heard_s, self.arms, self.stops, self.references, self.suspicions):
            kept.clear()
        self.causes, self.lost = (), ()
        self.changes += 1

    def end(self) -> None:
        """Note that the job has ended; its reports are kept."""
        self.state, self.reason = None, ""
        self.causes, self.lost = (), ()
        self._rest_arms("resting")
        self.changes += 1

    def look(self, live: CellLive | None) -> None:
        """Update from the current state of the open cell; no event of the job is needed."""
        causes, lost = ((), ()) if live is None else (live.causes, tuple(without_data(live)))
        if (causes, lost) != (self.causes, self.lost):
            self.causes, self.lost = causes, lost
            self.changes += 1
        for name, arm in () if live is None else live.arms.items():
            halt, before = halt_of(arm), self._arm(name)
            if halt is not None and halt != before.activity:
                self.arms[name] = replace(before, activity=halt, expected_s=None)
                self.changes += 1
                if halt == "not seen at rest":
                    self.note(f"arm {name}: NOT SEEN AT REST, treat it as moving", "error")

    def note(self, text: str, level: Level = "info") -> None:
        """Add a line to the log."""
        self.log.append(LogRow(datetime.now(), level, text))
        self.log_written += 1
        self.changes += 1

    def add(self, event: Progress) -> None:
        """Process one event."""
        if event.job == self.part:
            event = replace(event, job=self.name)
        self.heard_s[event.job] = time.monotonic()
        before = self.progress.pop(event.job, None)  # reinserted below: the newest part is the last one
        if before is not None and event.detail is not None and not event.note:
            self.progress[event.job] = replace(event, note=before.note)  # the note of a step stays until the next step
        else:
            self.progress[event.job] = event
        self.changes += 1
        if event.detail is not None:
            self._take(event.job, event.detail)

    # -- details -------------------------------------------------------------------------------------------------------

    def _take(self, job: str, detail: Detail) -> None:
        """Process a detail; write a line into the log where the job itself writes none."""
        match detail:
            case LogReport(level, text):
                self.note(text, level_of(level))
            case Notice(text):
                self.note(f"{job}: {text}")
            case StateChange(state, reason):
                self._change_state(detail)
                self.note(f"{job}: {state.upper()}: {reason}", "info" if state == "running" else "warning")
            case Suspicion(kind, text):
                self.suspicions.append(detail)
                self.note(f"{job}: SUSPICION: {kind}: {text}", "warning")
            case ReferenceReport(drift_mm, limit_mm):
                self.references.append(detail)
                drifts = ", ".join(f"{name} {drift:.3f}" for name, drift in drift_mm.items())
                words = f"{job}: reference: {drifts} mm from the first measurement, limit {limit_mm:.3f} mm"
                self.note(words, "info" if within_limit(detail) else "warning")
            case SweepLive():
                live = None if detail.state == "done" else detail
                self.tracker = replace(self.tracker, arm=detail.arm, sweep=live)
            case AirReport():
                self.tracker = replace(self.tracker, air=detail)
            case MotionBegun() | MotionEnded():
                self._take_motion(detail)
            case StopReport() | MeasurementBegun() | PointMeasured() | PointMissed():
                self._take_measurement(detail)

    def _arm(self, name: str) -> ArmRecord:
        return self.arms.get(name, ArmRecord())

    def _take_motion(self, motion: MotionBegun | MotionEnded) -> None:
        if isinstance(motion, MotionBegun):
            for name, q in motion.q_start.items():
                moving = replace(self._arm(name), activity="moving", stop=motion.stop, reason="", q=q)
                self.arms[name] = replace(moving, expected_s=motion.expected_s)
            return
        activity: Activity = "resting" if motion.stop is None else "settling"
        for name, q in motion.q.items():
            arm = replace(self._arm(name), activity=activity, stop=motion.stop, q=q, expected_s=None)
            warm = motion.joint_temperature_c.get(name, arm.joint_temperature_c)
            self.arms[name] = replace(arm, joint_temperature_c=warm)

    def _take_measurement(self, detail: StopReport | MeasurementBegun | PointMeasured | PointMissed) -> None:
        name, arm = detail.arm, self._arm(detail.arm)
        match detail:
            case StopReport():
                self.stops.append(detail)
                self.arms[name] = replace(arm, report=detail)
            case MeasurementBegun(stop=stop):
                self.arms[name] = replace(arm, activity="measuring", stop=stop)
                self.tracker = replace(self.tracker, arm=name, measuring=True, sweep=None)
            case PointMissed(stop=stop, reason=reason):
                self.arms[name] = replace(arm, activity="not measured", stop=stop, reason=reason)
                self.tracker = replace(self.tracker, arm=name, measuring=False)
            case PointMeasured():
                measured = replace(arm, activity="measured", stop=detail.stop, reason="", q=detail.q)
                warm = detail.joint_temperature_c or arm.joint_temperature_c
                self.arms[name] = replace(measured, joint_temperature_c=warm)
                self.tracker = TrackerRecord(name, False, detail, self._air_of(detail))

    def _air_of(self, point: PointMeasured) -> AirReport | None:
        """Return the air at a point: all that is known if the temperature is the same, else the temperature alone."""
        air = self.tracker.air
        if point.temperature_c is None or (air is not None and air.temperature_c == point.temperature_c):
            return air
        return AirReport(point.temperature_c)

    def _change_state(self, change: StateChange) -> None:
        if change.state != self.state:
            self.since = datetime.now()
        self.state, self.reason = change.state, change.reason
        if change.state in ("stopped", "aborted"):
            self._rest_arms("stopped")

    def _rest_arms(self, activity: Activity) -> None:
        """Set arms that moved or waited to be measured to ``activity``."""
        for name, arm in self.arms.items():
            if arm.activity in ("moving", "settling", "measuring", "stopped", "asked", "braking", "at rest"):
                self.arms[name] = replace(arm, activity=activity, expected_s=None)
        self.tracker = replace(self.tracker, measuring=False, sweep=None)


def within_limit(report: ReferenceReport) -> bool:
    """Return whether no reference moved farther than the limit."""
    return max(report.drift_mm.values(), default=0.0) <= report.limit_mm
