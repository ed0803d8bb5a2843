"""Base classes of dialogs, with and without a row of answers, and the two simplest: a choice, a text to read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static
from textual.widgets.button import ButtonVariant

from cellapp.interfaces.tui.widgets.controls import StopButton

A = TypeVar("A")


class Question(ModalScreen[A]):
    """A dialog with STOP in the upper right corner.

    F10 closes it without an answer. Escape does so while no job runs; otherwise Escape stops the job.
    """

    VERTICAL_BREAKPOINTS = [(0, "-low"), (30, "-tall")]  # noqa: RUF012 - as Textual declares it
    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,f10", "dismiss(None)", "Close", show=False)]

    @property
    def closing_key(self) -> str:
        """The key that closes the dialog now."""
        return "F10" if self.app.check_action("stop", ()) else "Escape"

    def compose(self) -> ComposeResult:
        yield Container(StopButton(), classes="corner")
        with Vertical(classes="dialog"):
            yield from self.body()

    def body(self) -> ComposeResult:
        """The widgets of the dialog."""
        raise NotImplementedError

    def typed(self, name: str) -> str:
        """Return the text of a field."""
        return self.query_one(f"#{name}", Input).value.strip()


@dataclass(frozen=True)
class ChosenAnswer:
    """One answer of a choice: its return value, the button's label, its key, its style."""

    value: str
    label: str
    key: str
    variant: ButtonVariant = "default"


BEGIN = (ChosenAnswer("begin", "Begin", "b", "success"), ChosenAnswer("no", "Not now", "n"))
WRITE = (ChosenAnswer("write", "Write", "ctrl+s", "success"), ChosenAnswer("no", "Close", "f10"))
USE_STALE = (ChosenAnswer("no", "Not now", "n"), ChosenAnswer("begin", "Use this model all the same", "u", "warning"))
"""Answers if the model is out of date; the first one has the focus."""


class AnswerQuestion(Question[A]):
    """A question with a row of answers below its text. The first answer has the focus, so Enter gives it.

    A subclass yields input widgets in ``fields``, and closes the dialog in ``action_answer``.

    Parameters
    ----------
    title, text : str
        The question, and what a person must know to answer it.
    answers : sequence of ChosenAnswer
    """

    AUTO_FOCUS = ".answers Button"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,up", "app.focus_previous", show=False),
        Binding("right,down", "app.focus_next", show=False),
    ]

    def __init__(self, title: str, text: str, answers: Sequence[ChosenAnswer]) -> None:
        super().__init__()
        self._title, self._text, self._answers = title, text, tuple(answers)

    def body(self) -> ComposeResult:
        yield Static(self._title, classes="title", markup=False)
        yield Static(self._text, classes="text", markup=False)
        yield from self.fields()
        why = Static("", id="why", classes="danger", markup=False)
        why.display = False
        yield why
        with Horizontal(classes="answers"):
            for answer in self._answers:
                label = f"{answer.label} ({answer.key.title() if len(answer.key) > 1 else answer.key})"
                yield Button(label, id=answer.value, variant=answer.variant, compact=True)

    def fields(self) -> ComposeResult:
        """The widgets between text and answers."""
        return iter(())

    def on_mount(self) -> None:
        """Bind each answer to its key; a focused field gets letters itself."""
        for answer in self._answers:
            self._bindings.bind(answer.key, f"answer('{answer.value}')", answer.label)

    def action_answer(self, value: str) -> None:
        """Handle an answer, given by its value."""
        raise NotImplementedError

    def explain(self, sentence: str) -> None:
        """Show above the answers what is wrong with the fields."""
        why = self.query_one("#why", Static)
        why.update(sentence)
        why.display = True

    @on(Button.Pressed)
    def press(self, event: Button.Pressed) -> None:
        """Handle the answer of the button."""
        event.stop()
        self.action_answer(event.button.id or "")

    @on(Input.Submitted)
    def leave_field(self, event: Input.Submitted) -> None:
        """Handle Enter in any field."""
        event.stop()
        self.entered()

    def entered(self) -> None:
        """Move from a field to the answers: nothing begins by it."""
        self.query(Button).first().focus()


class Choice(AnswerQuestion[str]):
    """Dialog for one of a few answers. Returns its value."""

    def action_answer(self, value: str) -> None:
        """Close with an answer."""
        self.dismiss(value)


class Reading(Question[None]):
    """A Markdown text to read and to scroll through."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("q,question_mark,enter", "dismiss(None)", "Close")]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def body(self) -> ComposeResult:
        from rich.markdown import Markdown  # the first screen needs none

        with VerticalScroll(classes="reading"):
            yield Static(Markdown(self._text))  # Textual's own makes a widget of each line, which takes seconds
        yield Static(f"Up, down, Page Up, Page Down scroll; {self.closing_key} closes.", classes="text", markup=False)
