"""Dialog for a base pose from measured points: type them, see the quality of the fit, use the pose."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.message import Message
from textual.timer import Timer
from textual.widgets import Button, Static, TextArea

from cellapp.cell.profile.draft import ProfileDraft
from cellapp.cell.profile.survey_points import points_of_text
from cellapp.ground.errors import InputError
from cellapp.interfaces.tui.dialogs.question import FieldsQuestion

_PAUSE_S = 0.3
"""Pause after the last key before the points are fitted."""
_HOW = (
    "One point a line: x, y, z in the base frame, or the joint positions with the SMR there; a semicolon; x, y, z from"
    " the tracker. Three points or more, four are better, not on one line. Units as in the form."
)


class Fitted(Message):
    """The points were fitted: the draft with the base, or why there is none."""

    def __init__(self, text: str, draft: ProfileDraft | None, words: str) -> None:
        super().__init__()
        self.text, self.draft, self.words = text, draft, words


class PointsDialog(FieldsQuestion[ProfileDraft]):
    """Fit the base of one arm of a draft. Returns the draft with that base; None if the dialog is closed.

    Parameters
    ----------
    draft : ProfileDraft
    index : int
        Index of the arm.
    path : Path
        File of the profile, existing or not: types of arms are relative to it.
    """

    DEFAULT_CSS = "PointsDialog TextArea { height: 6; background: $panel; }"
    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+s", "send", "Use this pose")]

    def __init__(self, draft: ProfileDraft, index: int, path: Path) -> None:
        super().__init__()
        self._draft, self._index, self._path = draft, index, path
        self._fitted: ProfileDraft | None = None
        self._timer: Timer | None = None

    def body(self) -> ComposeResult:
        yield Static(f"Base of arm {self._draft.arms[self._index].name} from points", classes="title", markup=False)
        yield Static(_HOW, classes="text muted", markup=False)
        yield TextArea(id="points", compact=True)
        yield Static("No points yet.", id="fit", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Use this pose (Ctrl+S)", id="use", variant="success", compact=True, disabled=True)
            yield Button(f"Close ({self.closing_key[:3]})", id="close", compact=True)

    def on_mount(self) -> None:
        """Focus the points."""
        self.query_one("#points", TextArea).focus()

    @on(TextArea.Changed)
    def fit_soon(self) -> None:
        """Fit after a pause in typing."""
        self._show(None, "...")
        if self._timer is not None:
            self._timer.stop()
        self._timer = self.set_timer(_PAUSE_S, self._fit)

    def _fit(self) -> None:
        self._fit_text(self.query_one("#points", TextArea).text)

    @work(thread=True, exclusive=True)
    def _fit_text(self, text: str) -> None:
        from cellapp.commands.doctor.survey import draft_with_surveyed_base

        try:
            draft, found = draft_with_surveyed_base(self._draft, self._index, points_of_text(text), self._path)
        except InputError as error:
            self.post_message(Fitted(text, None, str(error)))
        else:
            self.post_message(Fitted(text, draft, found.fit.sentence))

    @on(Fitted)
    def show_fit(self, event: Fitted) -> None:
        """Draw the quality of the fit, if it belongs to the current points."""
        if event.text == self.query_one("#points", TextArea).text:
            self._show(event.draft, event.words)

    def _show(self, draft: ProfileDraft | None, words: str) -> None:
        self._fitted = draft
        self.query_one("#fit", Static).update(words)
        self.query_one("#use", Button).disabled = draft is None

    def action_send(self) -> None:
        """Close with the pose for the form."""
        if self._fitted is not None:
            self.dismiss(self._fitted)
