"""The log of this session, or one stored in a run: from a level upwards."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.events import Resize
from textual.widgets import RichLog, Static

from cellapp.interfaces.tui.job_record import LEVELS, MOST_LINES, JobRecord, Level, LogRow
from cellapp.interfaces.tui.keys import bind

THIS_SESSION = "Log of this session"
MARKS: dict[Level, str] = {"info": " ", "warning": "!", "error": "✖"}
"""One character for each level, in addition to its style."""
_STYLES: dict[Level, str] = {"info": "", "warning": "bold", "error": "bold reverse"}
_DRAWN = 1000
"""Most rows that are drawn anew, for another filter or width; older ones are in the run file."""


class LogView(RichLog):
    """Lines of a log; it follows the end until somebody scrolls up, and again once scrolled to the end."""

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        super().watch_scroll_y(old_value, new_value)
        self.auto_scroll = new_value >= self.max_scroll_y


class LogPane(Vertical):
    """A log with a heading; ``shown`` are the rows that pass the filter."""

    BINDINGS: ClassVar[list[BindingType]] = [
        bind("filter", "filter", "Only warnings", "show only warnings and errors; again: all lines")
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.rows: deque[LogRow] = deque(maxlen=MOST_LINES)
        self.least: Level = "info"
        self._title, self._width = THIS_SESSION, 0
        self._written: int | None = 0

    def compose(self) -> ComposeResult:
        yield Static("", markup=False)
        view = LogView(max_lines=MOST_LINES, min_width=0, wrap=True)
        view.tooltip = "The log; End follows the newest line."
        yield view

    def on_mount(self) -> None:
        """Draw the heading."""
        self._draw()

    @property
    def view(self) -> LogView:
        """The lines."""
        return self.query_one(LogView)

    @property
    def shows_session(self) -> bool:
        """Whether the log of this session is shown."""
        return self._written is not None

    @property
    def shown(self) -> list[LogRow]:
        """The rows that pass the filter, oldest first."""
        return [row for row in self.rows if self._passes(row)]

    def show_session(self, record: JobRecord) -> None:
        """Show the log of this session, or add its new lines."""
        if self._written is None:
            self.show(THIS_SESSION, record.log, stored=False)
        elif record.log_written != self._written:
            new = record.newest_lines(self._written)
            self.rows += new
            self._write(row for row in new if self._passes(row))
        self._written = record.log_written

    def show(self, title: str, rows: Iterable[LogRow], *, stored: bool = True) -> None:
        """Show another log, as one stored in a run, scrolled to its end."""
        self._title, self._written = title, None if stored else 0
        self.rows.clear()
        self.rows += rows
        self.view.auto_scroll = True
        self._draw()

    def action_filter(self) -> None:
        """Show only warnings and errors, or all lines again."""
        self.least = "info" if self.least == "warning" else "warning"
        self._draw()

    def on_resize(self, event: Resize) -> None:
        """Wrap to the new width."""
        if event.size.width != self._width:
            self._width = event.size.width
            self.call_after_refresh(self._draw)

    def _passes(self, row: LogRow) -> bool:
        return LEVELS.index(row.level) >= LEVELS.index(self.least)

    def _draw(self) -> None:
        follows = self.view.auto_scroll
        self.view.clear()
        self.view.auto_scroll = follows
        self._write(self.shown[-_DRAWN:])

    def _write(self, rows: Iterable[LogRow]) -> None:
        if not self.view.scrollable_content_region.width:
            self._width = 0  # hidden: lines of no width are none; it draws again when it is shown
        time = "%H:%M:%S" if self.shows_session else "%m-%d %H:%M:%S"
        for row in rows:
            line = f"{row.at:{time}} {MARKS[row.level]} {' '.join(row.text.split())}"
            self.view.write(Text(line, _STYLES[row.level]))
        counts = Counter(row.level for row in self.rows)
        words = [f"{counts[level]} {level}" for level in LEVELS[LEVELS.index(self.least) :]]
        self.query_one(Static).update(f"{self._title}: {', '.join(words)}")
