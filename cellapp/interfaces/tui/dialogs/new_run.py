"""Dialog for the folder of a new run."""

from __future__ import annotations

from pathlib import Path

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.interfaces.tui.dialogs.question import FieldsQuestion


class NewRunQuestion(FieldsQuestion[Path]):
    """Dialog for the folder of a new run. Returns it; None if the dialog is closed.

    Parameters
    ----------
    text : str
        What will be planned.
    folder : Path
        The proposed folder.
    """

    def __init__(self, text: str, folder: Path) -> None:
        super().__init__()
        self._text, self._folder = text, folder

    def body(self) -> ComposeResult:
        yield Static("A new run with a plan", classes="title", markup=False)
        yield Static(self._text, classes="text", markup=False)
        field = Input(str(self._folder), id="folder", compact=True)
        field.tooltip = "Folder of the new run; it must not exist, or be empty"
        yield field
        yield Static(
            f"Folder of the new run. Enter plans, {self.closing_key} closes.", id="why", classes="text", markup=False
        )
        with Horizontal(classes="answers"):
            yield Button("Plan", id="plan", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Focus the field."""
        field = self.query_one("#folder", Input)
        field.focus()
        field.cursor_position = len(field.value)

    def action_send(self) -> None:
        """Close with the folder, if a new run can use it."""
        text = self.typed("folder")
        folder = Path(text).expanduser()
        why = _why_not(text, folder)
        if why:
            self.explain(why)
        else:
            self.dismiss(folder)


def _why_not(text: str, folder: Path) -> str:
    """Return why a new run cannot use a folder, in a sentence; empty if it can."""
    if not text:
        return "Type the name of a folder, for instance logs/monday."
    try:
        if folder.is_dir() and any(folder.iterdir()):
            return f"{folder} exists and is not empty: type another name, or open that run on the screen Runs (8)."
        if folder.exists() and not folder.is_dir():
            return f"{folder} is a file: type the name of a folder."
    except OSError as error:
        return f"{folder} cannot be read ({error.strerror}): type another name."
    return ""
