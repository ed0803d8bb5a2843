"""The screen Cell: which profile, what is reachable, what would be refused."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import DataTable, OptionList

from cellapp.results import DoctorResult, Result
from cellapp.tui import work
from cellapp.tui.dialogs.file_picker import FilePicker
from cellapp.tui.screens.base import DayScreen
from cellapp.tui.workspace import Step, Workspace


class CellScreen(DayScreen):
    """Choose a profile, see its devices, ask the doctor."""

    STEP: ClassVar[Step] = "cell"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("d", "doctor", "Doctor", tooltip="check devices and placement; nothing moves"),
        Binding("o", "open", "Open profile"),
    ]

    def body(self) -> ComposeResult:
        with Horizontal():
            yield OptionList(id="profiles", markup=False, compact=True)
            yield DataTable[str](id="findings", cursor_type="row")

    def on_mount(self) -> None:
        """List the profiles; the first one is opened."""
        self._found: list[Path] = sorted(self.cell_app.profiles.glob("*.yaml"), key=lambda path: path.stem)
        profiles = self.query_one("#profiles", OptionList)
        profiles.add_options([path.stem for path in self._found])
        self.query_one("#findings", DataTable).add_columns("status", "what", "found")
        if self._found:
            profiles.highlighted = 0
        profiles.focus()

    @on(OptionList.OptionHighlighted, "#profiles")
    def choose(self, event: OptionList.OptionHighlighted) -> None:
        """Open the selected profile."""
        self.cell_app.open_profile(self._found[event.option_index])

    def action_open(self) -> None:
        """Ask for the path of a profile."""
        picker = FilePicker("Which profile?", self.cell_app.profiles, lambda path: path.suffix == ".yaml")
        self.app.push_screen(picker, lambda path: None if path is None else self.cell_app.open_profile(path))

    def action_doctor(self) -> None:
        """Check the cell."""
        if self.workspace.profile_path is None:
            self.say("No profile is open: choose one in the list.", "warning")
        else:
            self.start(work.doctor(self.workspace.profile_path))

    def show_result(self, result: Result) -> None:
        """Draw the doctor's findings."""
        if isinstance(result, DoctorResult):
            table = self.query_one("#findings", DataTable)
            table.clear()
            for finding in result.findings:
                table.add_row(finding.status, finding.subject, finding.text)

    def show_workspace(self, workspace: Workspace) -> None:
        """Nothing yet."""
