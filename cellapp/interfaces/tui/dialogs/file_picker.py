"""Dialog for a path, which Tab or the right arrow completes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from glob import escape, glob
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.suggester import Suggester
from textual.widgets import Input

from cellapp.interfaces.tui.dialogs.question import AnswerQuestion, ChosenAnswer

_MOST_NAMED = 5


class PathSuggester(Suggester):
    """Completion of a path with existing files with one of some suffixes; folders get a slash."""

    def __init__(self, suffixes: Sequence[str]) -> None:
        super().__init__(use_cache=False, case_sensitive=True)
        self._suffixes = suffixes

    async def get_suggestion(self, value: str) -> str | None:
        """Return the first completion; None if there is none."""
        found = completions(value, self._suffixes)
        return found[0] if found and found[0] != value else None


def completions(text: str, suffixes: Sequence[str]) -> list[str]:
    """Return the paths that begin with ``text``, sorted, folders with a slash; hidden ones only if asked for.

    Files have one of the ``suffixes``, if there are any.
    """
    found = sorted(glob(f"{escape(os.path.expanduser(text))}*"))
    paths = (path + os.sep if os.path.isdir(path) else path for path in found)
    return [path for path in paths if path.endswith(os.sep) or not suffixes or Path(path).suffix in suffixes]


class PathField(Input):
    """A field for a path with completion.

    Parameters
    ----------
    text : str
        Initial path.
    suffixes : sequence of str
        Those of the files that may be chosen; any if empty.
    hint : str
        Text that is shown while it is empty.
    """

    def __init__(self, text: str, suffixes: Sequence[str], *, id: str = "path", hint: str = "") -> None:
        super().__init__(text, placeholder=hint, suggester=PathSuggester(suffixes), id=id, compact=True)


class FilePicker(AnswerQuestion[Path]):
    """Dialog for a file that is there, whose path Tab completes. Returns it; None if the dialog is closed.

    Parameters
    ----------
    title : str
        What the file is for.
    start : Path
        The folder or file at which to begin.
    suffixes : sequence of str
        Those of the files that are completed.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("tab", "complete", "Complete", priority=True)]

    def __init__(self, title: str, start: Path, suffixes: Sequence[str]) -> None:
        answers = ChosenAnswer("open", "Open", "ctrl+s", "success"), ChosenAnswer("no", "Close", "f10")
        super().__init__(title, "Tab completes, Enter opens.", answers)
        folder = start.is_dir() and str(start) != os.sep
        self._start, self._suffixes = str(start) + (os.sep if folder else ""), suffixes

    def fields(self) -> ComposeResult:
        yield PathField(self._start, self._suffixes)

    def on_mount(self) -> None:
        """Focus the field."""
        super().on_mount()
        self.call_after_refresh(self.query_one(PathField).focus)

    def action_complete(self) -> None:
        """Complete to the longest common prefix of all candidates; a single candidate completely."""
        field = self.query_one(PathField)
        if found := completions(field.value, self._suffixes):
            field.value = os.path.commonprefix(found)  # noqa: RUF071 - letter by letter is meant
            field.cursor_position = len(field.value)
        field.focus()

    def entered(self) -> None:
        """Open the file."""
        self.action_answer("open")

    def action_answer(self, value: str) -> None:
        """Close with the file, if there is one."""
        path = Path(self.typed("path")).expanduser()
        if value == "no" or path.is_file():
            self.dismiss(None if value == "no" else path)
            return
        found = ", ".join(map(os.path.basename, completions(self.typed("path"), self._suffixes)[:_MOST_NAMED]))
        self.explain(f"{path}: no such file." + (f" There are: {found}." if found else ""))
