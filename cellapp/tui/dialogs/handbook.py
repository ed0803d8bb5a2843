"""The handbook: a list of topics and the text of one."""

from __future__ import annotations

from typing import ClassVar

from rich.markdown import Markdown
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.widgets import OptionList, Static

from cellapp.tui.dialogs.question import Question


class Handbook(Question[None]):
    """Choose a topic on the left, read it on the right.

    Parameters
    ----------
    topic : str
        The topic to begin with; the first one where it is empty or unknown.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("q,h", "dismiss(None)", "Close")]
    DEFAULT_CSS = """
    Handbook #topics { width: 26; height: 1fr; }
    Handbook VerticalScroll { width: 1fr; height: 1fr; }
    Handbook Horizontal { height: 1fr; }
    """

    def __init__(self, topic: str = "") -> None:
        super().__init__()
        self._topic = topic

    def body(self) -> ComposeResult:
        with Horizontal():
            yield OptionList(id="topics", markup=False, compact=True)
            with VerticalScroll():
                yield Static("", id="topic")
        yield Static("Up and down choose a topic, Tab goes to its text, q closes.", markup=False)

    def on_mount(self) -> None:
        """List the topics."""
        from cellapp.docs.handbook import topics

        names = topics()
        listed = self.query_one("#topics", OptionList)
        listed.add_options(names)
        listed.highlighted = names.index(self._topic) if self._topic in names else 0
        listed.focus()

    @on(OptionList.OptionHighlighted)
    def read(self, event: OptionList.OptionHighlighted) -> None:
        """Show the text of a topic."""
        from cellapp.docs.handbook import topic_text

        event.stop()
        self.query_one("#topic", Static).update(Markdown(topic_text(str(event.option.prompt))))
        self.query_one(VerticalScroll).scroll_home(animate=False)
