"""The screen Plan: constraints of the plan, its stops, its duration, what it can show, whether it is safe.

Keys of the screen Plan that change a plan: freeze, add, design again, write and read a table.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from rich.text import Text
from textual import on, work
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import DataTable, Static, TabbedContent, TabPane

from cellapp.commands.docs.keys import SHOWN
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.ground.counting import counted
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.tui import work as verbs
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker, SaveAs
from cellapp.interfaces.tui.dialogs.question import Answer, Choice
from cellapp.interfaces.tui.dialogs.verb_question import NewRunQuestion, VerbQuestion
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView
from cellapp.interfaces.tui.widgets.tables import CellMap, StopsTable, explain_tabs, show_next_of
from cellapp.interfaces.tui.workspace import Step, Workspace, new_folder

if TYPE_CHECKING:
    from cellapp.cell.driving.records import StopsResult
    from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
    from cellapp.commands.view.parts import Parts
    from cellapp.ground.profile import Profile
    from cellapp.ground.results import Result


NO_PLAN = f"This run has no plan: its readings were imported. {SHOWN['go']} plans a new run."
_PLAN_FILE = "plan.csv"
"""Default file name of a plan as a table."""
_FURTHER = 50
"""Default number of stops that are appended."""
_TAKE = (Answer("take", "Take", "t", "success"), Answer("no", "Close", "c"))


class PlanEdits(DayScreen):
    """A screen with the stops of the open run's plan; subclasses show them."""

    def planned_folder(self) -> Path | None:
        """Return the folder of the open run if it has a plan; else say why not and return None."""
        folder = self.open_folder()
        if folder is not None and not self.state.planned:
            self.say(NO_PLAN, "warning")
            return None
        return folder

    def action_freeze(self) -> None:
        """Exclude the marked stops from later designs; without marks, none."""
        if folder := self.planned_folder():
            marked = ",".join(map(str, sorted(self.query_one(StopsTable).marked)))
            self.start(verbs.job_of(PLAN, folder=folder, edit=True, freeze=marked or "none"))

    def action_add(self) -> None:
        """Ask how many stops to append."""
        if folder := self.planned_folder():
            text = "They tell most beside those that are planned or measured already. Nothing moves."
            self.ask_verb(VerbQuestion(PLAN, text, _TAKE, {"folder": folder, "edit": True}, proposed={"add": _FURTHER}))

    def action_replan(self) -> None:
        """Ask, then design the unmeasured stops again."""
        folder = self.planned_folder()
        if folder is None:
            return
        text = (
            "Stops that are measured, proposed by discovery or frozen stay, as far as they could be reached; all others"
            " of this run are replaced. Nothing moves."
        )
        answers = (Answer("no", "Leave the plan", "l"), Answer("replan", "Design again", "d", "warning"))
        job = verbs.job_of(PLAN, folder=folder, edit=True, replan=True)
        self.ask(Choice("Design the rest again?", text, answers), lambda: self.start(job))

    def action_write(self) -> None:
        """Ask where to write the plan."""
        folder = self.planned_folder()
        if folder is None:
            return

        def begin(path: Path | None) -> None:
            if path is not None:
                self.start(verbs.verb_job(EXPORT, ExportRequest(folder=folder, plan=path), RENEWED))

        self.app.push_screen(SaveAs("the plan", None, folder / _PLAN_FILE), begin)

    def action_read(self) -> None:
        """Ask for an edited plan, and check it."""
        profile = self.workspace.profile_path
        if self.workspace.file_profile is None or profile is None:
            self.say(self.state.no_profile, "warning")
            return

        def begin(path: Path | None) -> None:
            if path is not None:
                self.start(verbs.job_of(PLAN, profile=profile, source=path))

        start = self.workspace.folder or Path()
        self.app.push_screen(FilePicker("A plan as CSV", start, lambda path: path.suffix == ".csv"), begin)

    def offer_file(self, file: Path) -> None:
        """Ask what to do with a plan that is safe."""
        profile, path = self.workspace.file_profile, self.workspace.profile_path
        if profile is None or path is None:
            return

        def into(around: bool) -> None:
            def begin(folder: Path | None) -> None:
                if folder is not None:
                    self.start(verbs.job_of(PLAN, profile=path, folder=folder, source=file, keep=around))

            how = "with other stops designed around these" if around else "exactly as it is written"
            self.app.push_screen(
                NewRunQuestion(f"The plan of {file}, {how}. Nothing moves.", new_folder(profile)), begin
            )

        def answered(answer: str | None) -> None:
            if answer in ("from", "keep"):
                into(answer == "keep")

        answers = (
            Answer("look", "Only look", "l"),
            Answer("from", "New run with it", "n"),
            Answer("keep", "New run around it", "a"),
        )
        self.app.push_screen(Choice("This plan is safe", f"{file} holds at every stop and way.", answers), answered)


