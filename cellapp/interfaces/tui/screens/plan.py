"""The screen Plan: constraints of the plan, its stops, its duration, what it can show, whether it is safe."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.widgets import TabbedContent

from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.commands.export.request import VERB as EXPORT
from cellapp.commands.plan.request import VERB as PLAN
from cellapp.commands.show.request import VERB as SHOW
from cellapp.commands.show.result import Shown
from cellapp.commands.view.table import Cell, Table, table_of_cells
from cellapp.ground.counting import counted
from cellapp.interfaces.tui import verb_jobs as verbs
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen, id_of
from cellapp.interfaces.tui.widgets.controls import Line
from cellapp.interfaces.tui.widgets.tables import CellMap, TextTable
from cellapp.interfaces.tui.workspace import Workspace, new_folder

if TYPE_CHECKING:
    from cellapp.cell.planning.planned_stops import PlannedStops
    from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult
    from cellapp.commands.plan.result import PlannedStop
    from cellapp.commands.record import View
    from cellapp.commands.view.parts import Parts
    from cellapp.ground.results import Result


NO_PLAN = f"This run has no plan: its readings were imported. {SHOWN['go']} plans a new run."
_PLAN_FILE = "plan.csv"
"""Default file name of a plan as a table."""
_NEW = {"profile": None, "sweeps": None, "source": None, "keep": False}
_EDITS = {"edit": False, "add": None, "replan": False, "freeze": None}
"""Fields of requests for a new plan, and for a changed one."""
_OTHER_EXPORTS = dict.fromkeys(("csv", "joints", "points", "form", "out", "arm", "stage"))


class PlanScreen(TabsScreen):
    """Plan a run, look at its plan, check it, forecast its results."""

    STEP: ClassVar[Step] = "plan"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "plan", "New plan", "make a new run with a plan, designed or read from a table"),
        bind("check", "check", "Check", "run the motion check over all stops and ways again; nothing moves"),
        bind("forecast", "forecast", "Forecast", "time, joint ranges, expected errors, effects that can be seen"),
        bind("add", "change", "Change", "append stops, freeze some, or design the rest again"),
        bind("export", "write", "Write", "write the plan as a table that can be edited"),
        bind("tab", "next_tab", "Next tab", "show the next of the tabs"),
    ]

    TABS: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("Limits", "Design", "Stops"), ""),
        "Forecast": f"Not foreseen yet: {SHOWN['forecast']} computes time, expected errors and visible effects.",
        "Check": f"{SHOWN['check']} checks the plan again.",
        "Above": "",
    }

    def __init__(self) -> None:
        super().__init__()
        self._planned: tuple[object, ...] = ()
        self._listed: Workspace | None = None
        self._check: PlanCheckResult | None = None
        self._forecast: PlanForecastResult | None = None

    def body(self) -> ComposeResult:
        yield Line(id="plan-state")
        yield Line(id="plan-safety")
        yield from super().body()

    def in_tab(self, title: str) -> ComposeResult:
        if title == "Stops":
            yield TextTable(cursor_type="row")
        elif title == "Above":
            yield CellMap()
        else:
            yield from super().in_tab(title)

    # -- actions -------------------------------------------------------------------------------------------------------

    def planned_folder(self) -> Path | None:
        """Return the folder of the open run if it has a plan; else say why not and return None."""
        folder = self.open_folder()
        if folder is not None and not self.state.planned:
            self.say(NO_PLAN, "warning")
            return None
        return folder

    def action_plan(self) -> None:
        """Ask for the folder, and for a table to read; then create a new run, or without a folder check the table."""
        profile, path = self.workspace.file_profile, self.workspace.profile_path
        if profile is None or path is None:
            self.say(self.state.no_profile, "warning")
            return
        reserve = f" and {profile.plan.reserve} in reserve" if profile.plan.reserve else ""
        text = (
            f"{counted(profile.plan.stops, 'stop')}{reserve} of the cell '{profile.name}', read from {path}; or"
            " those of a table. Nothing moves."
        )
        given, proposed = {"profile": path, **_EDITS}, {"folder": new_folder(profile)}
        self.ask_verb(PLAN, text, given, proposed=proposed)

    def action_change(self) -> None:
        """Ask what to change, then change the open run's plan."""
        if folder := self.planned_folder():
            text = (
                "Further stops tell most beside those that are there. Designed again are all that are not measured,"
                " proposed by discovery or frozen. One of these at a time; nothing moves."
            )
            self.ask_verb(PLAN, text, {"folder": folder, **_NEW, "edit": True})

    def action_write(self) -> None:
        """Ask where to write the plan."""
        if folder := self.planned_folder():
            given, proposed = {"folder": folder, **_OTHER_EXPORTS}, {"plan": folder / _PLAN_FILE}
            self.ask_verb(EXPORT, "The plan as a table.", given, proposed=proposed)

    def action_check(self) -> None:
        """Check the plan of the open run."""
        if folder := self.planned_folder():
            self.start(verbs.job_of(SHOW, folder=folder, part="plan", check=True))

    def action_forecast(self) -> None:
        """Forecast the results of the open run's plan."""
        if folder := self.planned_folder():
            self.start(verbs.job_of(SHOW, folder=folder, part="plan", forecast=True))

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_result(self, result: Result, view: View) -> None:
        """Draw a check or a forecast."""
        from cellapp.cell.planning.records import PlanCheckResult, PlanForecastResult

        result = result.result if isinstance(result, Shown) and result.result is not None else result
        if isinstance(result, PlanCheckResult) and result.file is not None:
            self.read_result(result, view)
            return
        if isinstance(result, PlanCheckResult | PlanForecastResult) and Path(result.run) != self.workspace.folder:
            return  # another run was opened meanwhile
        if isinstance(result, PlanCheckResult):
            self._check = result
            if result.refused:
                self.tabs.active = id_of("Check")
        elif isinstance(result, PlanForecastResult):
            self._forecast = result
            if self.tabs.active in (id_of("Limits"), id_of("Check")):
                self.tabs.active = id_of("Forecast")
        self._draw_results()

    def show_run(self, workspace: Workspace) -> None:
        """Draw the constraints, the plan and its maps."""
        from cellapp.commands.doctor.view import profile_tables
        from cellapp.commands.plan.check_view import design_parts

        planned = (workspace.folder, *(stop.q for stop in _stops_of(workspace)))
        if planned != self._planned:  # check and forecast depend on the joint positions of all stops
            self._planned, self._check, self._forecast = planned, None, None
        tables = [] if workspace.profile is None else profile_tables(workspace.profile)
        self.tab("Limits").show(tables[1:])
        for drawn in self.query(CellMap):
            drawn.show_cell(workspace.profile, _stops_of(workspace))
        self.tab("Design").show(() if workspace.stops is None else design_parts(workspace.stops))
        self._list_stops()
        self._draw_results()

    def show_state(self, state: DayState) -> None:
        """Say how much is planned and measured, or what to do."""
        self.query_one("#plan-state", Line).say(_state_words(state, self.workspace))

    def _draw_results(self) -> None:
        """Draw forecast and check, or which keys start them."""
        from cellapp.commands.plan.check_view import check_sentences, forecast_sentences, forecast_tables

        forecast, check = self._forecast, self._check
        parts: Parts = () if forecast is None else (*forecast_sentences(forecast), *forecast_tables(forecast))
        self.tab("Forecast").show(parts)
        refusals = [] if check is None else check_sentences(check)
        self.tab("Check").show(refusals)
        line = self.query_one("#plan-safety", Line)
        line.display = bool(_stops_of(self.workspace))
        if check is None:
            line.say(f"Checked when it was planned; {SHOWN['check']} checks it again.", "")
        else:
            line.say(refusals[0], "safe" if check.is_safe else "unsafe")

    @on(TabbedContent.TabActivated)
    def _list_stops(self) -> None:
        """List the stops while their tab is shown: words for thousands take half a second."""
        if self._listed is not self.workspace and self.tabs.active == id_of("Stops"):
            self._listed, table = self.workspace, self.query_one(TextTable)
            table.show(_stops_table(_stops_of(self.workspace), self.workspace.ways), table.cursor_row)


