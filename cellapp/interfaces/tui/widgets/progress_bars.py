"""Bars of the parts of a job, each with its count and remaining time."""

from __future__ import annotations

import time
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


def parts_of(record: JobRecord) -> list[str]:
    """Return the parts of a job in the order of the day, and the present one; of a whole day, also those to come."""
    names = dict.fromkeys(name for name in WHOLE_DAY if name in record.progress or record.name == "run")
    if record.latest is not None:  # of the others only the present one: candidates of a plan are no part of a day
        names.setdefault(record.latest.job)
    return [*names]


def remaining_s(record: JobRecord, part: str, now_s: float) -> float | None:
    """Return the remaining time of a part: the estimate minus its age; None if there is none, or the job waits."""
    eta_s = record.progress[part].eta_s
    if not eta_s or record.state not in ("running", "pausing"):
        return None
    return eta_s - (now_s - record.heard_s[part])


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
        self.display = record.state is not None and bool(parts_of(record))
        self.say(bars_of(record, self.screen.size.width - 2, compact=self.app.size.height < _TALL))


def bars_of(record: JobRecord, width: int, *, compact: bool) -> Content:
    """Return the lines of the parts; if ``compact``, that of the present one with its number."""
    parts, now = parts_of(record), datetime.now()
    begun = [part for part in parts if part in record.progress]
    if not compact or not begun:
        return Content("\n").join([_line(record, part, width, now) for part in parts])
    present = next((part for part in reversed(begun) if not _done(record.progress[part])), begun[-1])
    which = f"  part {parts.index(present) + 1} of {len(parts)}" if len(parts) > 1 else ""
    return Content.assemble(_line(record, present, width - len(which), now), (which, "$text-muted"))


def _done(progress: Progress) -> bool:
    return progress.done >= progress.total


def _line(record: JobRecord, part: str, width: int, now: datetime) -> Content:
    """Return name, bar, count, remaining time, note; what does not fit is omitted from the end."""
    progress = record.progress.get(part)
    if progress is None:
        return Content.assemble((f"{part:<{_NAME}}to come", "$text-muted"))
    count, done = f"{progress.done}/{progress.total}", _done(progress)
    length = max(min(_WIDEST_BAR, (width - _NAME - _COUNT) // 3), 6)
    filled = length if done else int(length * progress.done / max(progress.total, 1))
    ending = "" if done else ending_words(remaining_s(record, part, time.monotonic()), now)
    words = " · ".join(word for word in (ending, progress.note) if word)
    room = max(width - _NAME - length - _COUNT - 2, 0)
    return Content.assemble(
        (f"{part:<{_NAME}}", "bold"),
        ("━" * filled, "$success" if done else "$primary"),
        ("─" * (length - filled), "$text-muted"),
        f" {count:>{_COUNT}} ",
        words if len(words) <= room else words[: max(room - 1, 0)] + "…",
    )
