"""Dialog that saves a text in a file. An existing file is only replaced after a second confirmation."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Button, Static

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.question import FieldsQuestion


class SaveAs(FieldsQuestion[Path]):
    """Save a text in a chosen file. Returns the path; None if the dialog is closed.

    Parameters
    ----------
    what : str
        What is saved, in a word or two.
    text : str or None
        None: the caller writes the file.
    proposed : Path
        Initial path.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("tab", "complete", "Complete", priority=True)]

    def __init__(self, what: str, text: str | None, proposed: Path) -> None:
        super().__init__()
        self._what, self._text, self._proposed = what, text, proposed
        self._replace: Path | None = None

    def body(self) -> ComposeResult:
        yield Static(f"Save {self._what} as", classes="title", markup=False)
        yield PathField(str(self._proposed), _anything)
        yield Static(f"Tab completes, Enter saves, {self.closing_key} closes.", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Save", id="save", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Focus the field."""
        self.query_one("#path").focus()

    def action_complete(self) -> None:
        """Complete to the longest common prefix of all candidates."""
        self.query_one(PathField).complete()

    def action_send(self) -> None:
        """Save to the typed path; replace an existing file at the second attempt."""
        path = Path(self.typed("path")).expanduser()
        try:
            RENEWED.check(path)
            if path.exists() and path != self._replace:
                self._replace = path
                self.explain(f"{path} exists. Enter again replaces it; or type another name.")
                return
            if self._text is not None:
                RENEWED.write_text(path, self._text)
        except InputError as error:
            self.explain(str(error))
            return
        self.dismiss(path)


def _anything(path: Path) -> bool:
    return True
