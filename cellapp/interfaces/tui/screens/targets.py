"""The screen Targets: the list with the run's results for each, compensated, pushed and verified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from textual import on
from textual import work as in_thread
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.events import Resize
from textual.widgets import DataTable, Static, TabbedContent, Tabs
from textual.worker import get_current_worker

from cellapp.cell.targets.targets import Target, list_problems, load_targets
from cellapp.commands.check.request import STOPS_TO_LOCATE
from cellapp.commands.check.request import VERB as CHECK
from cellapp.commands.compensate.charts import target_charts
from cellapp.commands.compensate.request import PROGRAMS
from cellapp.commands.compensate.request import VERB as COMPENSATE
from cellapp.commands.compensate.tables import all_measured_tables, stored_tables
from cellapp.commands.compensate.target_list import (
    COLUMN_GROUPS,
    target_list,
    target_state,
    target_states,
    target_words,
)
from cellapp.commands.compensate.view import target_parts
from cellapp.commands.compensate.words import compensate_summary, unknown_lines, verify_lines
from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.commands.push.request import VERB as PUSH
from cellapp.commands.view.parts import Part
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.dialogs.file_picker import FilePicker
from cellapp.interfaces.tui.dialogs.question import BEGIN, USE_STALE, WRITE, Choice
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen, id_of
from cellapp.interfaces.tui.widgets.parts_view import words_first
from cellapp.interfaces.tui.widgets.tables import TextTable
from cellapp.interfaces.tui.workspace import Workspace

EMPTY = f"No targets: {SHOWN['open']} opens a list (YAML, CSV)."


def listed_path(workspace: Workspace) -> Path | None:
    """Return the path of the target list that the profile names; None if it names none."""
    if workspace.profile is None or workspace.profile_path is None or workspace.profile.targets is None:
        return None
    return workspace.profile_path.parent / workspace.profile.targets


def why_not(workspace: Workspace, state: DayState, targets: Sequence[Target]) -> str:
    """Return why commands cannot be computed for the list, and what to do; empty if they can."""
    if state.not_calibrated or workspace.profile is None:
        return state.not_calibrated
    if not targets:
        return EMPTY
    first = next(list_problems(targets, workspace.profile), None)
    if first is None:
        return ""
    index, key, text = first
    return f"Target '{targets[index].name}', {key}: {text}. {SHOWN['edit']} edits the list."


_WIDEST = 26
"""Longest text of a cell in the list [characters]; the sentence below the list is complete."""
_BESIDE = 6
"""Columns of the terminal beside the list: padding and a scroll bar."""
LIST_SUFFIXES = (".yaml", ".yml", ".csv")


class TargetGrid(TextTable):
    """The list, one row for each target."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select_cursor", "Target", tooltip="more of the target")]


