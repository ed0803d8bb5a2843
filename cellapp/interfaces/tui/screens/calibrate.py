"""The screen Calibrate: errors by stage as tables, errors by configuration as charts, parameters.

Dialog for the format and the file of an export of calibrated arms or commands for other programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.widget import Widget
from textual.widgets import Input, OptionList
from textual.widgets.option_list import Option

from cellapp.cell.exports.arm_export import ExportResult
from cellapp.cell.exports.formats import all_formats
from cellapp.commands.calibrate import request
from cellapp.commands.calibrate.charts import pair_stop_chart, stop_error_chart
from cellapp.commands.calibrate.view import calibration_tables, parameters_view, tracker_sentences
from cellapp.commands.export.request import STAGES, VERB
from cellapp.commands.report.data import ReportData
from cellapp.commands.stored_model import values_in_force
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import with_effects
from cellapp.ground.results import CALIBRATE, Result
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.confirmations import offer_again
from cellapp.interfaces.tui.dialogs.question import WRITE, ChosenAnswer, reading_of
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen
from cellapp.interfaces.tui.workspace import Step, Workspace


class ExportArms(VerbQuestion):
    """The dialog of ``export`` with a list of the formats, which proposes a file for each.

    Parameters
    ----------
    folder : Path
        Folder of the run, where files are proposed.
    arms : sequence of str
    answers : sequence of ChosenAnswer
    """

    def __init__(self, folder: Path, arms: Sequence[str], answers: Sequence[ChosenAnswer]) -> None:
        choices = {"arm": arms, "stage": STAGES}
        super().__init__(
            VERB, "Several arms get a file each.", answers, {"folder": folder, "plan": None}, choices=choices
        )
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


class CalibrateScreen(TabsScreen):
    """Errors by stage, residuals, parameters; calibrate again."""

    STEP: ClassVar[Step] = "calibrate"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "begin", "Calibrate", "identify and evaluate; nothing moves"),
        bind("import", "otherwise", "Otherwise", "with an earlier run as prior, or another network", show=False),
        bind("tab", "next_tab", "Next tab"),
        bind("export", "export", "Export", "write the calibrated arms for other programs"),
    ]

    TABS: ClassVar[tuple[str, ...]] = ("Stages", "Errors", "Parameters")

    # -- keys ----------------------------------------------------------------------------------------------------------

    def action_begin(self) -> None:
        """Calibrate the open run."""
        if folder := self.open_folder():
            offer_again(self, "Calibrate again?", CALIBRATE, verb_jobs.job_of(request.VERB, folder=folder))

    def action_otherwise(self) -> None:
        """Ask for an earlier run as prior and for the network, then calibrate the open run."""
        if (folder := self.open_folder()) is not None:
            text = "What is stored stays. An earlier run of the same arms is a prior. Nothing moves."
            self.ask_verb(request.VERB, text, {"folder": folder, "parameters": False})

    def action_export(self) -> None:
        """Ask for format and file, then write the calibrated arms."""
        if (calibrated := self.calibrated_run()) is not None:
            folder, _, calibration = calibrated
            self.ask_request(ExportArms(folder, tuple(calibration.arms), WRITE))

    def show_result(self, result: Result) -> None:
        """Show what was exported, and what the files do not contain."""
        if isinstance(result, ExportResult) and self.app.screen is self:
            from cellapp.cell.exports.formats import export_lines

            self.app.push_screen(reading_of("Exported", export_lines(result)))

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_run(self, workspace: Workspace) -> None:
        """Draw the calibration of the run."""
        result: CalibrateResult | None = workspace.stored(CALIBRATE)
        if result is None:
            for title in self.TABS:
                self.tab(title).show([])
            return
        outdated = self.outdated(CALIBRATE, "go", "calibrates again")
        self.tab("Stages").show((*calibration_tables(result), *tracker_sentences(result), *result.notes), outdated)
        self.tab("Parameters").show(parameters_view(result).parts, outdated)
        self.tab("Errors").show([])
        if workspace.data is not None:
            self._show_errors(workspace.data)

    def _show_errors(self, data: ReportData) -> None:
        """Draw the held-out errors of the newest model, and the parameters in force."""
        shown = data.calibrate if data.discover is None else with_effects(data.calibrate, data.discover)
        charts = [stop_error_chart(name, arm, shown.arms[name].tracker_mm) for name, arm in data.held_out.items()]
        self.tab("Errors").show([*charts, pair_stop_chart(shown)])
        parts = parameters_view(values_in_force(data.calibrate, data.model)).parts
        self.tab("Parameters").show(parts, self.outdated(CALIBRATE, "go", "calibrates again"))
