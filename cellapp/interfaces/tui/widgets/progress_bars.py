"""Bars of the parts of a job, each with its count and remaining time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from textual.content import Content

from cellapp.ground.progress import Progress, eta_words
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.widgets.controls import Line

WHOLE_DAY = ("plan", "collect", "calibrate", "discover", "push")
"""Parts of a whole day, in order."""
_NAME, _COUNT = 10, 9
"""Columns of the name and of the count."""
_WIDEST_BAR = 40
_TALL = 50
"""Smallest number of lines of a terminal with one line for each part."""


@dataclass(frozen=True)
class Part:
    """One part of a job; ``progress``, None before it begins, was heard at ``heard_s`` [s, monotonic].

    ``waits``: the job is paused, suspended or stopped.
    """

    name: str
    progress: Progress | None = None
    heard_s: float = 0.0
    waits: bool = False

    def remaining_s(self, now_s: float) -> float | None:
        """Return the remaining time: the estimate minus its age; None if the job waits."""
        if self.progress is None or not self.progress.eta_s or self.waits:
            return None
        return self.progress.eta_s - (now_s - self.heard_s)


def parts_of(record: JobRecord) -> tuple[Part, ...]:
    """Return the parts of a job in the order of the day, and the present one; of a whole day, also those to come."""
    names = dict.fromkeys(name for name in WHOLE_DAY if name in record.progress or record.name == "run")
    if record.latest is not None:  # of the others only the present one: candidates of a plan are no part of a day
        names.setdefault(record.latest.job)
    waits = record.state not in ("running", "pausing")
    return tuple(Part(name, record.progress.get(name), record.heard_s.get(name, 0.0), waits) for name in names)


def ending_words(eta_s: float | None, now: datetime) -> str:
    """Return an estimated time in words and as clock time: ``12 min left, at 14:32``."""
    if eta_s is None:
        return ""
    if eta_s <= 0.0:
        return "any moment"
    end = now + timedelta(seconds=eta_s)
    day = "" if end.date() == now.date() else f"{end:%A} "
    return f"{eta_words(eta_s)}, at {day}{end:%H:%M}"


class ProgressBars(Line):
    """One line for each part of a job; in a low terminal only that of the present part."""

    def __init__(self) -> None:
        super().__init__()
        self.tooltip = "The parts of the job: steps done, what is done now, the time that is left, when it will end."

    def show(self, record: JobRecord) -> None:
        """Draw the parts of the current job; nothing without one."""
        parts = parts_of(record) if record.state is not None else ()
        self.display = bool(parts)
        self.say(bars_of(parts, self.screen.size.width - 2, compact=self.app.size.height < _TALL))


def bars_of(parts: Sequence[Part], width: int, *, compact: bool) -> Content:
    """Return the lines of the parts; if ``compact``, that of the present one with its number."""
    now, begun = datetime.now(), [part for part in parts if part.progress is not None]
    if not compact or not begun:
        return Content("\n").join([_line(part, width, now) for part in parts])
    present = next((part for part in reversed(begun) if not _done(part)), begun[-1])
    which = f"  part {parts.index(present) + 1} of {len(parts)}" if len(parts) > 1 else ""
    return Content.assemble(_line(present, width - len(which), now), (which, "$text-muted"))


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
    ending = "" if _done(part) else ending_words(part.remaining_s(time.monotonic()), now)
    words = " · ".join(word for word in (ending, progress.note) if word)
    room = max(width - _NAME - length - _COUNT - 2, 0)
    return Content.assemble(
        (f"{part.name:<{_NAME}}", "bold"),
        ("━" * filled, "$success" if _done(part) else "$primary"),
        ("─" * (length - filled), "$text-muted"),
        f" {count:>{_COUNT}} ",
        words if len(words) <= room else words[: max(room - 1, 0)] + "…",
    )
