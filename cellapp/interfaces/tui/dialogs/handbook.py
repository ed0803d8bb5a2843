"""The handbook: its chapters, or the sections with some words, and the text of the chosen one."""

from __future__ import annotations

from typing import ClassVar

from rich.markdown import Markdown
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from cellapp.commands.docs.keys import KEYS
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.keys import bind

_SHORTEST_SEARCH = 3
"""Letters from which a search begins: fewer match everywhere."""


class Handbook(Question[None]):
    """Chapters on the left, the text on the right."""

    AUTO_FOCUS = "#contents"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(f"q,{KEYS['handbook'].keys}", "dismiss(None)", "Close"),
        bind("search", "search", "Search"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._texts: list[str] = []
        """Text of each entry of the contents; empty for a part of the handbook."""

    def body(self) -> ComposeResult:
        with Horizontal():
            with Vertical(classes="places"):
                yield Input(placeholder="Search (/)", compact=True, id="words")
                yield OptionList(id="contents", markup=False, compact=True)
            with VerticalScroll(id="chapter"):
                yield Static("")
        yield Static(f"Up and down choose, / searches, Tab goes on, {self.closing_key} closes.", markup=False)

    def on_mount(self) -> None:
        """List the chapters."""
        self._fill("")

    @on(Input.Changed, "#words")
    def _search(self, event: Input.Changed) -> None:
        event.stop()
        self._fill(event.value.strip())

    def _fill(self, words: str) -> None:
        """List the sections with these words; all chapters if there are few letters, or none is found."""
        from cellapp.commands.docs.handbook import PARTS, search, sections

        listed: list[tuple[str, str]] = []
        for one in search(words) if len(words) >= _SHORTEST_SEARCH else ():
            listed.append((f"{one.chapter}: {one.heading}", one.terminal_text))
        if not listed:
            for part, chapters in PARTS.items():
                listed.append((part, ""))
                for chapter in chapters:
                    listed.append((f"  {chapter}", "\n".join(one.terminal_text for one in sections(chapter))))
        self._texts = [text for _, text in listed]
        contents = self.query_one("#contents", OptionList)
        contents.clear_options()
        contents.add_options(Option(title, disabled=not text) for title, text in listed)
        contents.highlighted = next(place for place, text in enumerate(self._texts) if text)

    @on(Input.Submitted, "#words")
    def go_to_found(self, event: Input.Submitted) -> None:
        """Focus the list."""
        event.stop()
        self.query_one("#contents").focus()

    def action_search(self) -> None:
        """Focus the search field."""
        self.query_one("#words").focus()

    @on(OptionList.OptionHighlighted)
    def read(self, event: OptionList.OptionHighlighted) -> None:
        """Show the text under the cursor."""
        event.stop()
        chapter = self.query_one("#chapter", VerticalScroll)
        chapter.query_one(Static).update(Markdown(self._texts[event.option_index]))
        chapter.scroll_home(animate=False)
