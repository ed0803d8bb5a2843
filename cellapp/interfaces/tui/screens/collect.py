"""The screen Collect: both arms, the tracker, progress, errors, drift and the log, while arms move and afterwards.

The headline of the screen Collect: the state, and what can be done now. Draws nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import ClassVar, Literal, get_args

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Container, Horizontal
from textual.content import Content

from cellapp.commands.collect.charts import drift_chart, live_drift_chart, residual_chart, standard_error_chart
from cellapp.commands.collect.request import VERB as COLLECT
from cellapp.commands.collect.view import collection_tables
from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.commands.view.charts import Chart
from cellapp.ground.control import Request
from cellapp.ground.counting import counted
from cellapp.ground.progress import JobState
from cellapp.interfaces.tui import verb_jobs as jobs
from cellapp.interfaces.tui.day_state import DayState, holds_for_drift
from cellapp.interfaces.tui.dialogs.question import BEGIN, Choice
from cellapp.interfaces.tui.job_record import ArmRecord, JobRecord, LogRow, level_of
from cellapp.interfaces.tui.jobs import Job
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.terminal import since_words
from cellapp.interfaces.tui.widgets.arm_panel import ArmPanel, tracker_words
from cellapp.interfaces.tui.widgets.chart_plot import ChartPlot
from cellapp.interfaces.tui.widgets.collected_stops import CollectedStops
from cellapp.interfaces.tui.widgets.controls import Line
from cellapp.interfaces.tui.widgets.log_pane import LogPane
from cellapp.interfaces.tui.widgets.parts_view import PartsView
from cellapp.interfaces.tui.workspace import Workspace

_Style = Literal["idle", "running", "waiting", "halted", "done"]

_STOP, _PAUSE = SHOWN["stop"], SHOWN["pause"]
_RESUMES, _ENDS = f"{_PAUSE} or {SHOWN['resume']} resumes", f"{SHOWN['abort']} ends it."
_DOING: dict[JobState, tuple[_Style, str]] = {
    "running": ("running", f"{_STOP} brakes all arms; {_PAUSE} pauses after this stop; {_ENDS}"),
    "pausing": ("waiting", f"The arms rest after this stop. {_RESUMES}; {_STOP} brakes."),
    "paused": ("waiting", f"The arms rest. {_RESUMES}; {_STOP} stops; {_ENDS}"),
    "suspended": ("waiting", f"It resumes by itself once the cause is gone. {_STOP} stops; {_ENDS}"),
    "stopped": ("halted", f"{SHOWN['resume']} resumes when the cell is clear; {_ENDS}"),
    "aborted": ("halted", "The arms brake and the job ends; what was measured is kept."),
}


Headline = tuple[str, str, _Style]
"""A word, a sentence with what can be done, and their style."""


def headline(run: DayState, record: JobRecord, request: Request) -> Headline:
    """Return the state of the job, else of the run; ``request`` is the last request of a person to the job."""
    if record.state is None:
        return _of_run(run)
    if run.job is not None and not run.job.moves:
        return ("RUNNING", f"{record.name}: nothing moves. {_STOP} or {_ENDS}", "running")
    state = record.state
    if state in ("running", "pausing") and record.causes:  # the job's thread has not noticed yet, or hangs
        return ("STOPPED", f"{'; '.join(record.causes).rstrip('.')}. {_DOING['stopped'][1]}", "halted")
    if record.lost and state != "stopped":  # a stopped job gives the reason and what to do; the strip shows the ages
        text = f"from {', '.join(record.lost)}: what is shown of it is old. {_STOP} brakes all arms."
        return ("NO DATA", text, "halted")
    if state == "running" and request != "none":
        state = {"pause": "pausing", "stop": "stopped", "abort": "aborted"}[request]  # type: ignore[assignment]
    look, possible = _DOING[state]
    if holds_for_drift(record):
        possible = f"Look for a moved tracker, nest or SMR. {SHOWN['drift']} accepts the drift and resumes, as"
        possible += f" {SHOWN['resume']} does; {_ENDS}"
    waits = record.reason and state == record.state != "running"
    return (state.upper(), f"{since_words(record)}. {possible}" if waits else possible, look)


def _of_run(state: DayState) -> Headline:
    cell, todo, measured = state.workspace, state.remaining, state.measured
    if state.no_run:
        return ("NO RUN", state.no_run, "idle")
    if state.reading:
        return ("READING", state.reading, "idle")
    if cell.in_use:
        return ("IN USE", f"by {cell.in_use}. Shown is what was stored when it was opened.", "waiting")
    if not todo and not measured:
        return ("NO PLAN", "This run has no stops to measure.", "idle")
    if not todo:
        return (f"COMPLETE, {counted(measured, 'stop')}", "Nothing is left to measure.", "done")
    left = counted(todo, "stop that is left", "stops that are left")
    sentence = f"{SHOWN['go']} measures {left}. Nothing moves before it is confirmed."
    if cell.read_only:
        sentence = f"{state.next_words}."
    elif cell.drifts:
        sentence = f"The references moved beyond their limit: {SHOWN['drift']} accepts that and resumes. {sentence}"
    if not measured or cell.outcome == "complete":  # others were planned since
        return (f"READY, {counted(todo, 'stop')}", sentence, "idle")
    word = "ACCURATE ENOUGH" if cell.outcome == "accurate enough" else "INTERRUPTED"
    return (f"{word}, {measured} of {counted(measured + todo, 'stop')}", sentence, "idle")


_View = Literal["log", "plots", "stops", "collected"]
_VIEWS: tuple[_View, ...] = get_args(_View)
_PLOTS = ("residuals", "errors", "drift")
_PLOTTING_S = 1.0
"""Least time between two drawings of the plots while a job runs: they take some 10 ms each on a large screen."""


class CollectScreen(DayScreen):
    """Drive and measure; watch it; resume it."""

    STEP: ClassVar[Step] = "collect"
    VERTICAL_BREAKPOINTS = [(0, "-low"), (34, "-tall")]  # noqa: RUF012 - as Textual declares it
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "begin", "Begin", "measure the stops that are left: THE ARMS MOVE"),
        bind("drift", "accept_drift", "Accept drift", "count drift from new first measurements, and resume"),
        bind("again", "measure_again", "Measure again", "visit the marked stops again: THE ARMS MOVE", show=False),
        bind("plots", "view('plots')", "Plots", "show the plots; again: the next one"),
        bind("tab", "next_tab", "Next tab", "from the log to the plots, the stops, the tables"),
        bind("after", "step(1)", "Next stop", "go to the next stop of the list", show=False),
        bind("before", "step(-1)", "Stop before", "go to the stop before", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._plot = 0
        self._plotted: tuple[object, ...] = ()
        self._plotted_s = 0.0
        self._opened: Path | None = None
        self._job: Job | None = None

    def body(self) -> ComposeResult:
        self.add_class(self._first_view)  # before the widgets are there, whose styles depend on it
        yield Line(id="state")
        yield Horizontal(id="arms")
        yield Line(id="tracker")
        yield Line(id="suspicions")
        with Container(id="plots"):
            for name in _PLOTS:
                yield ChartPlot(id=name)
        yield LogPane(id="log")
        yield CollectedStops(id="stops")
        yield PartsView(id="collected")

    def on_mount(self) -> None:
        """Set the tooltips, and focus the log."""
        self.query_one("#state").tooltip = "The state of the job, and what can be done now."
        self.query_one("#tracker").tooltip = (
            "The tracker: the arm at which it points; the newest point in the tracker frame and its standard"
            " uncertainty; the air."
        )
        self.query_one("#suspicions").tooltip = "What the measurements made doubtful: look at it before you go on."
        for plot in self.query(ChartPlot):
            plot.tooltip = "Errors of the newest points, standard errors, drift of the references."
        self.query_one(f"#{_PLOTS[0]}").add_class("chosen")
        self.query_one(LogPane).view.focus()
        stops = self.query_one(CollectedStops)
        self.watch(stops, "chosen", lambda: self.show_job(self.cell_app.record), init=False)  # marked in the plot

    # -- begin, resume, accept -----------------------------------------------------------------------------------------

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable only actions that are possible now."""
        idle, state = not self.cell_app.jobs.running, self.state
        usable = idle and not (self.workspace.in_use or self.workspace.read_only or state.no_run)
        free = usable and state.remaining > 0
        drift = free and self.workspace.drifts if idle else holds_for_drift(self.cell_app.record)
        again = usable and self.has_class("stops") and bool(self.query_one(CollectedStops).again)
        return {"begin": free, "accept_drift": drift, "measure_again": again}.get(action, True)

    def action_begin(self) -> None:
        """Collect the open planned run, or the remaining stops of an interrupted one."""
        todo, measured = self.state.remaining, self.state.measured
        if measured:
            self._collect("Resume?", f"the {counted(todo, 'stop')} that are left; {measured} are measured", resume=True)
        else:
            self._collect("Begin to collect?", counted(todo, "stop"), resume=False)

    def action_accept_drift(self) -> None:
        """Accept the drift: it is then relative to new first measurements."""
        if self.cell_app.jobs.running:
            self.cell_app.action_resume()  # the job measures its references again
            return
        what = f"{counted(self.state.remaining, 'stop')}; drift of the references counts from new first measurements"
        self._collect("Accept the drift and resume?", what, resume=True, accept_drift=True)

    def action_measure_again(self) -> None:
        """Measure the marked stops again, or the one under the cursor."""
        stops = self.query_one(CollectedStops).again
        listed = ", ".join(str(stop + 1) for stop in stops)
        what = f"{counted(len(stops), 'stop')} again, all arms: {listed}. The readings before are kept and not used"
        if self.workspace.stored("calibrate") is not None:
            what += "; what was calibrated with them is out of date then"
        self._collect("Measure again?", what, again=listed.replace(" ", ""))

    def _collect(self, title: str, what: str, **asked: bool | str) -> None:
        """Ask, then start. A job with real arms itself asks, with the first path, before they move."""
        folder, kind = self.workspace.folder, self.workspace.kind
        if folder is None:
            return
        job = jobs.job_of(COLLECT, folder=folder, **asked)
        if kind == "real" and not {"accept_drift", "again"} & asked.keys():
            self.start(job)
            return
        moves = self.workspace.arms_words + (", after one more question" if kind == "real" else "")
        text = f"Measure {what}. In {folder}; {moves}. Escape stops at any time; what is measured is kept."
        self.ask(Choice(title, text, BEGIN), lambda: self.start(job))

    # -- views ---------------------------------------------------------------------------------------------------------

    @property
    def _first_view(self) -> _View:
        return "log" if self.workspace.collection is None else "stops"

    def action_view(self, view: _View) -> None:
        """Show the log, the plots or the stored data; if plots are already shown, the next one."""
        if view == "plots" and self.has_class("plots"):
            self._plot = (self._plot + 1) % len(_PLOTS)
        for number, name in enumerate(_PLOTS):
            self.query_one(f"#{name}").set_class(number == self._plot, "chosen")
        self.update_classes({one: one == view for one in _VIEWS})
        log, stops = self.query_one(LogPane).view, self.query_one(CollectedStops).table
        self.set_focus({"log": log, "stops": stops, "collected": self.query_one(PartsView)}.get(view))

    def action_next_tab(self) -> None:
        """Switch from the log to the plots, to the list of stops, and to the tables of stored data."""
        shown = next(view for view in _VIEWS if self.has_class(view))
        self.action_view(_VIEWS[(_VIEWS.index(shown) + 1) % len(_VIEWS)])

    def action_step(self, step: int) -> None:
        """Go to another stop of the list."""
        self.query_one(CollectedStops).step(step)

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the stored data of the run, and its log unless a job tells more."""
        super().show_workspace(workspace)
        if workspace.folder != self._opened and not self.cell_app.jobs.running:
            self._opened = workspace.folder
            self.action_view(self._first_view)
            self._show_log(workspace)

    def _show_log(self, workspace: Workspace) -> None:
        """Draw the log stored in a run; that of this session if the run has none."""
        rows = [
            LogRow(datetime.fromisoformat(line.written).astimezone(), level_of(line.level), line.text)
            for line in workspace.log
        ]
        if rows and workspace.folder is not None:
            self.query_one(LogPane).show(f"Log stored in {workspace.folder.name}", rows)
        else:
            self.query_one(LogPane).show_session(self.cell_app.record)

    def show_run(self, workspace: Workspace) -> None:
        """Draw the tables of what was collected."""
        state = workspace.collection
        self.query_one(PartsView).show([] if state is None else collection_tables(state))
        self.query_one(CollectedStops).show(state)

    def show_state(self, state: DayState) -> None:
        """Say what is collected, if no table does."""
        self.query_one(PartsView).say_empty(state.not_collected)
        self.query_one(CollectedStops).say_empty(state.not_collected)

    def show_job(self, record: JobRecord) -> None:
        """Draw what has changed."""
        running, job = record.state is not None, self.cell_app.jobs.job
        if job is not None and job is not self._job:
            self._begin_to_watch(job, record)
        elif self.query_one(LogPane).shows_session:
            self.query_one(LogPane).show_session(record)
        self._draw_state(record)
        if not running and (self._job is None or self._job.folder != self.workspace.folder):
            record = JobRecord()  # the job was about another run
        self._draw_arms(record)
        tracker = Content.assemble(("tracker", "bold"), " ", tracker_words(record.tracker))
        self.query_one("#tracker", Line).say(tracker)
        self._draw_suspicions(record)
        self.set_class(record.state is None and not record.arms, "unheard")
        self._draw_plots(record)

    def _begin_to_watch(self, job: Job, record: JobRecord) -> None:
        """Show the log of a job that has just started."""
        self.query_one(LogPane).show_session(record)
        if self.has_class("collected") or self.has_class("stops"):
            self.action_view("log")
        self._job = job
        self._opened = job.folder or self._opened  # its stored log is received anyway

    def _draw_state(self, record: JobRecord) -> None:
        word, sentence, look = headline(self.state, record, self.cell_app.jobs.control.request)
        self.query_one("#state", Line).say(Content.assemble((word, "bold"), f"  {sentence}"), look)

    def _draw_arms(self, record: JobRecord) -> None:
        panels = {panel.arm_name: panel for panel in self.query(ArmPanel)}
        names = self._arm_names(record)
        if list(panels) != names:
            box = self.query_one("#arms")
            box.remove_children()
            panels = {name: ArmPanel(name) for name in names}
            box.mount(*panels.values())
        for name, panel in panels.items():
            panel.arm = record.arms.get(name, ArmRecord())

    def _arm_names(self, record: JobRecord) -> list[str]:
        profile = self.workspace.profile
        known: Iterable[str] = () if profile is None else profile.arms
        return list(dict.fromkeys((*known, *record.arms)))

    def _draw_suspicions(self, record: JobRecord) -> None:
        """Draw the newest suspicion in words, and how many there were before."""
        line, words = self.query_one("#suspicions", Line), ""
        if record.suspicions:
            newest = record.suspicions[-1]
            before = len(record.suspicions) - 1
            more = f" ({before} before: {SHOWN['filter']} in the log shows them)" if before else ""
            arm = "" if newest.arm is None else f", arm {newest.arm}"
            words = f"! {newest.kind.upper()}{arm}: {newest.text}{more}"
        line.say(words, "any" if words else "")

    def _draw_plots(self, record: JobRecord) -> None:
        """Draw the plots of new data; while a job runs once a second at most, because drawing delays keys."""
        chosen = self.query_one(CollectedStops).chosen
        data, now_s = (record.name, len(record.stops), len(record.references), self.workspace, chosen), time.monotonic()
        if data == self._plotted or (record.state is not None and now_s < self._plotted_s + _PLOTTING_S):
            return
        self._plotted, self._plotted_s = data, now_s
        for name in _PLOTS:
            self.query_one(f"#{name}", ChartPlot).chart = self._chart(name, record)
        empty = {plot: plot.chart is None or plot.chart.is_empty for plot in self.query(ChartPlot)}
        for plot, nothing in empty.items():
            plot.set_class(nothing, "empty")
        self.set_class(all(empty.values()), "unplotted")

    def _chart(self, name: str, record: JobRecord) -> Chart:
        """Return a chart of the job, or of the stored data if the job has no stop or no reference."""
        collection = self.workspace.collection
        if name == "drift":
            if record.references or collection is None:
                return live_drift_chart(record.references)
            return drift_chart(collection.references, collection.drift_limit_mm)
        reports, arms, nothing = record.stops, self._arm_names(record), self.state.not_collected
        if name == "errors":
            return standard_error_chart(reports, arms, nothing)
        if reports or collection is None:
            return residual_chart(reports, arms, nothing)
        return residual_chart(collection.stops, arms, chosen=self.query_one(CollectedStops).chosen)
