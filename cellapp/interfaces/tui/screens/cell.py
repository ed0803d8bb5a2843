"""The screen Cell: the profile and its content, the state of its devices, what the doctor refuses."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import OptionList, Static, TabbedContent

from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.ground.starters import offered_profiles
from cellapp.interfaces.tui import verb_jobs as verbs
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen, id_of
from cellapp.interfaces.tui.widgets.controls import Line
from cellapp.interfaces.tui.widgets.tables import CellMap
from cellapp.interfaces.tui.workspace import Workspace

if TYPE_CHECKING:
    from cellapp.commands.doctor.result import DoctorResult
    from cellapp.commands.record import View
    from cellapp.ground.profile import Profile
    from cellapp.ground.results import Result
    from cellapp.interfaces.tui.widgets.runs_list import RunsList

_NOT_CHECKED = f"Not checked yet: {SHOWN['go']} asks the doctor; nothing moves."
_ORDER = {"failed": 0, "warning": 1, "ok": 2}


class CellScreen(TabsScreen):
    """Choose a profile, read its content, see its devices, ask the doctor."""

    STEP: ClassVar[Step] = "cell"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "doctor", "Doctor", "check devices and placement; nothing moves"),
        bind("open", "open", "Open profile", "open a profile by its path"),
        bind("edit", "edit", "Edit profile", "change the profile in $EDITOR, then check it again"),
        bind("import", "own_readings", "Own readings", "calibrate readings that were recorded elsewhere", show=False),
        bind("tab", "next_tab", "Next tab", "show the next of the tabs"),
        bind("add", "write", "New profile", "write a profile that explains its keys, and edit it"),
    ]

    TABS: ClassVar[Mapping[str, str]] = {"Profile": "", "Doctor": _NOT_CHECKED, "Map": "", "Runs": ""}

    def __init__(self) -> None:
        super().__init__()
        self._found: list[Path] = []
        self._doctor: DoctorResult | None = None
        self._doctor_path: Path | None = None
        self._doctor_profile: Profile | None = None
        self._asked_path: Path | None = None
        self._doctor_at = datetime.now()
        self._written_ns = self._read_ns = 0

    def body(self) -> ComposeResult:
        with Horizontal():
            profiles = OptionList(id="profiles", markup=False, compact=True)
            profiles.tooltip = "Profiles of the folder; Enter opens"
            yield profiles
            with Vertical(id="cell-middle"):
                yield Line(id="cell-verdict")
                yield from super().body()

    def in_tab(self, title: str) -> ComposeResult:
        """The widgets of a tab; the list of runs is made when it is looked at."""
        if title == "Map":
            yield CellMap()
        elif title == "Runs":
            yield Static(classes="nothing")  # an empty pane would show its own name
        else:
            yield from super().in_tab(title)

    def on_mount(self) -> None:
        """List the profiles and open the first one."""
        self._found = offered_profiles(self.cell_app.profiles)
        profiles = self.query_one("#profiles", OptionList)
        profiles.add_options([path.stem for path in self._found])
        if self._found:
            self.call_after_refresh(self._highlight_first)  # it is read in a thread, once the screen is drawn
        else:
            self.say(
                f"No profile is in {self.cell_app.profiles}: {SHOWN['open']} opens one by its path,"
                f" {SHOWN['add']} writes one.",
                "warning",
            )
        profiles.focus()

    def _highlight_first(self) -> None:
        profiles = self.query_one("#profiles", OptionList)
        profiles.highlighted = 0 if profiles.highlighted is None else profiles.highlighted

    # -- profiles ------------------------------------------------------------------------------------------------------

    @on(OptionList.OptionHighlighted, "#profiles")
    def look_at(self, event: OptionList.OptionHighlighted) -> None:
        """Open the highlighted profile, unless that would close a run, which needs Enter."""
        if self.workspace.folder is None:
            self._open(self._found[event.option_index])

    @on(OptionList.OptionSelected, "#profiles")
    def choose(self, event: OptionList.OptionSelected) -> None:
        """Open the chosen profile, without a run."""
        self._open(self._found[event.option_index])

    def action_open(self) -> None:
        """Ask for the path of a profile."""
        picker = FilePicker("Which profile?", self.cell_app.profiles, [".yaml"])
        self.app.push_screen(picker, lambda path: None if path is None else self._open_listed(path))

    def _open_listed(self, path: Path) -> None:
        """Open a profile from anywhere and add it to the list."""
        self._list(path)
        self._open(path)

    def _list(self, path: Path) -> None:
        """Highlight a profile in the list; add it if it is missing."""
        profiles = self.query_one("#profiles", OptionList)
        if path not in self._found:
            self._found.append(path)
            profiles.add_option(path.stem)
        profiles.highlighted = self._found.index(path)

    def _open(self, path: Path) -> None:
        """Open a profile, unless it is open as it is written."""
        workspace = self.workspace
        if path != workspace.profile_path or workspace.folder is not None or _written_ns(path) != self._read_ns:
            self.cell_app.open_profile(path)

    def action_edit(self) -> None:
        """Edit the profile in the person's editor."""
        path = self.workspace.profile_path
        if path is None:
            self.say(f"No profile is open: {SHOWN['add']} writes a new one.", "warning")
        else:
            from cellapp.interfaces.tui.dialogs.first_run import edit_profile

            edit_profile(self.cell_app, path)

    def action_write(self) -> None:
        """Write a new profile, and edit it."""
        from cellapp.interfaces.tui.dialogs.first_run import write_profile

        write_profile(self.cell_app)

    def action_own_readings(self) -> None:
        """Create a profile and a run from external readings."""
        from cellapp.interfaces.tui.dialogs.first_run import take_own_readings

        take_own_readings(self.cell_app)

    def show_runs(self) -> None:
        """List all runs."""
        self.tabs.active = id_of("Runs")

    @property
    def _runs(self) -> RunsList | None:
        """The list of runs while it is shown."""
        return cast("RunsList | None", next(iter(self.query("RunsList")), None)) if self.has_class("-runs") else None

    @on(TabbedContent.TabActivated)
    def list_runs(self, event: TabbedContent.TabActivated) -> None:
        """Read the folder of runs when it is looked at; it has the whole width."""
        self.set_class(event.pane.id == id_of("Runs"), "-runs")
        if self._runs is not None:
            self._runs.enter_list()
            self._runs.action_read()
        elif self.has_class("-runs"):
            from cellapp.interfaces.tui.widgets.runs_list import RunsList  # numerics, which the start must not wait for

            event.pane.mount(RunsList())

    # -- doctor and devices --------------------------------------------------------------------------------------------

    def action_doctor(self) -> None:
        """Check the cell."""
        path = self.workspace.profile_path
        if path is None:
            self.say("No profile is open: choose one in the list.", "warning")
            return
        self._asked_path = path
        self.start(verbs.verb_job(DOCTOR, DoctorRequest(profile=path)))

    def show_result(self, result: Result, view: View) -> None:
        """Draw the doctor's findings."""
        from cellapp.commands.doctor.result import DoctorResult

        if isinstance(result, DoctorResult):
            self._doctor, self._doctor_path, self._doctor_at = result, self._asked_path, datetime.now()
            self._doctor_profile, self._written_ns = self.workspace.profile, _written_ns(self._doctor_path)
            ordered = sorted(result.findings, key=lambda finding: _ORDER[finding.status])  # failed ones first
            findings = DOCTOR.view(result.model_copy(update={"findings": ordered}))
            self.tab("Doctor").show(findings.parts)
            self.tabs.active = id_of("Doctor")

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_state(self, state: DayState) -> None:
        """No step of a run has its result here."""

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the profile if it has changed, and the doctor's verdict, which grows old."""
        super().show_workspace(workspace)
        self.query_one("#cell-verdict", Line).say(*self._verdict())

    def show_run(self, workspace: Workspace) -> None:
        """Draw the profile."""
        if workspace.profile_path is not None:
            self._list(workspace.profile_path)
        self._read_ns = _written_ns(workspace.profile_path)
        self._show_profile(workspace.profile, workspace.problem)
        for plot in self.query(CellMap):
            plot.show_cell(workspace.profile, () if workspace.stops is None else workspace.stops.stops)
        if self._runs is not None:
            self._runs.action_read()
        if workspace.profile != self._doctor_profile and workspace.profile_path != self._doctor_path:
            self._doctor = self._doctor_profile = None
            self.tab("Doctor").show(())

    def _show_profile(self, profile: Profile | None, problem: str) -> None:
        if profile is not None:
            from cellapp.commands.doctor.view import profile_tables

            self.tab("Profile").show(profile_tables(profile))
        elif problem:
            self.tab("Profile").show(problem.splitlines())
            self.tabs.active = id_of("Profile")

    def _verdict(self) -> tuple[str, str]:
        """Return the doctor's verdict in words, and the class that colours it."""
        if self.workspace.profile is None:
            if self.state.reading:
                return self.state.reading, "old"
            if problem := self.workspace.problem:
                first, *more = problem.splitlines()
                return f"{first}{' ...' if more else ''} ({SHOWN['edit']} edits it)", "failed"
            return f"No profile is open: choose one in the list, or press {SHOWN['open']}.", "failed"
        if self._doctor is None:
            return _NOT_CHECKED, "old"
        from cellapp.commands.doctor.view import doctor_verdict

        words = f"{doctor_verdict(self._doctor)} Checked at {self._doctor_at:%H:%M}."
        if _written_ns(self._doctor_path) != self._written_ns:
            return f"Old, the profile was edited since: {words} {SHOWN['go']} checks again.", "old"
        return words, "failed" if self._doctor.failed else "ready"


def _written_ns(path: Path | None) -> int:
    """Return when a file was last written; 0 if there is none."""
    try:
        return 0 if path is None else path.stat().st_mtime_ns
    except OSError:
        return 0
