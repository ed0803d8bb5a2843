"""The screen Calibrate: errors by stage as tables, errors by configuration as charts, parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from textual.binding import BindingType

from cellapp.cell.exports.formats import all_formats
from cellapp.commands.calibrate import request
from cellapp.commands.calibrate.charts import pair_stop_chart, stop_error_chart
from cellapp.commands.calibrate.view import calibration_tables, parameters_view, tracker_sentences
from cellapp.commands.docs.keys import Step
from cellapp.commands.export.request import STAGES
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.report.data import ReportData
from cellapp.commands.stored_model import values_in_force
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import with_effects
from cellapp.ground.results import CALIBRATE
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.confirmations import offer_again
from cellapp.interfaces.tui.dialogs.question import WRITE
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen
from cellapp.interfaces.tui.workspace import Workspace


class CalibrateScreen(TabsScreen):
    """Errors by stage, residuals, parameters; calibrate again."""

    STEP: ClassVar[Step] = "calibrate"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "begin", "Calibrate", "identify and evaluate; nothing moves"),
        bind("import", "otherwise", "Otherwise", "with an earlier run as prior, or another network", show=False),
        bind("tab", "next_tab", "Next tab"),
        bind("export", "export", "Export", "write the calibrated arms for other programs"),
    ]

    TABS: ClassVar[Mapping[str, str]] = dict.fromkeys(("Stages", "Errors", "Parameters"), "")

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
            formats = all_formats()
            listed = "\n".join(f"{entry.name:15} {entry.what}" for entry in formats.values())
            choices = {"form": tuple(formats), "arm": tuple(calibration.arms), "stage": STAGES}
            self.ask_verb(
                EXPORT,
                f"{listed}\nSeveral arms get a file each.",
                {"folder": folder, "plan": None},
                WRITE,
                shows_result=self.read_result,
                choices=choices,
            )

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_run(self, workspace: Workspace) -> None:
        """Draw the calibration of the run."""
        result: CalibrateResult | None = workspace.stored(CALIBRATE)
        if result is None:
            self.show_nothing()
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
