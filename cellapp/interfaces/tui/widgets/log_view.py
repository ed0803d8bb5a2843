"""A log with levels: filter, search, follow the end, copy. Lines are drawn when they come into view."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.binding import Binding, BindingType
from textual.events import Click, Resize
from textual.geometry import Region, Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.selection import Selection
from textual.strip import Strip

from cellapp.ground.counting import counted
from cellapp.interfaces.tui.job_record import LEVELS, LogRow
from cellapp.interfaces.tui.widgets.log_view_rows import LogFilter, LogLine, LogRows, as_text

_STYLES = (*LEVELS, "marked", "match")


class LogView(ScrollView, can_focus=True):
    """The rows of a log, wrapped to the width.

    It follows the end until somebody scrolls up, and again once scrolled to the end. A cursor, moved by keys and
    clicks, marks rows to copy; text selected with the mouse can also be copied.
    """

    ALLOW_SELECT = True
    COMPONENT_CLASSES: ClassVar[set[str]] = {f"log--{name}" for name in _STYLES}
    DEFAULT_CSS = """
    LogView { height: 1fr; background: $surface; scrollbar-size-horizontal: 0; overflow-x: hidden; }
    LogView:focus { background-tint: $foreground 4%; }
    LogView > .log--debug { color: $foreground; text-style: dim; }
    LogView > .log--info { color: $foreground; }
    LogView > .log--warning { color: $text-warning; }
    LogView > .log--error { color: $text-error; text-style: bold; }
    LogView > .log--marked { background: $primary-muted; }
    LogView > .log--match { text-style: bold underline; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", "Up", show=False),
        Binding("down", "move(1)", "Down", show=False),
        Binding("shift+up", "move(-1, True)", "Mark up", show=False),
        Binding("shift+down", "move(1, True)", "Mark down", show=False),
        Binding("home", "first", "First", show=False),
        Binding("end", "last", "Last", show=False),
        Binding("y", "copy", "Copy lines", show=False),
    ]

    class Changed(Message):
        """The display has changed: rows, filter, search, or whether the end is followed."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.rows = LogRows()
        self.follows = True
        """Whether new rows scroll the view."""
        self.wanted = ""
        """The search text."""
        self._cursor: LogRow | None = None
        self._anchor: LogRow | None = None
        self._marked = range(0)
        self._styles: dict[str, Style] = {}
        self.tooltip = (
            "The log. Up and down choose a line, with Shift more lines, y copies them; End follows the newest line."
        )

    # -- rows ----------------------------------------------------------------------------------------------------------

    def show_rows(self, rows: Sequence[LogRow], *, dated: bool = False) -> None:
        """Show another log, scrolled to its end."""
        self._cursor = self._anchor = None
        self.follows = True
        self.rows.replace(rows, dated=dated)
        self._arranged()

    def add_rows(self, rows: Iterable[LogRow]) -> None:
        """Add newer rows."""
        shown = len(self.rows.shown)
        self.rows.add(rows)
        if len(self.rows.shown) != shown:
            self._arranged()
        self.post_message(self.Changed())

    def set_filter(self, wanted: LogFilter) -> None:
        """Show only rows that pass a filter."""
        self.rows.arrange(wanted=wanted)
        self._arranged()

    def search(self, text: str) -> int:
        """Highlight a text and go to its last occurrence; return the number of rows that contain it."""
        self.wanted = text
        found = self.rows.matches(text)
        if found:
            self._go_to(found[-1])
        self.refresh()
        self.post_message(self.Changed())
        return len(found)

    def next_match(self, step: int) -> None:
        """Go to the next row (``step`` 1) or the previous one (-1) that contains the text; wrap around at the ends."""
        found = self.rows.matches(self.wanted)
        if not found:
            return
        place = self.rows.place(self._cursor)
        if place is None:
            self._go_to(found[0 if step > 0 else -1])
        elif step > 0:
            self._go_to(next((number for number in found if number > place), found[0]))
        else:
            self._go_to(next((number for number in reversed(found) if number < place), found[-1]))

    def match_words(self) -> str:
        """Which match is marked: ``match 3 of 17``; empty without a search."""
        if not self.wanted:
            return ""
        found, place = self.rows.matches(self.wanted), self.rows.place(self._cursor)
        if not found:
            return "no match"
        return f"match {found.index(place) + 1} of {len(found)}" if place in found else f"{len(found)} matches"

    def chosen(self) -> list[LogRow]:
        """Return the marked rows, or else all shown rows."""
        return [self.rows.shown[number] for number in self._marked] or list(self.rows.shown)

    def _arranged(self) -> None:
        """Update size, marks and scrolling for the lines."""
        self.virtual_size = Size(self.rows.width, self.rows.height)
        self._mark()
        if self.follows:
            self.scroll_end(animate=False, immediate=True, force=True)
        self.refresh()
        self.post_message(self.Changed())

    # -- cursor --------------------------------------------------------------------------------------------------------

    def action_move(self, step: int, marks: bool = False) -> None:
        """Move the cursor; with ``marks`` the rows in between stay marked."""
        count = len(self.rows.shown)
        if not count:
            return
        place = self.rows.place(self._cursor)
        first = self._row_at(self.scroll_offset.y + (self.size.height - 1 if step < 0 else 0))
        self._go_to(first if place is None else min(max(place + step, 0), count - 1), marks=marks)

    def action_first(self) -> None:
        """Go to the oldest row."""
        if self.rows.shown:
            self._go_to(0)

    def action_last(self) -> None:
        """Go to the newest row and follow."""
        self._cursor = self._anchor = None
        self.follows = True
        self._arranged()

    def on_click(self, event: Click) -> None:
        """Put the cursor on a row."""
        offset = event.get_content_offset(self)
        if offset is not None and not self.screen.get_selected_text():
            line = self.rows.line(offset.y + self.scroll_offset.y)
            if line is not None:
                self._go_to(line.number, marks=event.shift)

    def action_copy(self) -> None:
        """Copy the text that is selected with the mouse, else the marked rows."""
        selected = self.screen.get_selected_text()
        rows = [self.rows.shown[number] for number in self._marked]
        if selected:
            self.app.copy_to_clipboard(selected)
            self.notify("The selected text is copied.")
        elif rows:
            self.app.copy_to_clipboard(as_text(rows))
            self.notify(f"{counted(len(rows), 'line')} copied.")
        else:
            self.notify("No line is chosen: up and down choose one.", severity="warning")

    def _row_at(self, y: int) -> int:
        line = self.rows.line(min(y, self.rows.height - 1))
        return 0 if line is None else line.number

    def _go_to(self, number: int, *, marks: bool = False) -> None:
        self._cursor = self.rows.shown[number]
        self._anchor = self._anchor if marks and self._anchor is not None else self._cursor
        self.follows = False
        self._mark()
        y, height = self.rows.extent(number)
        self.scroll_to_region(Region(0, y, 1, height), animate=False, immediate=True, force=True)
        self.refresh()
        self.post_message(self.Changed())

    def _mark(self) -> None:
        """Update the indices of the marked rows."""
        cursor = self.rows.place(self._cursor) if self._cursor is not None else None
        anchor = self.rows.place(self._anchor) if self._anchor is not None else None
        if cursor is None:
            self._marked = range(0)
        else:
            ends = sorted((cursor, cursor if anchor is None else anchor))
            self._marked = range(ends[0], ends[1] + 1)

    # -- drawing -------------------------------------------------------------------------------------------------------

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Follow the end when scrolled to it; stop when scrolled away."""
        super().watch_scroll_y(old_value, new_value)
        if self.size.height and self._cursor is None:
            follows = new_value >= self.max_scroll_y
            if follows != self.follows:
                self.follows = follows
                self.post_message(self.Changed())

    def on_resize(self, event: Resize) -> None:
        """Wrap to the new width."""
        width = self.scrollable_content_region.width
        if width and width != self.rows.width:
            self.rows.arrange(width)
        self._arranged()

    def render_lines(self, crop: Region) -> list[Strip]:
        """Return lines of the view; query their styles only once, which takes as long as drawing a line."""
        own = self.rich_style
        self._styles = {name: self.get_component_rich_style(f"log--{name}", partial=True) for name in _STYLES}
        self._styles.update({level: own + self._styles[level] for level in LEVELS}, own=own)
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        """Return one line of the view."""
        place, width = y + self.scroll_offset.y, self.size.width
        line = self.rows.line(place)
        if line is None:
            return Strip.blank(width, self._styles["own"])
        style = self._styles[line.row.level]
        if line.number in self._marked:
            style += self._styles["marked"]
        segments = self._with_match(line, style)
        strip = Strip(self._with_selection(segments, place)).adjust_cell_length(width, style)
        return strip.apply_offsets(0, place)

    def _with_match(self, line: LogLine, style: Style) -> list[Segment]:
        """Return the text of a line with the search text highlighted."""
        start = line.text.lower().find(self.wanted.lower()) if self.wanted else -1
        if start < 0:
            return [Segment(line.text, style)]
        end = start + len(self.wanted)
        found = style + self._styles["match"]
        parts = ((line.text[:start], style), (line.text[start:end], found), (line.text[end:], style))
        return [Segment(text, look) for text, look in parts if text]

    def _with_selection(self, segments: list[Segment], y: int) -> list[Segment]:
        """Highlight the text selected with the mouse."""
        selection = self.text_selection
        span = None if selection is None else selection.get_span(y)
        if span is None:
            return segments
        strip = Strip(segments)
        start, end = span[0], strip.cell_length if span[1] == -1 else span[1]
        chosen = self.screen.get_component_rich_style("screen--selection")
        before, middle, after = strip.crop(0, start), strip.crop(start, end), strip.crop(end)
        return [*before, *(Segment(one.text, (one.style or Style()) + chosen) for one in middle), *after]

    def get_selection(self, selection: Selection) -> tuple[str, str] | None:
        """Return the text selected with the mouse."""
        return selection.extract("\n".join(self.rows.lines())), "\n"

    def selection_updated(self, selection: Selection | None) -> None:
        """Draw the selection."""
        self.refresh()
