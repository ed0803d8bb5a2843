"""Dialog for the format and the file of an export of calibrated arms or commands for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from textual import on
from textual.app import ComposeResult
from textual.widget import Widget
from textual.widgets import Input, OptionList
from textual.widgets.option_list import Option

from cellapp.cell.exports.formats import all_formats
from cellapp.commands.export.request import STAGES, VERB
from cellapp.interfaces.tui.dialogs.question import Answer
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion


class ExportArms(VerbQuestion):
    """The dialog of ``export`` with a list of the formats, which proposes a file for each.

    Parameters
    ----------
    folder : Path
        Folder of the run, where files are proposed.
    arms : sequence of str
    answers : sequence of Answer
    """

    DEFAULT_CSS = """
    ExportArms #formats { height: auto; }
    """

    def __init__(self, folder: Path, arms: Sequence[str], answers: Sequence[Answer]) -> None:
        choices = {"arm": arms, "stage": STAGES}
        super().__init__(VERB, "Several arms get a file each.", answers, {"folder": folder}, choices=choices)
        self._folder, self._file = folder, ""

    def fields(self) -> ComposeResult:
        options = [Option(f"{entry.name:15} {entry.what}", id=entry.name) for entry in all_formats().values()]
        yield OptionList(*options, id="formats", markup=False, compact=True)
        yield from super().fields()

    def first_field(self) -> Widget:
        """Return the list of formats."""
        formats = self.query_one("#formats", OptionList)
        formats.highlighted = 0
        return formats

    @on(OptionList.OptionHighlighted)
    def propose(self, event: OptionList.OptionHighlighted) -> None:
        """Select the format, and propose a file for it unless a person typed one."""
        event.stop()
        entry = all_formats()[str(event.option.id)]
        self._given["form"] = entry.name
        field = self.query_one("#out", Input)
        if field.value == self._file:
            field.value = self._file = str(self._folder / f"{entry.name}{entry.suffix}")

    @on(OptionList.OptionSelected)
    def go_on(self, event: OptionList.OptionSelected) -> None:
        """Focus the file field."""
        event.stop()
        field = self.query_one("#out", Input)
        field.focus()
        field.cursor_position = len(field.value)

    def action_answer(self, value: str) -> None:
        """Take an answer; without a file, focus its field instead."""
        if value != "no" and not self.typed("out"):
            self.query_one("#out").focus()
        else:
            super().action_answer(value)
