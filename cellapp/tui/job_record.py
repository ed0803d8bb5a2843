"""What is known of the present job: events of its thread, reduced to what screens draw."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

from cellapp.progress import JobState, Progress, ReferenceReport, StateChange, StopReport, Suspicion
from cellapp.reporting.progress_words import detail_words

Level = Literal["debug", "info", "warning", "error"]
LEVELS: tuple[Level, ...] = ("debug", "info", "warning", "error")
_MOST_LINES = 5000
"""Lines of the log that the screen keeps; the run file keeps all."""


@dataclass(frozen=True)
class LogEntry:
    """One line of the log: when it was heard, how important it is, what it says."""

    at: datetime
    level: Level
    text: str


@dataclass
class JobRecord:
    """The events of one job, reduced. Only the thread of the screens writes and reads it.

    Attributes
    ----------
    name : str
        What was started, in a word or two; empty before the first job.
    state : JobState or None
        None while no job runs.
    progress : dict
        The newest event of each part, by its name, in the order in which the parts began.
    stops : dict
        Arm -> reports of its stops, oldest first.
    references : list
        Reports of reference measurements, oldest first.
    suspicions : list
        What the measurements made doubtful.
    log : deque
        Lines, oldest first.
    changes : int
        Grows with every event, so that a screen knows whether to draw again.
    """

    name: str = ""
    state: JobState | None = None
    progress: dict[str, Progress] = field(default_factory=dict)
    stops: dict[str, list[StopReport]] = field(default_factory=dict)
    references: list[ReferenceReport] = field(default_factory=list)
    suspicions: list[Suspicion] = field(default_factory=list)
    details: dict[str, object] = field(default_factory=dict)
    log: deque[LogEntry] = field(default_factory=lambda: deque(maxlen=_MOST_LINES))
    changes: int = 0

    @property
    def latest(self) -> Progress | None:
        """The newest event; None before the first."""
        return next(reversed(self.progress.values()), None)

    def begin(self, name: str) -> None:
        """Forget the job before, but not its log."""
        self.name, self.state = name, "running"
        for kept in (self.progress, self.stops, self.references, self.suspicions, self.details):
            kept.clear()
        self.changes += 1

    def end(self) -> None:
        """The job has ended; what it reported stays."""
        self.state = None
        self.changes += 1

    def note(self, text: str, level: Level = "info") -> None:
        """Add a line to the log."""
        self.log.append(LogEntry(datetime.now(), level, text))
        self.changes += 1

    def add(self, event: Progress) -> None:
        """Take in one event."""
        self.progress.pop(event.job, None)  # the newest part is the last one
        self.progress[event.job] = event
        self.changes += 1
        match event.detail:
            case None:
                self.note(f"{event.job} {event.done}/{event.total} {event.note}".rstrip(), "debug")
                return
            case StopReport(arm=arm):
                self.stops.setdefault(arm, []).append(event.detail)
            case StateChange(state):
                self.state = state
                self.note(f"{event.job}: {detail_words(event.detail)}", "info" if state == "running" else "warning")
            case Suspicion():
                self.suspicions.append(event.detail)
                self.note(f"{event.job}: {detail_words(event.detail)}", "warning")
            case ReferenceReport():
                self.references.append(event.detail)
                self.note(f"{event.job}: {detail_words(event.detail)}", "info")
