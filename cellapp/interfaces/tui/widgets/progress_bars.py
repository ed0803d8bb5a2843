"""Bars of the parts of a job, each with its count and remaining time."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import datetime, timedelta

from textual.content import Content
from textual.reactive import reactive
from textual.widget import Widget

from cellapp.ground.progress import Progress, eta_words
from cellapp.interfaces.tui.job_record import JobRecord, Pace

WHOLE_DAY = ("plan", "collect", "calibrate", "discover", "push")
"""Parts of a whole day, in order."""
_NAME, _COUNT = 10, 9
"""Columns of the name and of the count."""
_WHOLE = 100.0
"""Steps per minute from which a rate is shown as a whole number: three digits would make it a power of ten."""
_WIDEST_BAR = 40


@dataclass(frozen=True)
class Part:
    """One part of a job; ``progress`` is None before it begins. ``waits``: the job is paused, suspended or stopped."""

    name: str
    progress: Progress | None = None
    pace: Pace | None = None
    waits: bool = False

    def remaining_s(self, now_s: float) -> float | None:
        """Return the remaining time: the estimate minus its age; None if the job waits."""
        if self.progress is None or not self.progress.eta_s or self.waits:
            return None
        return self.progress.eta_s - (0.0 if self.pace is None else now_s - self.pace.heard_s)


def parts_of(record: JobRecord) -> tuple[Part, ...]:
    """Return the parts of a job in the order of the day, and the present one; of a whole day, also those to come."""
    names = dict.fromkeys(name for name in WHOLE_DAY if name in record.progress or record.name == "run")
    if record.latest is not None:  # of the others only the present one: candidates of a plan are no part of a day
        names.setdefault(record.latest.job)
    waits = record.state not in ("running", "pausing")
    return tuple(Part(name, record.progress.get(name), record.paces.get(name), waits) for name in names)


def present_part(record: JobRecord) -> Part | None:
    """Return the part that reported last; None before the first report."""
    latest = record.latest
    return next((part for part in parts_of(record) if latest is not None and part.name == latest.job), None)


def ending_words(eta_s: float | None, now: datetime) -> str:
    """Return an estimated time in words and as clock time: ``12 min left, at 14:32``."""
    if eta_s is None:
        return ""
    if eta_s <= 0.0:
        return "any moment"
    end = now + timedelta(seconds=eta_s)
    day = "" if end.date() == now.date() else f"{end:%A} "
    return f"{eta_words(eta_s)}, at {day}{end:%H:%M}"


class ProgressBars(Widget):
    """One line for each part; if ``compact``, one line for the current part."""

    parts: reactive[tuple[Part, ...]] = reactive(())
    compact: reactive[bool] = reactive(False, layout=True)

    def __init__(self) -> None:
        super().__init__(classes="parts")
        self._words = ""
        self.tooltip = "The parts of the job: steps done, what is done now, the time that is left, when it will end."

    def on_mount(self) -> None:
        """Start the timer that updates the remaining time between events."""
        self.set_interval(1.0, self._tick)

    def _tick(self) -> None:
        """Redraw only if the words have changed, to save output on a slow terminal line."""
        if self.parts and self._bars().plain != self._words:
            self.refresh()

    def watch_parts(self, before: tuple[Part, ...], now: tuple[Part, ...]) -> None:
        """Lay out again if the number of lines has changed."""
        if self._lines(before) != self._lines(now):
            self.refresh(layout=True)

    def render(self) -> Content:
        """Return the bars."""
        drawn = self._bars()
        self._words = drawn.plain
        return drawn

    def _bars(self) -> Content:
        width, now = self.content_size.width, datetime.now()
        begun = [part for part in self.parts if part.progress is not None]
        if not self.parts:
            return Content("")
        if not self.compact or not begun:
            return Content("\n").join([_line(part, width, now) for part in self.parts])
        present = next((part for part in reversed(begun) if not _done(part)), begun[-1])
        which = f"  part {self.parts.index(present) + 1} of {len(self.parts)}" if len(self.parts) > 1 else ""
        return Content.assemble(_line(present, width - len(which), now), (which, "$text-muted"))

    def get_content_height(self, container: object, viewport: object, width: int) -> int:
        """Return one line, or one for each part."""
        return self._lines(self.parts)

    @property
    def lines(self) -> int:
        """Number of lines that the current parts need."""
        return self._lines(self.parts)

    def _lines(self, parts: tuple[Part, ...]) -> int:
        is_one_line = self.compact and any(part.progress is not None for part in parts)
        return 1 if is_one_line else len(parts)


def _done(part: Part) -> bool:
    return part.progress is not None and part.progress.done >= part.progress.total


def _line(part: Part, width: int, now: datetime) -> Content:
    """Return name, bar, count, remaining time, note; what does not fit is omitted from the end."""
    progress = part.progress
    if progress is None:
        return Content.assemble((f"{part.name:<{_NAME}}", "$text-muted"), ("to come", "$text-muted"))
    count = f"{progress.done}/{progress.total}"
    length = max(min(_WIDEST_BAR, (width - _NAME - _COUNT) // 3), 6)
    filled = length if _done(part) else int(length * progress.done / max(progress.total, 1))
    rate = None if part.pace is None or _done(part) else part.pace.per_minute(progress.done)
    paced = "" if rate is None else f"{rate:.3g}/min" if rate < _WHOLE else f"{rate:.0f}/min"
    ending = "" if _done(part) else ending_words(part.remaining_s(time.monotonic()), now)
    words = " · ".join(word for word in (ending, progress.note, paced) if word)
    room = max(width - _NAME - length - _COUNT - 2, 0)
    return Content.assemble(
        (f"{part.name:<{_NAME}}", "bold"),
        ("━" * filled, "$success" if _done(part) else "$primary"),
        ("─" * (length - filled), "$text-muted"),
        f" {count:>{_COUNT}} ",
        words if len(words) <= room else words[: max(room - 1, 0)] + "…",
    )
