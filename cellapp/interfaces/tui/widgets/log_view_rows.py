"""Rows of a log as lines of a given width: which are shown, where each begins, which contain a text. Draws nothing."""

from __future__ import annotations

import textwrap
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from cellapp.interfaces.tui.job_record import LEVELS, MOST_LINES, Level, LogRow

MARKS: dict[Level, str] = {"debug": "·", "info": " ", "warning": "!", "error": "✖"}
"""One character for each level, in addition to its colour."""
_SPARE_ROWS = 500
"""Rows beyond the limit that are kept until the oldest are dropped in one batch."""

_HEAD, _DATED_HEAD = 11, 17
"""Characters of time and mark, without and with the date."""
_LEAST_WIDTH = 8
"""Smallest length of a line of text [characters], however narrow the view is."""


@dataclass(frozen=True)
class LogFilter:
    """Filter of rows: from a level upwards, and only those that contain a text, case-insensitive."""

    least: Level = "info"
    text: str = ""

    def passes(self, row: LogRow) -> bool:
        """Return whether a row is shown."""
        return LEVELS.index(row.level) >= LEVELS.index(self.least) and self.text.lower() in row.text.lower()


@dataclass(frozen=True)
class LogLine:
    """One line on the screen: the index of its row among the shown ones, its text, whether the row begins here."""

    number: int
    row: LogRow
    text: str
    is_first: bool


@dataclass
class LogRows:
    """All rows of a log, those that a filter passes, and their lines.

    Attributes
    ----------
    rows : list
        All rows that are kept, oldest first.
    shown : list
        Those that pass the filter.
    counts : Counter
        Number of kept rows of each level.
    width : int
        Characters of a line.
    dated : bool
        Whether times have a date: rows of other days.
    """

    rows: list[LogRow] = field(default_factory=list)
    shown: list[LogRow] = field(default_factory=list)
    filter: LogFilter = field(default_factory=LogFilter)
    counts: Counter[Level] = field(default_factory=Counter)
    width: int = 80
    dated: bool = False
    _starts: list[int] = field(default_factory=list)
    _height: int = 0

    @property
    def height(self) -> int:
        """Number of lines."""
        return self._height

    def replace(self, rows: Sequence[LogRow], *, dated: bool) -> None:
        """Replace the rows by those of another log."""
        self.rows, self.dated = list(rows[-MOST_LINES:]), dated
        self.arrange()

    def add(self, rows: Iterable[LogRow]) -> None:
        """Add newer rows; drop the oldest if there are too many."""
        new = list(rows)
        self.rows += new
        self._append(new)
        if len(self.rows) > MOST_LINES + _SPARE_ROWS:
            self._drop(len(self.rows) - MOST_LINES)

    def arrange(self, width: int | None = None, wanted: LogFilter | None = None) -> None:
        """Filter and lay out all rows again, for a new width or filter if given."""
        self.width = self.width if width is None else width
        self.filter = self.filter if wanted is None else wanted
        self.shown, self._starts, self._height, self.counts = [], [], 0, Counter()
        self._append(self.rows)

    def _append(self, rows: Sequence[LogRow]) -> None:
        for row in rows:
            self.counts[row.level] += 1
            if self.filter.passes(row):
                self.shown.append(row)
                self._starts.append(self._height)
                self._height += len(self._parts(row))

    def _drop(self, count: int) -> None:
        """Drop the oldest rows; the layout of the others is kept."""
        dropped = self.rows[:count]
        del self.rows[:count]
        self.counts.subtract(row.level for row in dropped)
        hidden = sum(self.filter.passes(row) for row in dropped)
        top = self._starts[hidden] if hidden < len(self._starts) else self._height
        del self.shown[:hidden]
        self._starts = [start - top for start in self._starts[hidden:]]
        self._height -= top

    def line(self, y: int) -> LogLine | None:
        """Return the line at height ``y``; None below the last."""
        if not 0 <= y < self._height:
            return None
        number = bisect_right(self._starts, y) - 1
        part = y - self._starts[number]
        return LogLine(number, self.shown[number], self._texts(self.shown[number])[part], part == 0)

    def extent(self, number: int) -> tuple[int, int]:
        """Return first line and number of lines of a shown row."""
        return self._starts[number], len(self._parts(self.shown[number]))

    def lines(self) -> list[str]:
        """Return the text of all lines."""
        return [text for row in self.shown for text in self._texts(row)]

    def matches(self, text: str) -> list[int]:
        """Return the indices of the shown rows that contain a text, case-insensitive; none for an empty text."""
        return [number for number, row in enumerate(self.shown) if text.lower() in row.text.lower()] if text else []

    def place(self, row: LogRow | None) -> int | None:
        """Return the index of a row among the shown ones; None if it is not shown."""
        return next((number for number, one in enumerate(self.shown) if one is row), None)

    def _texts(self, row: LogRow) -> list[str]:
        """Return the lines of a row: time and mark, then the text, with continuation lines aligned below it."""
        head = f"{row.at:{'%m-%d ' if self.dated else ''}%H:%M:%S} {MARKS[row.level]} "
        return [(head if number == 0 else " " * len(head)) + part for number, part in enumerate(self._parts(row))]

    def _parts(self, row: LogRow) -> tuple[str, ...]:
        return _wrapped(row.text, max(self.width - (_DATED_HEAD if self.dated else _HEAD), _LEAST_WIDTH))


@lru_cache(maxsize=2 * (MOST_LINES + _SPARE_ROWS))
def _wrapped(text: str, width: int) -> tuple[str, ...]:
    """Wrap a text to a width; cached, because a filter lays out all rows again at every key."""
    line = " ".join(text.split())
    return (line,) if len(line) <= width else tuple(textwrap.wrap(line, width))


def as_text(rows: Iterable[LogRow]) -> str:
    """Return rows as text for copying and saving: date, time, level, text."""
    return "".join(f"{row.at:%Y-%m-%d %H:%M:%S} {row.level:<7} {' '.join(row.text.split())}\n" for row in rows)
