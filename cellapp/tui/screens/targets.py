"""The screen Targets: the list with what the run says about each, edited, compensated, pushed and verified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

from rich.text import Text
from textual import on
from textual import work as in_thread
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.events import Resize
from textual.message import Message
from textual.widgets import DataTable, Static, TabbedContent, TabPane, Tabs
from textual.worker import get_current_worker

from cellapp.compensation.target_text import new_texts, targets_text, typed_texts
from cellapp.compensation.targets import Target, load_targets
from cellapp.errors import InputError
from cellapp.profile import Profile
from cellapp.reporting.charts_accuracy import target_chart
from cellapp.reporting.page_tables import target_tables as measured_tables
from cellapp.reporting.program_table import correct_table
from cellapp.reporting.run_tables import target_tables
from cellapp.reporting.tables import verification_tables
from cellapp.reporting.target_list import COLUMN_GROUPS, stale_model, target_list, target_words
from cellapp.results import CorrectResult, Result, RunResults
from cellapp.tui import work
from cellapp.tui.dialogs.correct_program import CorrectProgram, CorrectRequest
from cellapp.tui.dialogs.file_picker import FilePicker
from cellapp.tui.dialogs.question import Answer, Choice, Reading
from cellapp.tui.dialogs.save_as import SaveAs
from cellapp.tui.dialogs.target_form import TargetForm
from cellapp.tui.offers import BEGIN, arms_words
from cellapp.tui.plots import ChartPlot
from cellapp.tui.screens.base import DayScreen
from cellapp.tui.screens.targets_state import NOT_CALIBRATED, TargetEdits, listed_path, new_name, why_not
from cellapp.tui.widgets.tables import TablesView
from cellapp.tui.widgets.tabs import show_next_tab
from cellapp.tui.workspace import NO_PROFILE, Step, Workspace

_NOT_MEASURED = "Nothing was computed yet: b compensates, v pushes and verifies."
_WIDEST = 26
"""Letters of a cell of the list; the sentence below the list is whole."""
_BESIDE = 6
"""Columns of the terminal beside the list: padding and a scroll bar."""
_STALE = (Answer("no", "Not now", "n"), Answer("begin", "Use this model all the same", "u", "warning"))


class ListRead(Message):
    """A list was read, or why it cannot be."""

    def __init__(self, path: Path, targets: tuple[Target, ...], problem: str = "") -> None:
        super().__init__()
        self.path, self.targets, self.problem = path, targets, problem


class TargetGrid(DataTable[Text]):
    """The list, one row for each target."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select_cursor", "Edit", tooltip="edit the target")]