def _stops_table(stops: Sequence[PlannedStop], ways: PlannedStops | None) -> Table:
    """Return the stops, counted from 1: how each is reached and what it is for, and its joint positions."""
    from cellapp.commands.plan.check_view import stop_words

    rows = list[tuple[Cell, ...]]()
    for stop in stops:
        assert ways is not None  # a run with stops has them
        at = stop.configuration
        joints = (", ".join(f"{math.degrees(angle):z.0f}" for angle in q) for q in stop.q.values())
        frozen, state = "frozen" if ways.frozen[at] else "", "measured" if stop.measured else "planned"
        rows.append((at + 1, state, frozen, str(ways.block[at] + 1), stop_words(ways, at), *joints))
    angles = [f"{name} [deg]" for name in stops[0].q] if stops else []
    return table_of_cells("Stops", rows, ("stop", "d"), "state", "frozen", "part", "how", *angles)


def _stops_of(workspace: Workspace) -> Sequence[PlannedStop]:
    return () if workspace.stops is None else workspace.stops.stops


def _state_words(state: DayState, workspace: Workspace) -> str:
    """Return how much is planned and measured, or what to do."""
    if state.no_run or workspace.overview is None:
        return state.no_run
    if not state.planned:
        return NO_PLAN
    reserves = len(_stops_of(workspace)) - state.planned
    more = f" and {reserves} in reserve" if reserves else ""
    now = 0 if state.job is None else state.job.stops or 0
    arms = [
        f"arm {name}: {counted(arm.planned, 'stop')}{more}, {max(arm.measured, now)} measured"
        for name, arm in workspace.overview.arms.items()
    ]
    edited = f" The profile was edited since; {SHOWN['go']} plans with the present one." if workspace.edited else ""
    return "; ".join(arms) + "." + edited
