"""What can be copied and saved as text: tables, stops, lines of a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from textual.widget import Widget

from cellapp.interfaces.tui.dialogs.file_picker import SaveAs


@dataclass(frozen=True)
class Copy:
    """A text, what it is in words as "3 tables", and the file that is proposed for it."""

    what: str
    text: str
    proposed: Path


class Copied(Widget):
    """A widget with a text to copy to the clipboard and to save in a file. Not the first base, whose styles it has."""

    def as_copy(self) -> Copy:
        """Return what is shown now."""
        raise NotImplementedError

    def action_copy(self) -> None:
        """Copy it to the clipboard."""
        one = self.as_copy()
        self.app.copy_to_clipboard(one.text)
        self.notify(f"{one.what} copied")

    def action_save(self) -> None:
        """Save it in a file."""
        one = self.as_copy()

        def say(path: Path | None) -> None:
            if path is not None:
                self.notify(f"{one.what} saved as {path}")

        self.app.push_screen(SaveAs(one.what, one.text, one.proposed), say)
