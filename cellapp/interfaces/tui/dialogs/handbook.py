"""The handbook: its contents, a search, the text of a chapter, and the targets of its links."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import Markdown
from rich.segment import Segment
from rich.style import Style
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Input, OptionList, Static, Tree
from textual.widgets.option_list import Option
from textual.widgets.tree import TreeNode

from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.keys import KEYS, SHOWN, bind

if TYPE_CHECKING:
    from cellapp.commands.docs.handbook import Section

_SHORTEST_SEARCH = 3
"""Letters from which a search begins: fewer match everywhere."""
_KEYS = f"Enter opens a chapter or follows a link, / searches, Tab goes on, {SHOWN['before']} goes back, {{}} closes."
_LEVELS_LISTED = 3
"""Headings down to this level are listed in the contents."""


class ClickableMarkdown(Markdown):
    """Markdown whose links call the screen's action ``follow`` instead of the terminal's."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for one in super().__rich_console__(console, options):
            if isinstance(one, Segment) and one.style is not None and one.style.link is not None:
                follow = Style(meta={"@click": f"screen.follow({one.style.link!r})"})
                yield Segment(one.text, one.style.update_link(None) + follow, one.control)
            else:
                yield one


class SectionText(Static):
    """One section of a chapter."""

    def __init__(self, section: Section) -> None:
        super().__init__(ClickableMarkdown(section.terminal_text))
        self.section = section


class Handbook(Question[None]):
    """Contents and links on the left, a chapter on the right.

    Parameters
    ----------
    address : str
        Where to begin, as in a link; the first chapter if it is empty or leads nowhere.
    """

    AUTO_FOCUS = "#contents"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(f"q,{KEYS['handbook'].keys}", "dismiss(None)", "Close"),
        bind("search", "search", "Search"),
        Binding(f"{KEYS['before'].keys},backspace", "back", "Back"),
    ]
    DEFAULT_CSS = """
    Handbook Horizontal { height: 1fr; }
    Handbook .places { width: 30; height: 1fr; }
    Handbook #contents { height: 2fr; }
    Handbook #links { height: 1fr; border-top: solid $primary; }
    Handbook VerticalScroll { width: 1fr; height: 1fr; padding-left: 1; }
    Handbook SectionText { margin-bottom: 1; }
    """

    def __init__(self, address: str = "") -> None:
        super().__init__()
        self._address = address
        self._shown: Section | None = None
        self._before: list[Section] = []

    def body(self) -> ComposeResult:
        with Horizontal():
            with Vertical(classes="places"):
                yield Input(placeholder="Search (/)", compact=True, id="words")
                tree: Tree[Section] = Tree("handbook", id="contents")
                tree.show_root = False
                yield tree
                yield OptionList(id="links", markup=False, compact=True)
            yield VerticalScroll(id="chapter")
        yield Static(_KEYS.format(self.closing_key), id="hint", markup=False)

    async def on_mount(self) -> None:
        """List the chapters and open the first section."""
        from cellapp.commands.docs.handbook import CHAPTERS, section_at, sections

        self._fill(())
        first = next(iter(CHAPTERS))
        await self._go(section_at(self._address, first) or sections(first)[0])

    # -- contents and search -----------------------------------------------------------------------------------------

    def _fill(self, found: tuple[Section, ...]) -> None:
        """List parts with their chapters and headings; or the search results."""
        from cellapp.commands.docs.handbook import PARTS, sections

        contents = self._contents
        contents.clear()
        for one in found:
            contents.root.add_leaf(one.heading if one.level == 1 else f"{one.chapter}: {one.heading}", one)
        for part, chapters in () if found else PARTS.items():
            its_part = contents.root.add(part, expand=True)
            for chapter in chapters:
                its = sections(chapter)
                node = its_part.add(chapter, its[0])
                for one in its[1:]:
                    if one.level <= _LEVELS_LISTED:
                        node.add_leaf(one.heading, one)
        contents.root.expand()

    @on(Input.Changed, "#words")
    def search_words(self, event: Input.Changed) -> None:
        """List the sections with these words; all chapters if there are few letters."""
        from cellapp.commands.docs.handbook import search

        event.stop()
        words = event.value.strip()
        self._fill(tuple(hit.section for hit in search(words)) if len(words) >= _SHORTEST_SEARCH else ())

    @on(Input.Submitted, "#words")
    def go_to_found(self, event: Input.Submitted) -> None:
        """Focus the list of search results."""
        event.stop()
        self._contents.focus()
        self._contents.cursor_line = 0

    def action_search(self) -> None:
        """Focus the search field."""
        self.query_one("#words", Input).focus()

    @on(Tree.NodeHighlighted, "#contents")
    async def read(self, event: Tree.NodeHighlighted[Section]) -> None:
        """Show the section under the cursor, if a person put the cursor there."""
        event.stop()
        if self._contents.has_focus and event.node.data is not None:
            await self._show(event.node.data)

    # -- the text and its links --------------------------------------------------------------------------------------

    async def _show(self, section: Section) -> None:
        from cellapp.commands.docs.handbook import sections

        chapter, before = self.query_one("#chapter", VerticalScroll), self._shown
        self._shown = section
        if before is None or before.chapter != section.chapter:
            await chapter.remove_children()
            await chapter.mount_all(SectionText(one) for one in sections(section.chapter))
        links = self.query_one("#links", OptionList)
        links.clear_options()
        links.add_options(Option(words, place) for words, place in section.links)
        if links.has_focus and not section.links:
            self._contents.focus()  # before the list is hidden, which would move the focus to any other widget
        links.display = bool(section.links)
        links.highlighted = 0 if section.links else None
        self.call_after_refresh(self._scroll)

    def _scroll(self) -> None:
        chapter = self.query_one("#chapter", VerticalScroll)
        for text in chapter.query(SectionText):
            if text.section == self._shown:
                chapter.scroll_to_widget(text, animate=False, top=True)

    @on(OptionList.OptionSelected, "#links")
    async def follow_chosen(self, event: OptionList.OptionSelected) -> None:
        """Follow a link of the list."""
        event.stop()
        await self.action_follow(str(event.option.id))

    async def action_follow(self, address: str) -> None:
        """Follow a link of the current chapter; an external page is only named."""
        from cellapp.commands.docs.handbook import section_at

        if self._shown is None:
            return
        place = section_at(address, self._shown.chapter)
        if place is None:
            self.query_one("#hint", Static).update(f"{address} is not a part of the handbook.")
            return
        self._before.append(self._shown)
        await self._go(place)

    async def action_back(self) -> None:
        """Return to where the last link was followed."""
        if self._before:
            await self._go(self._before.pop())

    async def _go(self, place: Section) -> None:
        await self._show(place)
        tops = self._contents.root.children  # parts, or search results
        for node in (one for top in tops for one in (top, *top.children)):
            if (at := _node_of(node, place)) is not None:
                node.expand()
                self.call_after_refresh(self._contents.move_cursor, at)  # the tree has the new lines then

    @property
    def _contents(self) -> Tree[Section]:
        return self.query_one("#contents", Tree)


def _node_of(node: TreeNode[Section], place: Section) -> TreeNode[Section] | None:
    """Return the node of a section at or below a chapter's node; None if there is none."""
    return next((one for one in (node, *node.children) if one.data == place), None)