class TargetsScreen(TabsScreen):
    """Targets: list, compensate, push, verify."""

    AUTO_FOCUS = "#grid"
    STEP: ClassVar[Step] = "targets"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "compensate", "Compensate", "compute commands; nothing moves"),
        bind("push", "push", "Push", "drive to the targets: THE ARMS MOVE"),
        bind("measure", "verify", "Verify", "drive to the targets and measure: THE ARMS MOVE"),
        bind("open", "open_list", "Open", "open another list (YAML, CSV)"),
        bind("edit", "edit", "Edit list", "change the list in $EDITOR, then check it again"),
        bind("export", "correct", "Program", "correct the targets of a UR program; nothing moves"),
        bind("locate", "locate", "Locate", "measure where the moved tracker stands: THE ARMS MOVE"),
        bind("filter", "attention", "Attention", "only targets that need attention, or all", show=False),
        bind("tab", "next_tab", "Next tab"),
    ]

    TABS: ClassVar[Mapping[str, str]] = {
        "List": "",
        "Target": EMPTY,
        "Results": f"Nothing was computed yet: {SHOWN['go']} compensates, {SHOWN['measure']} pushes and verifies.",
    }

    def __init__(self) -> None:
        super().__init__()
        self._path: Path | None = None
        self._targets: tuple[Target, ...] = ()
        self._opened_for: Path | None = None
        self._attention = False
        self._rows: list[int] = []

    def in_tab(self, title: str) -> ComposeResult:
        if title != "List":
            yield from super().in_tab(title)
            return
        yield Static("", id="about-list", markup=False)
        grid = TargetGrid(id="grid", cursor_type="row", zebra_stripes=True)
        grid.tooltip = "Enter shows more of a target, {edit} edits the list, {open} opens another".format_map(SHOWN)
        yield grid
        yield Static("", id="about-target", classes="muted", markup=False)

    @property
    def _grid(self) -> TargetGrid:
        return self.query_one("#grid", TargetGrid)

    @property
    def _index(self) -> int:
        """Index of the target under the cursor; -1 if no target is shown."""
        return self._rows[min(self._grid.cursor_row, len(self._rows) - 1)] if self._rows else -1

    # -- the list ------------------------------------------------------------------------------------------------------

    def action_open_list(self) -> None:
        """Ask for a file."""
        if self.workspace.profile is None:
            self.say(self.state.no_run, "warning")
            return
        known = self._path or self.workspace.profile_path or Path.cwd() / "targets.yaml"
        picker = FilePicker("A list of targets (YAML, CSV)", known.parent, LIST_SUFFIXES)
        self.app.push_screen(picker, self._open)

    def action_edit(self) -> None:
        """Edit the list in the person's editor."""
        # late, for the start-up time
        from cellapp.interfaces.tui.dialogs.first_run import edit_file

        if (path := self._path) is None:
            self.say(EMPTY, "warning")
        else:
            edit_file(self.cell_app, path, lambda: self._open(path), f"{SHOWN['open']} opens it again")

    def _open(self, path: Path | None) -> None:
        if path is not None and self.workspace.profile is not None:
            self._read(path, self.workspace.profile)

    @in_thread(thread=True, exclusive=True, group="list of targets")
    def _read(self, path: Path, profile: Profile) -> None:
        try:
            read, problem = load_targets(path, profile), ""
        except InputError as error:
            read, problem = (), str(error)
        if not get_current_worker().is_cancelled:  # else another list is being read
            self.call_later(self._show_read, path, read, problem)

    def _show_read(self, path: Path, targets: tuple[Target, ...], problem: str) -> None:
        """Draw the list that was read; an invalid one leaves the current list."""
        if problem:
            self.say(f"{problem}. {SHOWN['open']} opens another list.", "error")
            return
        self._path, self._targets = path, targets
        self._draw_list()

    @on(DataTable.RowSelected, "#grid")
    def show_details(self) -> None:
        """Show all that is known of the target under the cursor."""
        self.tabs.active = id_of("Target")
        self.query_one(Tabs).focus()  # the list, which has the focus, would bring its tab back

    def action_attention(self) -> None:
        """Show only targets that are refused, out of tolerance, undecided or not measured; the second time, all."""
        self._attention = not self._attention
        self.tabs.active = id_of("List")
        self._draw_list()

    # -- the jobs ------------------------------------------------------------------------------------------------------

    def _ready(self) -> Path | None:
        """Return the run's folder if commands can be computed for the list; else say why not and return None."""
        if reason := why_not(self.workspace, self.state, self._targets):
            self.say(reason, "warning")
            return None
        return self.workspace.folder

    def action_compensate(self) -> None:
        """Compute commands for the shown list."""
        if (folder := self._ready()) is not None:
            self.start(verb_jobs.job_of(COMPENSATE, folder=folder, targets=self._targets))

    def action_push(self) -> None:
        """Ask, then drive to the targets."""
        if (folder := self._ready()) is not None:
            stale = bool(self.workspace.stale)
            given = {"folder": folder, "targets": self._targets, "verify": False, "out_of_date": stale}
            question = Choice("Push?", self.moving_words(self._push_words("")), USE_STALE if stale else BEGIN)
            self.ask(question, lambda: self.start(verb_jobs.job_of(PUSH, **given)))

    def action_verify(self) -> None:
        """Ask, also how often each target is corrected; then drive to the targets and measure."""
        if (folder := self._ready()) is not None:
            text = self._push_words(" with the nominal and the compensated command, measured by the tracker")
            self.ask_verb(PUSH, text, {"folder": folder, "targets": self._targets, "verify": True})

    def _push_words(self, measured: str) -> str:
        """Return where a push drives to."""
        targets = self._targets
        counts = Counter(arm for target in targets for arm in target.arms)
        where = " and ".join(f"arm {arm} to {n}" for arm, n in counts.items())
        pairs = ", except at cooperative targets" if any(target.partner is not None for target in targets) else ""
        return f"Drive {where} targets{measured}; the other arm waits at home{pairs};"

    def action_locate(self) -> None:
        """Ask, then measure the pose of the tracker after it was moved."""
        words = "After the tracker was moved: measure a few points, so that the calibration holds from where it stands;"
        if (calibrated := self.calibrated_run()) is not None:
            given = {"folder": calibrated[0], "tracker_moved": True, "simulated_plant": None}
            self.ask_verb(CHECK, words, given, shows_result=self.read_result, proposed={"stops": STOPS_TO_LOCATE})

    def action_correct(self) -> None:
        """Ask for a program and the file of its corrected copy."""
        if (calibrated := self.calibrated_run()) is None:
            return
        folder, _, calibration = calibrated
        arms = tuple(calibration.arms)

        def ask(program: Path | None) -> None:
            if program is not None:
                out = program.with_stem(f"{program.stem}-corrected")
                proposed = {"out": out, "arm": arms[0] if len(arms) == 1 else None}
                given, text = {"folder": folder, "targets": program}, f"{program.name}; nothing moves."
                self.ask_verb(
                    COMPENSATE,
                    text,
                    given,
                    WRITE,
                    shows_result=self.read_result,
                    proposed=proposed,
                    choices={"arm": arms},
                )

        title = f"A program of a UR controller ({', '.join(PROGRAMS)})"
        self.app.push_screen(FilePicker(title, Path.cwd(), PROGRAMS), ask)

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_state(self, state: DayState) -> None:
        """Say why nothing was computed."""
        self.tab("Results").say_empty(state.nothing(self.STEP, self.TABS["Results"]))

    def show_run(self, workspace: Workspace) -> None:
        """Draw the list with the results of the run; open the list that the profile names."""
        path = listed_path(workspace)
        if path is not None and path != self._opened_for and workspace.profile is not None:
            self._opened_for = path
            self._read(path, workspace.profile)
        self._draw_list()
        self._draw_results()

    @on(Resize)
    def draw_for_size(self) -> None:
        """Draw as many columns as fit."""
        if self._shown is not None:
            self._draw_list()

    def _draw_list(self) -> None:
        """Draw all rows; the cursor stays in its row."""
        results = self.workspace.results
        outdated = [] if results is None else [results.out_of_date.get(name, "") for name in ("compensate", "verify")]
        reasons = "; ".join(dict.fromkeys(filter(None, outdated)))
        mark = f"\n! results are out of date: {reasons}; {SHOWN['go']} compensates again" if reasons else ""
        only = f"\nonly targets that need attention; {SHOWN['filter']} shows all" if self._attention else ""
        heading = EMPTY if self._path is None else f"{self._path} · {counted(len(self._targets), 'target')}"
        self.query_one("#about-list", Static).update(heading + mark + only)
        table, self._rows = target_list(self._targets, results), self._shown_rows()
        texts = table.text_rows()
        rows = [tuple(map(_cut, texts[index])) for index in self._rows]
        widths = [max(map(len, column)) for column in zip(table.headings, *rows, strict=True)]
        shown = _fitting(widths, self.size.width - _BESIDE)
        fitting = replace(table, columns=table.columns[:shown], rows=tuple(row[:shown] for row in rows))
        self._grid.show(fitting, self._grid.cursor_row)
        self._draw_target()

    @on(DataTable.RowHighlighted, "#grid")
    def _draw_target(self) -> None:
        """Draw what is known about the target under the cursor."""
        words = target_words(self._targets[self._index], self.workspace.results) if self._rows else ""
        self.query_one("#about-target", Static).update(words)
        if self.tabs.active == id_of("Target"):
            self._draw_details()

    @on(TabbedContent.TabActivated)
    def _draw_details(self) -> None:
        """Draw all that the run knows of the target under the cursor, while its tab is shown."""
        if self.tabs.active != id_of("Target"):
            return
        parts: list[Part] = []
        if self._rows:
            target, results = self._targets[self._index], self.workspace.results
            known = [] if results is None else target_parts(results, target_state(target, results))
            parts = [target_words(target, results), *known]
        self.tab("Target").show(words_first(parts))

    def _shown_rows(self) -> list[int]:
        """Return the indices of the shown targets."""
        states = target_states(self._targets, self.workspace.results)
        return [row for row, state in enumerate(states) if state.needs_attention or not self._attention]

    def _draw_results(self) -> None:
        """Draw sentences, charts and tables of what was measured and of the commands."""
        parts: list[Part] = []
        results, profile = self.workspace.results, self.workspace.profile
        if results is not None and (verify := results.verify) is not None:
            arms = {} if results.calibrate is None else results.calibrate.arms
            names = () if profile is None else profile.arms
            charts = target_charts(verify, {name: arms[name].tracker_mm if name in arms else None for name in names})
            parts += [*verify.complaints(), *verify_lines(verify), *charts, *all_measured_tables(verify)]
        if results is not None and (compensate := results.compensate) is not None:
            words = (*compensate_summary(compensate), *unknown_lines(compensate.targets), *compensate.notes)
            parts += [*words, *stored_tables(compensate)]
        self.tab("Results").show(words_first(parts))


def _fitting(widths: Sequence[int], room: int) -> int:
    """Return how many columns fit completely; the sentence below the list replaces the others."""
    fitting = [count for count in COLUMN_GROUPS if sum(widths[:count]) + 2 * count <= room]
    return max(fitting, default=COLUMN_GROUPS[0])


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