class TargetsScreen(DayScreen):
    """Targets: list, edit, compensate, push, verify."""

    AUTO_FOCUS = "#grid"
    STEP: ClassVar[Step] = "targets"
    HELP: ClassVar[str] = """\
# Targets

Points to which the calibrated arms are sent. The list that the profile names is opened by itself.

- *List*: **Enter** edits a target, **+** (Insert) adds one, **-** (Delete) removes one, **Ctrl+Z** undoes, **Ctrl+Y**
  redoes. **w** saves the list, **i** opens another one.
- **b** compensates: computes the joint positions by the calibrated model. Nothing moves.
- **g** drives the arms there. **v** drives with the nominal and with the compensated command and measures both. Each
  asks first; real arms ask again, with the first path.
- **c** corrects a program of a UR controller (`.script`, `.urp`): its copy leads a plain controller to the true poses.
- *tol.* is how far the SMR may be from the target. *state* says whether that is met: predicted from the uncertainty of
  the model (in, out, cannot say), or measured; or why the target is refused.
- *Measured*: the errors before and after compensation. **a** shows the other arm. *Tables*: joint positions, errors.

**t** goes from tab to tab. An edited list is used as it is shown, saved or not.
"""
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("b", "compensate", "Compensate", tooltip="compute commands; nothing moves"),
        Binding("g", "push(False)", "Push", tooltip="drive to the targets: THE ARMS MOVE"),
        Binding("v", "push(True)", "Verify", tooltip="drive to the targets and measure: THE ARMS MOVE"),
        Binding("plus,insert", "add", "Add", key_display="+", tooltip="add a target"),
        Binding("minus,delete", "remove", "Remove", key_display="-", tooltip="remove the target"),
        Binding("ctrl+z", "undo", "Undo", tooltip="take back the last edit"),
        Binding("ctrl+y", "redo", "Redo", show=False),
        Binding("i", "open_list", "Open", tooltip="open another list (YAML, CSV)"),
        Binding("w", "save", "Save", tooltip="save the list (YAML)"),
        Binding("c", "correct", "Program", tooltip="correct the targets of a UR program; nothing moves"),
        Binding("a", "other_arm", "Other arm", show=False, tooltip="show the errors of the other arm"),
        Binding("t", "next_tab", "Next tab"),
    ]
    DEFAULT_CSS = """
    TargetsScreen #list { padding: 0; }
    TargetsScreen #about-list { height: auto; }
    TargetsScreen TargetGrid { height: 1fr; }
    TargetsScreen #about-target { height: auto; max-height: 4; }
    TargetsScreen.-narrow #second-plot { display: none; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._edits = TargetEdits()
        self._drawn: Workspace | None = None
        self._opened_for: Path | None = None
        self._arm = 0
        self._corrected: CorrectResult | None = None

    def body(self) -> ComposeResult:
        with TabbedContent(id="targets"):
            with TabPane("List", id="list"):
                yield Static("", id="about-list", markup=False)
                grid = TargetGrid(id="grid", cursor_type="row", zebra_stripes=True)
                grid.tooltip = "Enter edits, + adds, - removes, Ctrl+Z undoes, w saves"
                yield grid
                yield Static("", id="about-target", classes="muted", markup=False)
            with TabPane("Measured", id="measured"), Horizontal():
                yield ChartPlot(id="first-plot")
                yield ChartPlot(id="second-plot")
            with TabPane("Tables", id="target-tables-pane"):
                yield TablesView(_NOT_MEASURED, id="target-tables")

    @property
    def _grid(self) -> TargetGrid:
        return self.query_one("#grid", TargetGrid)

    @property
    def _index(self) -> int:
        """The place of the target under the cursor."""
        return min(self._grid.cursor_row, len(self._edits.targets) - 1)

    # -- the list ------------------------------------------------------------------------------------------------------

    def action_open_list(self) -> None:
        """Ask for a file, and before that about what is not saved."""
        if self.workspace.profile is None:
            self.say(NO_PROFILE, "warning")
        elif not self._edits.edited:
            self._pick()
        else:
            answers = (Answer("stay", "Keep them", "k"), Answer("open", "Open another list", "o", "warning"))
            text = "Edits are not saved (w saves). Another list replaces them."
            question = Choice("Leave the edits?", text, answers)
            self.app.push_screen(question, lambda answer: self._pick() if answer == "open" else None)

    def _pick(self) -> None:
        known = self._edits.path or self.workspace.profile_path or Path.cwd() / "targets.yaml"
        suffixes = (".yaml", ".yml", ".csv")
        picker = FilePicker("A list of targets (YAML, CSV)", known.parent, lambda path: path.suffix in suffixes)
        self.app.push_screen(picker, self._open)

    def _open(self, path: Path | None) -> None:
        if path is not None and self.workspace.profile is not None:
            self._read(path, self.workspace.profile)

    @in_thread(thread=True, exclusive=True, group="list of targets")
    def _read(self, path: Path, profile: Profile) -> None:
        try:
            read = ListRead(path, load_targets(path, profile))
        except InputError as error:
            read = ListRead(path, (), str(error))
        if not get_current_worker().is_cancelled:  # else another list is being read
            self.post_message(read)

    @on(ListRead)
    def show_list(self, event: ListRead) -> None:
        """Draw the list that was read; a broken one leaves the present list."""
        if event.problem:
            self.say(f"{event.problem}. i opens another list.", "error")
            return
        self._edits = TargetEdits(event.path, event.targets, event.targets)
        self._draw_list()

    @on(DataTable.RowSelected, "#grid")
    def edit(self) -> None:
        """Edit the target under the cursor in a form."""
        if self._edits.targets and self.workspace.profile is not None:
            index = self._index
            target = self._edits.targets[index]
            others = self._edits.without(index).targets
            form = TargetForm(f"Target {target.name}", target, typed_texts(target), others, self.workspace.profile)
            self.app.push_screen(form, lambda typed: self._take(index, typed))

    def action_add(self) -> None:
        """Type a new target, beginning with the one under the cursor."""
        profile, targets = self.workspace.profile, self._edits.targets
        if profile is None:
            self.say(NO_PROFILE, "warning")
            return
        arm = next(iter(profile.arms))
        texts = new_texts(arm)
        like = targets[self._index] if targets else None
        if like is not None:
            texts = {**typed_texts(like), "name": new_name(like.name, targets)}
        form = TargetForm("New target", like, texts, targets, profile)
        self.app.push_screen(form, lambda typed: self._take(len(targets), typed))

    def _take(self, index: int, target: Target | None) -> None:
        if target is not None and self._edits.targets[index : index + 1] != (target,):
            self._show(self._edits.with_target(index, target), index)

    def action_remove(self) -> None:
        """Remove the target under the cursor."""
        if self._edits.targets:
            index = self._index
            name = self._edits.targets[index].name
            self._show(self._edits.without(index), index)
            self.notify(f"Target {name} removed; Ctrl+Z brings it back.")

    def action_undo(self) -> None:
        """Take back the last edit."""
        self._step(self._edits.undone(), "Nothing to undo.")

    def action_redo(self) -> None:
        """Make the edit again that was taken back."""
        self._step(self._edits.redone(), "Nothing to redo.")

    def _step(self, edits: TargetEdits | None, nothing: str) -> None:
        if edits is None:
            self.notify(nothing)
        else:
            self._show(edits, self._index)

    def _show(self, edits: TargetEdits, index: int) -> None:
        self._edits = edits
        self.query_one("#targets", TabbedContent).active = "list"
        self._draw_list()
        self._grid.move_cursor(row=index)

    def action_save(self) -> None:
        """Save the list as commented YAML."""
        targets = self._edits.targets
        if not targets:
            self.say("An empty list cannot be saved: + adds a target, Ctrl+Z brings back what was removed.", "warning")
            return
        proposed = (self._edits.path or Path("targets.yaml")).with_suffix(".yaml")

        def saved(path: Path | None) -> None:
            if path is not None:
                self._edits = self._edits.saved_as(path, targets)
                self._draw_list()
                self.say(f"{len(targets)} targets saved as {path}.")

        self.app.push_screen(SaveAs("targets", targets_text(targets), proposed), saved)

    # -- the jobs ------------------------------------------------------------------------------------------------------

    def action_compensate(self) -> None:
        """Compute commands for the list as it is shown."""
        if reason := why_not(self.workspace, self._edits.targets):
            self.say(reason, "warning")
            return
        assert self.workspace.folder is not None
        self.start(work.compensate(self.workspace.folder, self._edits.targets))

    def action_push(self, verify: bool) -> None:
        """Ask, then drive to the targets; with ``verify`` measure."""
        workspace, targets = self.workspace, self._edits.targets
        if reason := why_not(workspace, targets):
            self.say(reason, "warning")
            return
        folder, results = workspace.folder, workspace.results
        assert folder is not None
        assert results is not None
        stale = stale_model(results)
        counts = " and ".join(f"arm {arm} to {n}" for arm, n in Counter(target.arm for target in targets).items())
        measure = " with the nominal and the compensated command, measured by the tracker" if verify else ""
        text = f"Drive {counts} targets{measure}; the other arm waits at home; {arms_words(workspace)}."
        if stale:
            text += f"\nThe model is not up to date: {stale}. Better calibrate or discover again first."

        def begin(answer: str | None) -> None:
            if answer == "begin":
                self.start(work.push(folder, targets, verify=verify, out_of_date=bool(stale)))

        title = "Push and verify?" if verify else "Push?"
        self.app.push_screen(Choice(title, text, _STALE if stale else BEGIN), begin)

    def action_correct(self) -> None:
        """Ask for a program and where its corrected copy is written."""
        folder, results = self.open_folder(), self.workspace.results
        if folder is None:
            return
        if results is None or results.calibrate is None:
            self.say(NOT_CALIBRATED, "warning")
            return
        arms = tuple(results.calibrate.arms)

        def write(request: CorrectRequest | None) -> None:
            if request is not None:
                self.start(work.correct(folder, request))

        def ask(program: Path | None) -> None:
            if program is not None:
                self.app.push_screen(CorrectProgram(program, arms), write)

        title = "A program of a UR controller (.script, .urp)"
        self.app.push_screen(FilePicker(title, Path.cwd(), lambda path: path.suffix in (".script", ".urp")), ask)

    def show_result(self, result: Result) -> None:
        """Show the targets of a program that was corrected, and why some were not."""
        if isinstance(result, CorrectResult) and self.app.screen is self:
            from cellapp.programs.words import correct_lines

            self._corrected = result
            self._draw_tables()
            tabs = self.query_one("#targets", TabbedContent)
            tabs.active = "target-tables-pane"
            tabs.query_one(Tabs).focus()  # the list, which has the focus, would bring its tab back
            lines = correct_lines(result)
            self.app.push_screen(Reading("\n".join(["# Program", "", "```text", *lines, "```"])))

    # -- tabs and plots ------------------------------------------------------------------------------------------------

    def action_other_arm(self) -> None:
        """Show the errors of the next arm."""
        self._arm += 1
        self.query_one("#targets", TabbedContent).active = "measured"
        self._draw_plots()

    def action_next_tab(self) -> None:
        """Show the next tab."""
        tabs = self.query_one("#targets", TabbedContent)
        show_next_tab(tabs)
        if tabs.active == "list":
            self._grid.focus()

    # -- drawing -------------------------------------------------------------------------------------------------------

    @property
    def _results(self) -> RunResults | None:
        return self.workspace.results

    def show_workspace(self, workspace: Workspace) -> None:
        """Draw the list with the results of the run; open the list that the profile names."""
        if workspace is self._drawn:
            return
        self._drawn = workspace
        path = listed_path(workspace)
        if path is not None and path != self._opened_for and workspace.profile is not None and not self._edits.edited:
            self._opened_for = path
            self._read(path, workspace.profile)
        self._draw_list()
        self._draw_tables()
        self._draw_plots()

    @on(Resize)
    def draw_for_size(self) -> None:
        """Draw as many columns as there is room for."""
        if self._drawn is not None:
            self._draw_list()

    def _draw_list(self) -> None:
        """Draw all rows; the cursor stays in its line."""
        results, edits = self._results, self._edits
        outdated = [] if results is None else [results.out_of_date.get(name, "") for name in ("compensate", "verify")]
        reasons = "; ".join(dict.fromkeys(filter(None, outdated)))
        mark = f"\n! results are out of date: {reasons}; b compensates again" if reasons else ""
        self.query_one("#about-list", Static).update(edits.heading + mark)
        table, grid = target_list(edits.targets, results), self._grid
        row = grid.cursor_row
        grid.clear(columns=True)
        rows = [[_cut(cell) for cell in cells] for cells in table.text_rows()]
        shown = _fitting([max(map(len, column)) for column in zip(table.headings, *rows)], self.size.width - _BESIDE)
        sides: list[Literal["left", "right"]] = ["right" if column.is_number else "left" for column in table.columns]
        for heading, side in zip(table.headings[:shown], sides):
            grid.add_column(Text(heading, justify=side))
        for cells in rows:
            grid.add_row(*(Text(cell, justify=side) for cell, side in zip(cells[:shown], sides)))
        grid.move_cursor(row=row)
        self._draw_target()

    @on(DataTable.RowHighlighted, "#grid")
    def _draw_target(self) -> None:
        """What is known about the target under the cursor."""
        targets = self._edits.targets
        words = target_words(targets[self._index], self._results) if targets else ""
        self.query_one("#about-target", Static).update(words)

    def _draw_tables(self) -> None:
        results, view = self._results, self.query_one("#target-tables", TablesView)
        program = [] if self._corrected is None else [correct_table(self._corrected)]
        if results is None:
            view.show(program)
            return
        verify, compensate = results.verify, results.compensate
        measured = [] if verify is None else [*verification_tables(verify), *measured_tables(verify)]
        commands = [] if compensate is None else target_tables(compensate)
        notes = [] if compensate is None else [*compensate.notes]
        view.show([*program, *measured, *commands], [] if verify is None else verify.complaints(), notes)

    def _draw_plots(self) -> None:
        results, profile = self._results, self.workspace.profile
        names = [] if profile is None else list(profile.arms)
        for place, plot in enumerate(
            (self.query_one("#first-plot", ChartPlot), self.query_one("#second-plot", ChartPlot))
        ):
            if results is None or results.calibrate is None or place >= len(names):
                plot.chart = None
                continue
            name = names[(self._arm + place) % len(names)]
            arm = results.calibrate.arms.get(name)
            plot.chart = target_chart(name, results.verify, None if arm is None else arm.tracker_mm)


def _fitting(widths: Sequence[int], room: int) -> int:
    """How many columns fit whole; the sentence below the list says what the others would."""
    fitting = [count for count in COLUMN_GROUPS if sum(widths[:count]) + 2 * count <= room]
    return max(fitting, default=COLUMN_GROUPS[0])


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
