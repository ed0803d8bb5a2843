"""A log with its heading: which log it is, counts of each level, filter, search field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.message import Message
from textual.widgets import Input, Static

from cellapp.interfaces.tui.job_record import LEVELS, JobRecord, Level, LogRow
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.widgets.log_view import LogView

THIS_SESSION = "Log of this session"


class LogField(Input):
    """Input field of the log; Enter and, while no job runs, Escape return to the log."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,up,down", "submit", "Back to the log", show=False)]


class LogHeading(Static):
    """Which log is shown, and how many rows each level has; a click on a level shows it."""

    class Chosen(Message):
        """A level is requested."""

        def __init__(self, level: Level) -> None:
            super().__init__()
            self.level = level

    def action_choose(self, level: Level) -> None:
        """Request a level."""
        self.post_message(self.Chosen(level))


class LogPane(Vertical):
    """The log of this session, or one stored in a run."""

    DEFAULT_CSS = """
    LogPane { height: 1fr; }
    LogPane LogHeading { height: 1; text-wrap: nowrap; text-overflow: ellipsis; background: $panel; }
    LogPane LogField { display: none; }
    LogPane.asking LogField { display: block; }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._title = THIS_SESSION
        self._written: int | None = 0
        self._asked: Literal["search", "filter"] = "search"

    def compose(self) -> ComposeResult:
        yield LogHeading()
        yield LogField(id="log-field", compact=True)
        yield LogView(id="log-view")

    def on_mount(self) -> None:
        """Set the tooltips and the heading."""
        heading = self.query_one(LogHeading)
        heading.tooltip = "Which log is shown. Click a level, or D, I, W, E, to show it and the more important ones."
        self.query_one(LogField).tooltip = "The text to search for, or to filter by. Enter goes back to the log."
        self._draw_heading()

    @property
    def view(self) -> LogView:
        """The view of the rows."""
        return self.query_one(LogView)

    @property
    def shows_session(self) -> bool:
        """Whether the log of this session is shown."""
        return self._written is not None

    def show_session(self, record: JobRecord) -> None:
        """Show the log of this session, or add its new lines."""
        if self._written is None:
            self._title, self._written = THIS_SESSION, record.log_written
            self.view.show_rows(list(record.log))
        elif record.log_written != self._written:
            new = record.newest_lines(self._written)
            self._written = record.log_written
            self.view.add_rows(new)

    def show_stored(self, title: str, rows: Sequence[LogRow]) -> None:
        """Show a log stored in a run."""
        self._title, self._written = title, None
        self.view.show_rows(rows, dated=True)

    # -- search and filter ---------------------------------------------------------------------------------------------

    def ask(self, what: Literal["search", "filter"]) -> None:
        """Open the input field for the text to search or to filter by."""
        self._asked = what
        self.add_class("asking")
        field = self.query_one(LogField)
        field.placeholder = (
            f"search: Enter goes to the log, {SHOWN['after']} to the next match" if what == "search" else "filter"
        )
        field.value = self.view.wanted if what == "search" else self.view.rows.filter.text
        field.focus()

    @on(Input.Changed)
    def take_text(self, event: Input.Changed) -> None:
        """Search or filter while typing."""
        event.stop()
        if self._asked == "search":
            if event.value != self.view.wanted:
                self.view.search(event.value)
        elif event.value != self.view.rows.filter.text:
            self.view.set_filter(replace(self.view.rows.filter, text=event.value))

    @on(Input.Submitted)
    def end_text(self, event: Input.Submitted) -> None:
        """Return to the log."""
        event.stop()
        self.leave()

    def leave(self) -> None:
        """Close the field and focus the log."""
        self.remove_class("asking")
        self.view.focus()

    def next_match(self, step: int) -> None:
        """Go to the next or previous row that contains the text."""
        if self.view.wanted:
            self.view.next_match(step)
        else:
            self.notify(f"Nothing is searched for: {SHOWN['search']} begins a search.", severity="warning")

    @on(LogHeading.Chosen)
    def take_level(self, event: LogHeading.Chosen) -> None:
        """Show the level that was clicked."""
        event.stop()
        self.show_from(event.level)

    def show_from(self, level: Level) -> None:
        """Show a level and the more important ones."""
        self.view.set_filter(replace(self.view.rows.filter, least=level))

    # -- heading -------------------------------------------------------------------------------------------------------

    @on(LogView.Changed)
    def draw_changed(self, event: LogView.Changed) -> None:
        """Draw the heading."""
        event.stop()
        self._draw_heading()

    def _draw_heading(self) -> None:
        rows = self.view.rows
        least = LEVELS.index(rows.filter.least)
        levels = [
            Content.from_markup(f"[@click=choose('{level}')]$text[/]", text=f"{level} {rows.counts[level]}").stylize(
                "bold" if number >= least else "strike dim"
            )
            for number, level in enumerate(LEVELS)
        ]
        words = [f"filter '{rows.filter.text}'" if rows.filter.text else "", self.view.match_words()]
        words.append("" if self.view.follows else "End: newest")
        more = "".join(f" · {word}" for word in words if word)
        title = Content.assemble((self._title, "bold"), "  ")
        self.query_one(LogHeading).update(Content.assemble(title, Content(" ").join(levels), more))
