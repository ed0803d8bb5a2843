"""Every run in the folder of runs: open it, or its report.

Runs are read in threads, which also load the packages for it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

from textual import on, work
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.widgets import DataTable, Static
from textual.worker import get_current_worker

from cellapp.commands.report.request import VERB as REPORT
from cellapp.commands.runs.result import RunsResult
from cellapp.commands.runs.view import run_lines, runs_sentences, runs_table
from cellapp.ground.errors import CellappError
from cellapp.interfaces.tui import verb_jobs as jobs_of_verbs
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.job_outcome import REPORT_FILE
from cellapp.interfaces.tui.keys import bind, with_keys
from cellapp.interfaces.tui.widgets.tables import TextTable

if TYPE_CHECKING:
    from cellapp.commands.runs.result import RunSummary


_READING = "reading the folder of runs ..."


class RunsList(Vertical):
    """The runs of the folder, newest first; below them more of the one under the cursor."""

    BINDINGS: ClassVar[list[BindingType]] = [
        bind("open", "report", "Report", "say where the report is, or write it"),
        bind("again", "read", "Read again", "read the folder of runs again", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._found = RunsResult(folder="", runs=())

    def compose(self) -> ComposeResult:
        yield TextTable(id="runs", cursor_type="row", zebra_stripes=True)
        with VerticalScroll(id="about-run", can_focus=False):
            yield Static(_READING, id="about", markup=False)

    def on_mount(self) -> None:
        """Read the folder."""
        self.enter_list()
        self.action_read()

    @property
    def _host(self) -> Host:
        return cast(Host, self.app)

    @property
    def _table(self) -> TextTable:
        return self.query_one(TextTable)

    @property
    def _run(self) -> RunSummary | None:
        """The run under the cursor."""
        runs = self._found.runs
        return runs[self._table.cursor_row] if self._table.cursor_row < len(runs) else None

    # -- reading -------------------------------------------------------------------------------------------------------

    def action_read(self) -> None:
        """Read the folder again."""
        self._list_runs(self._host.logs)

    @work(thread=True, exclusive=True, group="list of runs")
    def _list_runs(self, folder: Path) -> None:
        from cellapp.commands.runs.run import list_runs

        try:
            found = list_runs(folder) if os.path.isdir(folder) else RunsResult(folder=str(folder), runs=())
        except CellappError as error:
            self.call_later(self._host.say, str(error), "error")
            return
        if not get_current_worker().is_cancelled:  # else a later reading is in progress
            self.call_later(self._show_list, found)

    def _show_list(self, found: RunsResult) -> None:
        """Draw the list; the cursor stays on its run, and the open one is marked."""
        present = self._run
        self._found = found
        row = next((row for row, run in enumerate(found.runs) if present is not None and run.run == present.run), 0)
        opened = [row for row, run in enumerate(found.runs) if self._is_open(run)]
        self._table.show(runs_table(found), row, opened)
        self._draw_about()

    # -- drawing -------------------------------------------------------------------------------------------------------

    def _is_open(self, run: RunSummary) -> bool:
        return Path(run.run) == self._host.workspace.folder

    def _draw_about(self) -> None:
        run = self._run
        if run is not None:
            lines = run_lines(run)
            if run.next_step and not self._is_open(run):
                lines[-1] = lines[-1].replace(run.next_step, f"Enter, then {run.next_step}")
        else:
            lines = runs_sentences(self._found)
        self.query_one("#about", Static).update(with_keys("\n".join(lines)))

    @on(DataTable.RowHighlighted)
    def show_run(self, event: DataTable.RowHighlighted) -> None:
        """Show details of the run under the cursor."""
        event.stop()
        self._draw_about()

    def enter_list(self) -> None:
        """Let the keys go through the list."""
        self._table.focus()

    # -- what can be done with a run -----------------------------------------------------------------------------------

    @on(DataTable.RowSelected)
    def open_run(self) -> None:
        """Open the run under the cursor."""
        host = self._host
        self._with_run(lambda run: host.open_run(Path(run.run), host.workspace.profile_path))

    def action_report(self) -> None:
        """Say where the report is; write it if there is none."""

        def report(run: RunSummary) -> None:
            page = Path(run.run) / REPORT_FILE
            if page.is_file():
                self._host.say(f"The report is {page.resolve()}: open it in a browser.")
            elif any(stage.name == "calibrate" for stage in run.stages):
                self._host.start_job(jobs_of_verbs.job_of(REPORT, folder=Path(run.run)))
            else:
                self._host.say(f"{run.run} is not calibrated; there is nothing to report yet.", "warning")

        self._with_run(report)

    def _with_run(self, act: Callable[[RunSummary], None]) -> None:
        """Call ``act`` with the run under the cursor if it can be read."""
        run = self._run
        if run is None:
            self._host.say("No run is under the cursor.", "warning")
        elif run.problem:
            self._host.say(run.problem, "error")
        else:
            act(run)