_PLOTS = ("tab-design", "tab-above", "tab-tracker")
_NO_CHECK = f"{SHOWN['check']} checks the plan again."
_NO_FORECAST = f"Not foreseen yet: {SHOWN['forecast']} computes time, expected errors and visible effects."


class PlanScreen(PlanEdits):
    """Plan a run, look at its plan, check it, forecast its results."""

    STEP: ClassVar[Step] = "plan"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "plan", "New plan", "make a new run with a plan"),
        bind("check", "check", "Check", "run the motion check over all stops and ways again; nothing moves"),
        bind("forecast", "forecast", "Forecast", "time, joint ranges, expected errors, effects that can be seen"),
        bind("mark", "mark", "Mark", "mark the selected stop"),
        bind("freeze", "freeze", "Freeze", "let later designs leave the marked stops"),
        bind("add", "add", "Add", "append stops to the open run's plan"),
        bind("again", "replan", "Replan", "design what is not measured again"),
        bind("export", "write", "Write", "write the plan as a table that can be edited"),
        bind("open", "read", "Read", "check a plan that was edited, and use it"),
        bind("plots", "plots", "Plots", "the design as charts; again: the maps", show=False),
        bind("tab", "next_tab", "Next tab", "show the next of the tabs"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._profile: Profile | None = None
        self._stops: StopsResult | None = None
        self._folder: Path | None = None
        self._check: PlanCheckResult | None = None
        self._forecast: PlanForecastResult | None = None
        self._file_check: PlanCheckResult | None = None

    def body(self) -> ComposeResult:
        with Horizontal():
            with Vertical(id="plan-middle"):
                yield Static("", id="plan-state", markup=False)
                yield Static("", id="plan-safety", markup=False)
                yield Static("", id="plan-time", markup=False)
                with TabbedContent(id="plan-tabs", initial="tab-constraints"):
                    with TabPane("Limits", id="tab-constraints"):
                        yield PartsView(id="constraints")
                    with TabPane("Design", id="tab-design"):
                        yield PartsView(id="plan-design")
                    with TabPane("Stops", id="tab-stops"):
                        yield StopsTable(id="stops")
                    with TabPane("Forecast", id="tab-forecast"):
                        yield PartsView(_NO_FORECAST, id="forecast")
                    with TabPane("Check", id="tab-check"):
                        yield PartsView(_NO_CHECK, id="refusals")
                    with TabPane("Above", id="tab-above"):
                        yield CellMap("above", id="plan-above")
                    with TabPane("Tracker", id="tab-tracker"):
                        yield CellMap("tracker", id="plan-tracker")
                yield Static("", id="plan-detail", markup=False)
            with Vertical(id="plan-side"):
                yield CellMap("above", id="side-above")
                yield CellMap("tracker", id="side-tracker")

    def on_mount(self) -> None:
        """Explain the tabs."""
        explain_tabs(self.query_one("#plan-tabs", TabbedContent))

    # -- actions -------------------------------------------------------------------------------------------------------

    def action_plan(self) -> None:
        """Ask for the folder, then create a new run."""
        profile, path = self.workspace.file_profile, self.workspace.profile_path
        if profile is None or path is None:
            self.say(self.state.no_profile, "warning")
            return
        if self.cell_app.jobs.running:
            self.say("A job is running; plan when it has ended.", "warning")
            return
        reserve = f" and {profile.plan.reserve} in reserve" if profile.plan.reserve else ""
        text = (
            f"{counted(profile.plan.stops, 'stop')}{reserve} of the cell '{profile.name}', read from {path}."
            " Nothing moves."
        )

        def begin(folder: Path | None) -> None:
            if folder is not None:
                self.start(verbs.job_of(PLAN, profile=path, folder=folder))

        self.app.push_screen(NewRunQuestion(text, new_folder(profile)), begin)

    def action_check(self) -> None:
        """Check the plan of the open run."""
        if folder := self.planned_folder():
            self.start(verbs.check_plan(folder))

    def action_forecast(self) -> None:
        """Forecast the results of the open run's plan."""
        if folder := self.planned_folder():
            self.start(verbs.forecast_plan(folder))

    def action_mark(self) -> None:
        """Mark the selected stop."""
        self.query_one(StopsTable).mark()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable marking only where stops are listed."""
        if action not in ("mark", "freeze"):
            return True
        return any(tabs.active == "tab-stops" for tabs in self.query("#plan-tabs").results(TabbedContent))

    def action_plots(self) -> None:
        """Show the design, then the maps."""
        show_next_of(self.query_one("#plan-tabs", TabbedContent), _PLOTS)

    def tab_shown(self, tabs: TabbedContent) -> None:
        """Focus the stops or the tables of the tab."""
        if tabs.active_pane is not None:
            for content in tabs.active_pane.query("StopsTable, PartsView"):
                content.focus()

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_result(self, result: Result) -> None:
        """Draw a check or a forecast."""
        from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult

        tabs = self.query_one("#plan-tabs", TabbedContent)
        if isinstance(result, PlanCheckResult) and result.file is not None:
            self._file_check = result
            tabs.active = "tab-check"
            self._draw_results()
            if result.is_safe:
                self.offer_file(Path(result.file))
            return
        if isinstance(result, PlanCheckResult | PlanForecastResult) and Path(result.run) != self._folder:
            return  # another run was opened meanwhile
        if isinstance(result, PlanCheckResult):
            self._check, self._file_check = result, None
            if result.refused:
                tabs.active = "tab-check"
        elif isinstance(result, PlanForecastResult):
            self._forecast = result
            if tabs.active in ("tab-constraints", "tab-check"):
                tabs.active = "tab-forecast"
        self._draw_results()

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the constraints, the plan and its maps."""
        self._profile = workspace.profile
        stops = workspace.stops
        same_plan = workspace.folder == self._folder and _planned(stops) == _planned(self._stops)
        if not same_plan:
            self._check = self._forecast = None
        if stops is not self._stops or not same_plan or workspace.folder is None:
            self._folder, self._stops = workspace.folder, stops
            self._draw_maps(workspace)
        self._draw_results()

    def show_state(self, state: RunState) -> None:
        """Say how much is planned and measured, or what to do."""
        self.query_one("#plan-state", Static).update(_state_words(state, self.workspace))

    def _draw_constraints(self) -> None:
        from cellapp.commands.doctor.view import profile_tables

        tables = [] if self._profile is None else profile_tables(self._profile)
        self.query_one("#constraints", PartsView).show(tables[1:])

    def _draw_maps(self, workspace: Workspace) -> None:
        stops = () if workspace.stops is None else workspace.stops.stops
        for drawn in self.query(CellMap):
            drawn.show_cell(workspace.profile, stops)
        self._draw_stops()
        self._make_charts(workspace)

    def _draw_stops(self) -> None:
        """List the stops only while their tab is shown: thousands take half a second."""
        if self.query_one("#plan-tabs", TabbedContent).active == "tab-stops":
            stops = () if self._stops is None else self._stops.stops
            self.query_one(StopsTable).show(stops, self.workspace.ways)

    @work(thread=True, exclusive=True, group="charts", description="charts")
    def _make_charts(self, workspace: Workspace) -> None:
        """Make the charts of the design in a thread: the numerics take half a second to load."""
        from cellapp.commands.plan.check_view import load_sentences, sweep_sentences
        from cellapp.commands.plan.view import design_charts_of, design_tables_of

        profile, stops, ways, design = workspace.profile, workspace.stops, workspace.ways, workspace.design
        if profile is not None and ways is not None and stops is not None and stops.stops:
            sentences = (*load_sentences(stops.loads), *sweep_sentences(stops.sweeps))
            charts = design_charts_of(profile, stops.stops, ways, design)
            self.call_later(self._show_design, stops, (*sentences, *charts, *design_tables_of(design)))

    def _show_design(self, of: StopsResult, parts: Parts) -> None:
        """Show the design, unless another run was opened meanwhile."""
        if of is self._stops:
            self.query_one("#plan-design", PartsView).show(parts)

    def _draw_results(self) -> None:
        """Draw check and forecast, or which keys start them."""
        has_plan = self._stops is not None and bool(self._stops.stops)
        self._draw_constraints()
        self._draw_check(has_plan=has_plan)
        words = _NO_FORECAST if has_plan else ""
        shown = self.query_one("#forecast", PartsView)
        if (forecast := self._forecast) is None:
            shown.show(())
        else:
            from cellapp.commands.plan.check_view import forecast_sentences, forecast_tables, time_sentence

            shown.show((*forecast_sentences(forecast), *forecast_tables(forecast)))
            words = " ".join([time_sentence(forecast.time), *forecast.notes])
        line = self.query_one("#plan-time", Static)
        line.update(words)
        line.display = bool(words)
        self._draw_detail()

    def _draw_check(self, *, has_plan: bool) -> None:
        """Draw the verdict on the open run's plan, and the refusals of this plan or of the last checked edited plan."""
        line, check = self.query_one("#plan-safety", Static), self._check
        line.update(f"Checked when it was planned; {SHOWN['check']} checks it again." if has_plan else "")
        line.display = has_plan
        line.set_classes("")
        if check is not None:
            line.update(_check_lines(check)[0])
            line.set_classes("safe" if check.is_safe else "unsafe")
        listed = self._file_check or check
        self.query_one("#refusals", PartsView).show(() if listed is None else _check_lines(listed))

    @on(DataTable.RowHighlighted)
    @on(TabbedContent.TabActivated)
    def _draw_detail(self) -> None:
        """Describe the selected stop while the stops are shown."""
        self._draw_stops()
        detail = self.query_one("#plan-detail", Static)
        detail.display = self.query_one("#plan-tabs", TabbedContent).active == "tab-stops"
        detail.update(Text(self.query_one(StopsTable).selected_text))


def _planned(stops: StopsResult | None) -> tuple[object, ...]:
    """Return what a check and a forecast depend on: the joint positions of all stops."""
    return () if stops is None else tuple(stop.q for stop in stops.stops)


def _check_lines(check: PlanCheckResult) -> list[str]:
    """Return the verdict of a check, then its refusals."""
    from cellapp.commands.plan.check_view import check_sentences

    verdict, *refusals = check_sentences(check)
    # the line above the tabs is about the open run
    return [verdict if check.file is None else f"{check.file}: {verdict}", *refusals]


def _state_words(state: RunState, workspace: Workspace) -> str:
    """Return how much is planned and measured, or what to do."""
    if state.no_run or workspace.overview is None:
        return state.no_run
    if not state.planned:
        return NO_PLAN
    reserves = (0 if workspace.stops is None else len(workspace.stops.stops)) - state.planned
    more = f" and {reserves} in reserve" if reserves else ""
    now = state.measured if state.collecting else 0
    arms = [
        f"arm {name}: {counted(arm.planned, 'stop')}{more}, {max(arm.measured, now)} measured"
        for name, arm in workspace.overview.arms.items()
    ]
    edited = f" The profile was edited since; {SHOWN['go']} plans with the present one." if workspace.edited else ""
    return "; ".join(arms) + "." + edited
